//! A run ends with the evaluation that reaches its target.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{methods_for_costs, probe, timeless};
use dfo::{
    AnyMethod, Checkpoint, Limits, Lookahead, NelderMead, Outcome, Report, Resume, Termination, Trace,
    by_hand, minimize,
};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Every method, with a plan that does not depend on the workers.
fn methods() -> Vec<AnyMethod> {
    let mut all: Vec<AnyMethod> = methods_for_costs();
    for method in &mut all {
        match method {
            AnyMethod::NelderMead(m) => m.batch = Lookahead::None,
            AnyMethod::Barrier(m) => *m = m.clone().batch(Lookahead::None),
            AnyMethod::PatternSearch(m) => m.batch = Lookahead::None,
            _ => {}
        }
    }
    all.extend([Lookahead::Points(20), Lookahead::Points(4)].map(|p| NelderMead::default().batch(p).into()));
    all
}

fn limits(target: Option<f64>) -> Limits {
    Limits { max_evaluations: Some(300), target, ..Limits::default() }
}

/// Returns the report and the number of calls of the objective.
fn run(method: &AnyMethod, target: Option<f64>, workers: usize, file: Option<Checkpoint>) -> (Report, usize) {
    let calls = AtomicUsize::new(0);
    let cost = |x: &[f64]| {
        calls.fetch_add(1, Ordering::Relaxed);
        probe(x)
    };
    let m = minimize(cost).start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap().method(method.clone());
    let m = m.seed(11).limits(limits(target)).workers(workers);
    let report = file.into_iter().fold(m, |m, file| m.checkpoint(file)).run().unwrap();
    (report, calls.into_inner())
}

/// Returns indices and costs of some of the evaluations that are better than all earlier ones.
fn records(trace: &Trace) -> Vec<(usize, f64)> {
    let mut best = f64::INFINITY;
    let mut records = Vec::new();
    for (k, e) in trace.iter().enumerate() {
        if let Some(cost) = e.outcome.value().filter(|cost| *cost <= e.cutoff && *cost < best) {
            best = cost;
            records.push((k, cost));
        }
    }
    records.into_iter().step_by(3).collect()
}

#[test]
fn path_ends_with_evaluation_that_reaches_target() {
    for method in methods() {
        let (whole, _) = run(&method, None, 1, None);
        for (place, target) in records(&whole.trace) {
            for workers in [1, 2, 5] {
                let (report, calls) = run(&method, Some(target), workers, None);
                assert_eq!(report.termination, Termination::Target, "{report}");
                assert_eq!((report.n_evaluations, report.fun), (place + 1, target), "{workers}: {report}");
                assert_eq!(calls, report.n_evaluations + report.n_speculative, "{workers}: {report}");
                let path = |trace: &Trace| -> Vec<_> {
                    timeless(trace).into_iter().map(|e| (e.0, e.1, e.2, e.3, e.4)).take(place + 1).collect()
                };
                assert_eq!(path(&report.trace), path(&whole.trace));
                // Some plans also look ahead with one worker.
                if workers == 1 && whole.n_speculative == 0 {
                    assert_eq!(report.n_speculative, 0, "{report}");
                }
            }
        }
    }
}

#[test]
fn ask_tell_run_ends_at_target() {
    for method in methods() {
        let (whole, _) = run(&method, None, 1, None);
        for (place, target) in records(&whole.trace) {
            for (at_most, backwards) in [(1, false), (3, true), (100, true)] {
                let m = by_hand().start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap();
                let m = m.method(method.clone()).seed(11).limits(limits(Some(target)));
                let mut optimizer = m.optimizer().unwrap();
                while optimizer.termination().is_none() {
                    let mut points = optimizer.ask(at_most);
                    if backwards {
                        points.reverse();
                    }
                    for point in points {
                        let cost = probe(&point.x);
                        let outcome =
                            if cost.is_nan() { Outcome::failed("cost is NaN") } else { Outcome::Value(cost) };
                        optimizer.tell(point.id, outcome).unwrap();
                    }
                }
                let report = optimizer.report().unwrap();
                assert_eq!((report.n_evaluations, report.fun), (place + 1, target), "{at_most}: {report}");
                assert_eq!(report.termination, Termination::Target);
            }
        }
    }
}

#[test]
fn run_continues_identically_after_target() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run");
    for method in methods() {
        let (whole, _) = run(&method, None, 1, None);
        for (place, target) in records(&whole.trace) {
            for workers in [1, 3] {
                let (first, _) =
                    run(&method, Some(target), workers, Some(Checkpoint::new(&path).resume(Resume::Never)));
                let again = Checkpoint::new(&path).resume(Resume::Require);
                let (same, calls) = run(&method, Some(target), workers, Some(again.clone()));
                assert_eq!((calls, same.n_evaluations, &same.x), (0, place + 1, &first.x), "{same}");
                assert_eq!(same.termination, Termination::Target);
                let (rest, _) = run(&method, None, workers, Some(again));
                assert_eq!(timeless(&rest.trace), timeless(&whole.trace), "{rest}");
                assert_eq!((&rest.x, &rest.message), (&whole.x, &whole.message));
            }
        }
    }
}
