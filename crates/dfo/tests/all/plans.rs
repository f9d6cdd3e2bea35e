//! The path is the same for every plan and any number of workers, with and without cutoffs.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{PLANS, cutting, plan, problems, run_with_path, timeless};
use dfo::{BatchView, Lookahead, Outcome, minimize, minimize_batches};

#[test]
fn all_plans_follow_the_same_path() {
    for problem in problems() {
        let (serial, path) = run_with_path(problem.minimize().method(plan(Lookahead::None))).unwrap();
        assert_eq!(serial.n_speculative, 0);
        for p in [Lookahead::Points(2), Lookahead::Points(4)] {
            let (report, other) = run_with_path(problem.minimize().method(plan(p))).unwrap();
            assert_eq!(path, other, "{} {p:?}", problem.name);
            assert_eq!(
                (&serial.x, serial.fun, serial.n_iterations, &serial.termination, &serial.message),
                (&report.x, report.fun, report.n_iterations, &report.termination, &report.message),
                "{} {p:?}",
                problem.name
            );
            let used: Vec<_> = report.trace.iter().filter(|e| e.used).map(|e| (e.x, e.outcome)).collect();
            let all: Vec<_> = serial.trace.iter().map(|e| (e.x, e.outcome)).collect();
            assert_eq!(used.len(), all.len(), "{}", problem.name);
            assert_eq!(report.n_evaluations, serial.n_evaluations);
            assert_eq!(report.trace.speculative().len(), report.n_speculative);
            assert!(report.n_batches <= serial.n_batches);
        }
    }
}

#[test]
fn cutoffs_do_not_change_decisions() {
    let mut saved = 0;
    for problem in problems() {
        let (plain, path) = run_with_path(problem.minimize().method(plan(Lookahead::None))).unwrap();
        for p in PLANS {
            let cut = problem.set_up(minimize(cutting(problem.f))).method(plan(p));
            let (report, other) = run_with_path(cut).unwrap();
            assert_eq!(path, other, "{} {p:?}", problem.name);
            assert_eq!((&plain.x, plain.fun, &plain.message), (&report.x, report.fun, &report.message));
            for e in report.trace.iter() {
                if let Outcome::Above(c) = e.outcome {
                    assert_eq!(*c, e.cutoff);
                    saved += 1;
                }
            }
        }
    }
    assert!(saved > 1000, "{saved}");
}

#[test]
fn any_number_of_workers_gives_the_same_trace() {
    for problem in problems() {
        for p in PLANS {
            let serial = problem.set_up(minimize(cutting(problem.f))).method(plan(p)).run().unwrap();
            for workers in [2, 7] {
                let report = problem
                    .set_up(minimize(cutting(problem.f)))
                    .method(plan(p))
                    .workers(workers)
                    .run()
                    .unwrap();
                assert_eq!(timeless(&serial.trace), timeless(&report.trace), "{} {p:?}", problem.name);
                assert_eq!(
                    (&serial.x, serial.fun, &serial.final_simplex),
                    (&report.x, report.fun, &report.final_simplex)
                );
                assert_eq!(serial.message, report.message);
            }
            let f = problem.f;
            let batches = problem
                .set_up(minimize_batches(move |b| {
                    (0..b.len()).map(|k| Outcome::Value(f(b.point(k)))).collect()
                }))
                .method(plan(p))
                .run()
                .unwrap();
            assert_eq!((&serial.x, serial.fun, &serial.message), (&batches.x, batches.fun, &batches.message));
        }
    }
}

#[test]
fn short_evaluations_cause_no_speculation() {
    // The duration of evaluations determines which ones stay on the calling thread. `evaluation/timing.rs`
    // tests this with given times.
    for workers in [1, 2, 4, 9] {
        let report = minimize(common::rosenbrock).start(&[-1.2, 1.0]).workers(workers).run().unwrap();
        assert_eq!((&*report.batch, report.workers, report.n_speculative), ("auto", workers, 0));
        assert_eq!(report.n_failed, 0);
    }
}

#[test]
fn unused_points_are_never_best() {
    // Each unused point in turn is by far the best point ever seen.
    let trap = |at: Option<Vec<f64>>| {
        move |x: &[f64]| if at.as_deref() == Some(x) { -1e9 } else { common::rosenbrock(x) }
    };
    let run = |at| {
        let cost = trap(at);
        let in_batches = |b: &BatchView<'_>| (0..b.len()).map(|k| Outcome::Value(cost(b.point(k)))).collect();
        let run = minimize_batches(in_batches).start(&[-1.2, 1.0]).method(plan(Lookahead::Points(4)));
        run.max_iterations(30).run().unwrap()
    };
    let plain = run(None);
    let mut tried = 0;
    // An unneeded point may occur again and then be needed.
    let met_again = |x: &[f64]| plain.trace.iter().any(|o| o.used && o.x == x);
    for e in plain.trace.speculative().filter(|e| !met_again(e.x)) {
        let report = run(Some(e.x.to_vec()));
        assert_eq!((&report.x, report.fun), (&plain.x, plain.fun));
        assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
        tried += 1;
    }
    assert!(tried > 30 && tried + 5 > plain.n_speculative, "{tried} {}", plain.n_speculative);
}
