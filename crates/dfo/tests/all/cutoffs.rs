//! An objective that stops early above its cutoff gives the same path, counts and result as one that never
//! does.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{cutting, probe};
use dfo::{
    AnyMethod, Checkpoint, DifferentialEvolution, Minimize, NelderMead, Objective, ParameterKind, Report,
    Resume, Termination, minimize,
};

fn steps(x: &[f64]) -> f64 {
    x.iter().enumerate().map(|(k, x)| (3.0 * (x - 0.4 * k as f64 + 0.7)).floor().powi(2)).sum::<f64>() + 0.5
}

fn hills(x: &[f64]) -> f64 {
    let t = |k: usize| x[k] - [3.3, -4.1, 1.7][k];
    (0..3).map(|k| t(k).powi(2) + 3.0 * (1.0 - (2.0 * t(k)).cos())).sum::<f64>() + 0.4 * t(0) * t(2)
}

/// Returns all counts and results of a run.
fn counts(r: &Report) -> (Vec<u64>, [usize; 5], Termination, Vec<Vec<u64>>) {
    let bits = |x: &[f64]| x.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let counts = [r.n_evaluations, r.n_iterations, r.n_failed, r.n_cached, r.n_batches];
    (bits(&r.x), counts, r.termination.clone(), r.trace.iter().map(|e| bits(e.x)).collect())
}

#[test]
fn point_repeated_with_larger_cutoff_does_not_count() {
    let set_up = |m: Minimize<'static, NelderMead>, method: &AnyMethod, budget: usize, seed: u64| {
        let m = m
            .bounds(&[-9.0; 3], &[9.0; 3])
            .unwrap()
            .kinds(&[ParameterKind::Integer; 3])
            .method(method.clone());
        m.seed(seed)
            .max_evaluations(budget)
            .cache(if seed.is_multiple_of(2) { 10_000 } else { 50 })
            .run()
            .unwrap()
    };
    for method in [DifferentialEvolution::default(), DifferentialEvolution::classic()] {
        let method: AnyMethod = method.population(12).into();
        for seed in 0..20 {
            let budget = 60 + 13 * seed as usize;
            let whole = set_up(minimize(hills), &method, budget, seed);
            let cut = set_up(minimize(cutting(hills)), &method, budget, seed);
            assert_eq!(counts(&cut), counts(&whole), "{method:?} {seed}");
            assert_eq!(cut.trace.best(), Some((&cut.x[..], cut.fun)));
        }
    }
}

#[test]
fn simplex_point_repeated_with_larger_cutoff_does_not_count() {
    fn run(objective: impl Objective + 'static, method: &str, start: f64, budget: usize) -> Report {
        let method: AnyMethod = method.parse().unwrap();
        let m = minimize(objective).start(&[start, 1.0 - start]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap();
        m.method(method).cache(500).max_evaluations(budget).run().unwrap()
    }
    for method in ["nelder-mead", "barrier"] {
        for k in 0..40 {
            let (start, budget) = (-0.9 + 0.037 * f64::from(k), 20 + 17 * k as usize);
            for f in [steps, probe] {
                let (whole, cut) = (run(f, method, start, budget), run(cutting(f), method, start, budget));
                assert_eq!(counts(&cut), counts(&whole), "{method} {start}");
            }
        }
    }
}

#[test]
fn truncated_run_continues_identically() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    let run = |budget: usize, checkpoint: Option<Checkpoint>| {
        let m = minimize(cutting(hills))
            .bounds(&[-9.0; 3], &[9.0; 3])
            .unwrap()
            .kinds(&[ParameterKind::Integer; 3]);
        let m = m.method(DifferentialEvolution::classic().population(12)).seed(3).max_evaluations(budget);
        checkpoint.into_iter().fold(m, |m, c| m.checkpoint(c)).run().unwrap()
    };
    let whole = run(150, None);
    for budget in [20, 57, 110, 130] {
        run(budget, Some(Checkpoint::new(&path).resume(Resume::Never)));
        let resumed = run(150, Some(Checkpoint::new(&path).resume(Resume::Require)));
        assert_eq!(counts(&resumed).0, counts(&whole).0);
        assert_eq!(counts(&resumed).3, counts(&whole).3);
        assert_eq!((resumed.n_evaluations, resumed.n_cached), (whole.n_evaluations, whole.n_cached));
    }
}
