//! Number of rounds that Nelder-Mead needs if several points are evaluated at once, counted without a clock.
#![allow(clippy::unwrap_used)]

use crate::problems::calibration;

use dfo::{BatchView, Lookahead, NelderMead, Outcome, minimize_batches};
use std::cell::Cell;

type Problem = (Vec<f64>, Box<dyn Fn(&[f64]) -> f64>);

fn problems() -> Vec<Problem> {
    let mut all: Vec<Problem> = Vec::new();
    for fit in calibration::fits().into_iter().skip(1).step_by(4) {
        all.push((fit.starts()[0].clone(), Box::new(move |x| fit.cost(x))));
    }
    for n in 2..=6 {
        let rosenbrock = |x: &[f64]| {
            x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
        };
        all.push(((0..n).map(|k| [-1.2, 1.0][k % 2]).collect(), Box::new(rosenbrock)));
        let quadratic = |x: &[f64]| {
            let axes = x.iter().enumerate().map(|(k, v)| 5f64.powi(k as i32) * (v - 0.3).powi(2));
            axes.sum::<f64>() + x.windows(2).map(|w| (w[0] - w[1]).powi(2)).sum::<f64>()
        };
        all.push(((0..n).map(|k| 1.0 + k as f64).collect(), Box::new(quadratic)));
    }
    all
}

/// Returns the rounds to the target, or `None` if it is not reached. `workers` simultaneous evaluations count
/// as one round.
fn rounds((start, cost): &Problem, batch: Lookahead, workers: usize, target: f64) -> Option<usize> {
    let count = Cell::new(0);
    let evaluate = |view: &BatchView<'_>| {
        count.set(count.get() + view.len().div_ceil(workers));
        (0..view.len()).map(|k| Outcome::Value(cost(view.point(k)))).collect()
    };
    let run = minimize_batches(evaluate).start(start).workers(workers).max_evaluations(3000).target(target);
    let report = run.method(NelderMead::default().batch(batch)).run().unwrap();
    (report.fun <= target).then_some(count.get())
}

/// Lee and Wiswall's method needs 0.63 to 0.38 of the serial rounds here (2 to 19 workers, target 1e-2), and
/// 0.67 to 0.39 (1e-6). Speculative points must need fewer. Their number is at most twice the number of
/// points of the path, which limits the gain with 19 workers.
#[test]
fn every_number_of_workers_saves_rounds() {
    for (share, bars) in [(1e-2, [0.65, 0.53, 0.43, 0.38, 0.35]), (1e-6, [0.61, 0.5, 0.42, 0.36, 0.35])] {
        let mut ratios = [const { Vec::new() }; 5];
        for problem in problems() {
            let target = share * (problem.1)(&problem.0);
            let Some(serial) = rounds(&problem, Lookahead::None, 1, target) else { continue };
            let mut before = serial;
            for (workers, ratios) in [2, 3, 5, 8, 19].into_iter().zip(&mut ratios) {
                let ahead = rounds(&problem, Lookahead::Workers, workers, target).unwrap();
                let more = 10 * ahead > 11 * before + 10;
                assert!(!more, "{workers} workers: {ahead} rounds, fewer ones: {before}");
                before = ahead;
                ratios.push((ahead as f64 / serial as f64).ln());
            }
        }
        for (ratios, bar) in ratios.iter().zip(bars) {
            let mean = (ratios.iter().sum::<f64>() / ratios.len() as f64).exp();
            println!("{share:e}: {mean:.3} of the serial rounds ({} problems)", ratios.len());
            assert!(ratios.len() >= 15 && mean <= bar, "{share:e}: {mean} > {bar}");
        }
    }
}
