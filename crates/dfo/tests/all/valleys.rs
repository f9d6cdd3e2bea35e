//! Chained Rosenbrock functions in boxes: quadratic models claim success only at stationary points.
#![allow(clippy::unwrap_used)]

use crate::problems;

use dfo::{AnyMethod, Search, minimize};
use problems::rotated::Random;

fn cost(x: &[f64]) -> f64 {
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

/// Returns the largest component of the gradient. Components that a bound blocks are ignored.
fn slope(x: &[f64], lower: &[f64], upper: &[f64]) -> f64 {
    let mut gradient = vec![0.0; x.len()];
    for i in 0..x.len() - 1 {
        let d = x[i + 1] - x[i] * x[i];
        gradient[i] += -400.0 * x[i] * d - 2.0 * (1.0 - x[i]);
        gradient[i + 1] += 200.0 * d;
    }
    // A point within the resolution of a bound is on it.
    let is_blocked = |k: usize| {
        x[k] <= lower[k] + 1e-6 && gradient[k] > 0.0 || x[k] >= upper[k] - 1e-6 && gradient[k] < 0.0
    };
    (0..x.len()).filter(|&k| !is_blocked(k)).map(|k| gradient[k].abs()).fold(0.0, f64::max)
}

/// Kinds of boxes.
const BOXES: [&str; 7] = ["none", "narrow", "wide for some starts", "wide", "unequal", "near", "active"];

/// Returns a box of this kind around a start, which is moved into it.
fn box_around(kind: &str, x: &mut [f64]) -> (Vec<f64>, Vec<f64>) {
    let each = |of: &dyn Fn(usize) -> f64| (0..x.len()).map(of).collect::<Vec<f64>>();
    let (lower, upper) = match kind {
        "none" => (each(&|_| f64::NEG_INFINITY), each(&|_| f64::INFINITY)),
        "narrow" => (each(&|_| -5.0), each(&|_| 5.0)),
        "wide for some starts" => (each(&|_| -50.0), each(&|_| 50.0)),
        "wide" => (each(&|_| -1e3), each(&|_| 1e3)),
        "unequal" => (each(&|k| -3.0 - 7.0 * (k % 3) as f64), each(&|k| 40.0 + 30.0 * (k % 2) as f64)),
        "near" => (each(&|k| x[k].min(1.0) - 1e-3), each(&|_| 50.0)),
        _ => (each(&|_| -20.0), each(&|k| if k % 2 == 1 { 0.6 } else { 60.0 })),
    };
    for (k, x) in x.iter_mut().enumerate() {
        *x = x.clamp(lower[k], upper[k]);
    }
    (lower, upper)
}

/// For n from 4 on, the function also has a minimum near (-1, 1, ..., 1), which counts as a minimum.
#[test]
fn auto_claims_success_only_at_stationary_points_of_chained_rosenbrock() {
    let (mut wrong, mut n_success, mut n_runs) = (Vec::new(), 0, 0);
    for (number, kind) in BOXES.into_iter().enumerate() {
        for (n, seed) in (2..=10).flat_map(|n| [3, 4].map(|seed| (n, seed))) {
            let mut random = Random::new(1000 * seed + 10 * number as u64 + n as u64);
            let mut start: Vec<f64> = (0..n).map(|_| 5.0 * random.uniform() - 2.0).collect();
            let (lower, upper) = box_around(kind, &mut start);
            let run = minimize(cost).start(&start).bounds(&lower, &upper).unwrap();
            let report = run.method(AnyMethod::auto(Search::Local)).seed(seed).run().unwrap();
            n_runs += 1;
            n_success += usize::from(report.is_success());
            let steep = slope(&report.x, &lower, &upper);
            // Relative to the slopes of 1e3 and more at the starts.
            if report.is_success() && steep > 0.05 {
                wrong.push((kind, n, seed, report.fun, steep, report.n_evaluations));
            }
        }
    }
    assert!(wrong.is_empty() && 100 * n_success >= 95 * n_runs, "{n_success} of {n_runs}: {wrong:?}");
}
