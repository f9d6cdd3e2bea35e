//! Tuning of the constants of quadratic models: fraction of solved problems and median of the evaluations in
//! units of n + 1. The even halves of the smooth instances, fits and boxes tune the constants (`cargo
//! bench --bench quadratic`). The odd halves are for their assessment (`-- judge`).
#![allow(clippy::print_stdout, clippy::unwrap_used, clippy::panic)]

#[path = "../tests/problems/mod.rs"]
mod problems;

use dfo::{QuadraticModel, minimize};
use problems::boxes::boxes;
use problems::calibration::fits;
use problems::instances;

/// Evaluations in units of n + 1, infinite if the result is wrong, and whether a wrong result was reported as
/// a success.
type Run = (f64, bool);

fn show(title: &str, mut runs: Vec<Run>) {
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let solved = runs.iter().filter(|run| run.0.is_finite()).count();
    let mean = runs.iter().map(|run| run.0.min(200.0).ln()).sum::<f64>() / runs.len() as f64;
    println!(
        "{title:24} {solved:3} of {:3}, median {:5.1}, geometric mean {:5.1} (n + 1), wrong with success: {}",
        runs.len(),
        runs[runs.len() / 2].0,
        mean.exp(),
        runs.iter().filter(|run| run.1).count()
    );
}

fn main() {
    let judging = std::env::args().any(|a| a == "judge");
    let chosen = |k: usize| (k % 2 == 1) == judging;
    let of = |good: bool, evaluations: usize, n: usize, success: bool| {
        let units = if good { evaluations as f64 / (n + 1) as f64 } else { f64::INFINITY };
        (units, success && !good)
    };

    let mut runs = Vec::new();
    for (_, p) in instances().iter().enumerate().filter(|(k, _)| chosen(*k)) {
        let first = p.cost(&p.start());
        let goal = first - (1.0 - 1e-5) * (first - p.best);
        let run = minimize(|x: &[f64]| p.cost(x)).start(&p.start()).method(QuadraticModel::default());
        let run = run.x_tol(0.0).f_tol(0.0).target(goal).max_evaluations(100 * (p.n + 1)).run().unwrap();
        runs.push(of(run.fun <= goal, run.n_evaluations, p.n, false));
    }
    show("smooth, tau 1e-5", runs);

    for boxed in [false, true] {
        let mut runs = Vec::new();
        for (_, fit) in fits().iter().enumerate().filter(|(k, _)| chosen(*k)) {
            let ends = |inner: f64, outer: f64| -> Vec<f64> {
                fit.truth.iter().map(|t| t * if *t > 0.0 { inner } else { outer }).collect()
            };
            for start in fit.starts() {
                let run = minimize(|p: &[f64]| fit.cost(p)).start(&start).method(QuadraticModel::default());
                let run = if boxed { run.bounds(&ends(0.2, 3.0), &ends(3.0, 0.2)).unwrap() } else { run };
                let run = run.run().unwrap();
                runs.push(of(run.fun <= 1e-6, run.n_evaluations, start.len(), run.is_success()));
            }
        }
        show(if boxed { "fits in boxes" } else { "fits without bounds" }, runs);
    }

    let mut runs = Vec::new();
    for p in boxes(judging) {
        for start in p.starts() {
            let run = minimize(|x: &[f64]| (p.cost)(x)).start(&start).method(QuadraticModel::default());
            let run = run.bounds(&p.lower, &p.upper).unwrap().run().unwrap();
            let good = run.fun - p.best <= 1e-6 * ((p.cost)(&p.start) - p.best);
            runs.push(of(good, run.n_evaluations, start.len(), run.is_success()));
        }
    }
    show("boxes", runs);
}
