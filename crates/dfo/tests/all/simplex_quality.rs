//! Requirements on Nelder-Mead for problems that were not used for tuning: fits and boxes with odd numbers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::problems;

use dfo::{Bounds, Transform, minimize};
use problems::boxes::{Boxed, Place, boxes, quadratic};
use problems::calibration::{Fit, fits};

fn judging() -> impl Iterator<Item = Fit> {
    fits().into_iter().skip(1).step_by(2)
}

#[test]
fn nelder_mead_solves_fits_without_bounds() {
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
fn path_is_independent_of_units() {
    for (number, fit) in judging().enumerate() {
        let start = &fit.starts()[number % 3];
        // Powers of two keep the products exact, and a negative one reverses the axis. No start becomes
        // smaller than 1.5e-8, below which it is only a first guess of the size.
        let units: Vec<f64> =
            (0..start.len()).map(|k| [4.0, -0.125, 2f64.powi(-30)][(k + number) % 3]).collect();
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

fn run(p: &Boxed, start: &[f64]) -> dfo::Report {
    let cost = |x: &[f64]| {
        assert!(x.iter().zip(p.lower.iter().zip(&p.upper)).all(|(x, (l, u))| l <= x && x <= u), "{x:?}");
        (p.cost)(x)
    };
    minimize(cost).start(start).bounds(&p.lower, &p.upper).unwrap().run().unwrap()
}

#[test]
fn minima_on_bounds_are_found_from_anywhere() {
    let (mut solved, mut all, mut evaluations) = (0, 0, Vec::new());
    for p in boxes(true) {
        for start in p.starts() {
            let report = run(&p, &start);
            assert_eq!(report.trace.iter().next().unwrap().x, start);
            let first = (p.cost)(&p.start) - p.best;
            let good = report.fun - p.best <= 1e-6 * first;
            (solved, all) = (solved + usize::from(good), all + 1);
            evaluations.push(report.n_evaluations);
            if !good {
                println!(
                    "{} from {start:?}: {:e} of {first:e}: {}",
                    p.name,
                    report.fun - p.best,
                    report.message
                );
            }
        }
    }
    evaluations.sort_unstable();
    let mean = evaluations.iter().sum::<usize>() / all;
    println!("{solved} of {all} in boxes, median {} evaluations, mean {mean}", evaluations[all / 2]);
    assert!(
        solved * 100 >= 92 * all && evaluations[all / 2] <= 800 && mean <= 1500,
        "{solved} of {all}, {mean}"
    );
}

/// A corner minimum needs no more evaluations than an interior one and is found within x_tol.
#[test]
fn corner_minimum_needs_no_more_evaluations_than_interior() {
    for (n, seed) in [(3, 11), (5, 12), (10, 13)] {
        let [corner, interior] = [Place::Corner, Place::Interior].map(|place| {
            let p = quadratic(n, place, 1e3, seed);
            let report = run(&p, &p.start);
            assert!(report.fun <= 1e-6 * (p.cost)(&p.start) && report.is_success(), "{report}");
            let near = |k: usize| {
                (report.x[k] - p.lower[k]).min(p.upper[k] - report.x[k]) / (p.upper[k] - p.lower[k])
            };
            assert!(place == Place::Interior || (0..n).all(|k| near(k) <= 1e-6), "{report}");
            report.n_evaluations
        });
        println!("n = {n}: corner {corner}, interior {interior}");
        assert!(corner <= 2 * interior, "n = {n}: {corner} against {interior}");
    }
}

#[test]
fn nelder_mead_handles_single_bounds_and_logarithms() {
    // x0 >= 0 and active, x1 in a logarithmic box and at its end, x2 logarithmic without bounds, x3 <= 2 and
    // active.
    let lower = [0.0, 1e-3, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let upper = [f64::INFINITY, 1e3, f64::INFINITY, 2.0];
    let cost = |x: &[f64]| {
        let d = [x[0] + 1.0, x[1].log10() + 5.0, x[2].ln() - 2.0, x[3] - 3.0 + 0.1 * x[0]];
        d.iter().map(|d| d * d).sum::<f64>() - 1.0 - 4.0 - 1.0
    };
    let scales = [Transform::Linear, Transform::Log, Transform::Log, Transform::Linear];
    for start in [[1.0, 1.0, 1.0, 0.0], [0.0, 1e-3, 1e4, 2.0], [50.0, 1e3, 1e-3, -400.0]] {
        let report =
            minimize(cost).start(&start).bounds(&lower, &upper).unwrap().transforms(&scales).run().unwrap();
        assert!(report.is_success() && report.fun < 1e-7, "{report}");
        assert!(Bounds::new(&lower, &upper).unwrap().contains(&report.x));
        assert!(report.x[0] < 1e-6 && report.x[1] < 1.0001e-3 && report.x[3] > 2.0 - 1e-6, "{report}");
    }
}

/// If the start is the best point, it is the result, even if all of its bounds are active.
#[test]
fn result_is_never_worse_than_start() {
    let cost = |x: &[f64]| x[0] - x[1] + 0.1 * (x[2] - 0.3).abs();
    let start = [0.0, 1.0, 0.3];
    let report = minimize(cost).start(&start).bounds(&[0.0; 3], &[1.0; 3]).unwrap().run().unwrap();
    assert_eq!((report.fun, report.x), (-1.0, start.to_vec()));
}

/// A minimum of zero needs no more evaluations than its accuracy requires, and no more than a minimum of one.
#[test]
fn minimum_of_zero_needs_no_extra_evaluations() {
    let rosenbrock = |x: &[f64]| -> f64 {
        x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
    };
    let bowl = |x: &[f64]| -> f64 { x.iter().enumerate().map(|(k, x)| (x - 3.0 - k as f64).powi(2)).sum() };
    type Cost = dyn Fn(&[f64]) -> f64 + Sync;
    let cases: [(&Cost, &[f64]); 4] =
        [(&rosenbrock, &[-1.2, 1.0]), (&rosenbrock, &[-1.2; 4]), (&bowl, &[0.0; 4]), (&bowl, &[1.0; 10])];
    for (f, start) in cases {
        let run = |offset: f64| minimize(|x: &[f64]| f(x) + offset).start(start).run().unwrap();
        let [zero, one] = [0.0, 1.0].map(run);
        let goal = 1e-12 * f(start);
        let reached =
            zero.trace.iter().position(|e| e.outcome.value().is_some_and(|v| v <= goal)).unwrap() + 1;
        println!(
            "n = {}: {reached} to 1e-12, stops after {} and {}",
            start.len(),
            zero.n_evaluations,
            one.n_evaluations
        );
        assert!(zero.is_success() && one.is_success());
        assert!(10 * zero.n_evaluations <= 12 * reached + 50, "{reached}: {zero}");
        assert!(10 * zero.n_evaluations <= 11 * one.n_evaluations, "{zero}{one}");
        assert!(one.fun - 1.0 <= 1e-9, "{one}");
    }
}

/// Returns random numbers from 0 to 1 (Knuth's MMIX constants).
fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Parameters with sizes from 1e-6 to 1e6 of which all or all but one start at zero, in valleys that are not
/// along the axes.
#[test]
fn nelder_mead_finds_unknown_sizes() {
    let (mut solved, mut wrong, mut evaluations) = (0, 0, Vec::new());
    for seed in 0..120 {
        let mut next = random(seed);
        for _ in 0..9 {
            next();
        }
        let n = 2 + seed as usize % 4;
        let sizes: Vec<f64> = (0..n).map(|_| 10f64.powf(12.0 * next() - 6.0)).collect();
        let minimum: Vec<f64> =
            sizes.iter().map(|s| s * (0.3 + 2.0 * next()) * if next() < 0.5 { -1.0 } else { 1.0 }).collect();
        let rows: Vec<Vec<f64>> = (0..n).map(|_| (0..n).map(|_| 2.0 * next() - 1.0).collect()).collect();
        let offset = [0.0, 1.0, 100.0][seed as usize % 3];
        let cost = |x: &[f64]| -> f64 {
            let u: Vec<f64> = (0..n).map(|k| (x[k] - minimum[k]) / sizes[k]).collect();
            let row = |i: usize| rows[i].iter().zip(&u).map(|(a, u)| a * u).sum::<f64>() + u[i];
            offset + (0..n).map(|i| row(i).powi(2)).sum::<f64>()
        };
        let mut start = vec![0.0; n];
        if seed % 2 == 1 {
            start[0] = 0.5 * minimum[0];
        }
        let report = minimize(cost).start(&start).run().unwrap();
        let good = report.fun - offset <= 1e-4 * (cost(&start) - offset);
        solved += usize::from(good);
        wrong += usize::from(!good && report.is_success());
        evaluations.push(report.n_evaluations);
        assert_eq!(report.trace.iter().next().unwrap().x, start);
        let parallel = minimize(cost).start(&start).workers(3).run().unwrap();
        assert_eq!((parallel.x, parallel.n_evaluations), (report.x, report.n_evaluations));
    }
    evaluations.sort_unstable();
    println!("{solved} of 120, median {} evaluations, wrong with success: {wrong}", evaluations[60]);
    assert!(solved >= 117 && wrong <= 2 && evaluations[60] <= 450, "{solved}, {wrong}");
}

/// The second parameter has no effect at the start. It has an effect once the first parameter has reached its
/// value.
#[test]
fn parameter_with_later_effect_is_found() {
    for size in [1e-5, 1.0, 1e5] {
        let cost = |x: &[f64]| (x[0] - 3.0).powi(2) + (x[0].powi(3) * (x[1] / size - 2.0)).powi(2);
        let report = minimize(cost).start(&[0.0, 0.0]).run().unwrap();
        assert!(report.is_success() && report.fun < 1e-9, "{report}");
        assert!((report.x[1] / size - 2.0).abs() < 1e-4, "{report}");
    }
}

#[test]
fn report_names_parameter_without_effect() {
    let report = minimize(|x: &[f64]| (x[0] - 3.0).powi(2)).start(&[1.0, 0.0]).run().unwrap();
    assert!(report.is_success() && report.message.contains("no step of x[1] from zero"), "{report}");
    let reported =
        minimize(|x: &[f64]| (x[0] - 3.0).powi(2)).start(&[1.0, 0.0]).scales(&[1.0, 1.0]).run().unwrap();
    assert!(!reported.message.contains("no step"), "{reported}");
    let partly = minimize(|x: &[f64]| (x[0] - 3.0).powi(2) + x[1].powi(2))
        .start(&[1.0, 0.0])
        .optional_scales(&[None, Some(1.0)])
        .run()
        .unwrap();
    assert!(partly.is_success() && partly.fun < 1e-10, "{partly}");
}

/// A bound on one side does not determine the size.
#[test]
fn single_bound_does_not_determine_size() {
    for size in [1e-6, 1.0, 1e6] {
        let cost = |x: &[f64]| (x[0] / size - 2.0).powi(2) + (x[0] / size - x[1] + 3.0).powi(2);
        let bounds = ([0.0, f64::NEG_INFINITY], [f64::INFINITY; 2]);
        let report = minimize(cost).start(&[0.0, 1.0]).bounds(&bounds.0, &bounds.1).unwrap().run().unwrap();
        assert!(report.is_success() && report.fun < 1e-9, "{report}");
    }
}
