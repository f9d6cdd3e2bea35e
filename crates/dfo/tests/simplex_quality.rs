//! What Nelder-Mead must reach on problems that did not tune it: the odd halves of the fits and of the boxes.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod problems;

use dfo::minimize;
use problems::calibration::{Fit, fits};

fn judging() -> impl Iterator<Item = Fit> {
    fits().into_iter().skip(1).step_by(2)
}

#[test]
fn fits_without_bounds_are_solved() {
    let (mut solved, mut all, mut evaluations) = (0, 0, Vec::new());
    for fit in judging() {
        for start in fit.starts() {
            let report = minimize(|p: &[f64]| fit.cost(p)).start(&start).run().unwrap();
            let good = report.fun <= 1e-6;
            (solved, all) = (solved + usize::from(good), all + 1);
            evaluations.push(report.n_evaluations);
            if !good {
                println!("{} from {start:?}: {:e} at {:?}", fit.name, report.fun, report.x);
            }
        }
    }
    evaluations.sort_unstable();
    println!("{solved} of {all} fits, median {} evaluations", evaluations[all / 2]);
    assert!(solved * 100 >= 90 * all && evaluations[all / 2] <= 350, "{solved} of {all}");
}

#[test]
fn units_do_not_change_the_path() {
    for (number, fit) in judging().enumerate() {
        let start = &fit.starts()[number % 3];
        // Powers of two, so that the products are exact; a negative one turns the axis.
        let units: Vec<f64> =
            (0..start.len()).map(|k| [1048576.0, -0.125, 2f64.powi(-30)][(k + number) % 3]).collect();
        let run = |units: &[f64]| {
            let x0: Vec<f64> = start.iter().zip(units).map(|(x, c)| x / c).collect();
            let cost = |x: &[f64]| fit.cost(&x.iter().zip(units).map(|(x, c)| x * c).collect::<Vec<_>>());
            let report = minimize(cost).start(&x0).run().unwrap();
            let x: Vec<f64> = report.x.iter().zip(units).map(|(x, c)| x * c).collect();
            (x, report.fun, report.n_evaluations, report.termination)
        };
        assert_eq!(run(&vec![1.0; start.len()]), run(&units), "{}", fit.name);
    }
}
