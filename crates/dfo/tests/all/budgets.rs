//! Budgets are exact, and the best point is never lost, however a run ends.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{PLANS, plan, probe, problems, quiet_panics_on_purpose, rosenbrock};
use dfo::{BoundsHandling, Error, Lookahead, NelderMead, Outcome, Query, Termination, minimize, with_query};
use std::ops::ControlFlow;
use std::time::Duration;

#[test]
fn evaluation_budgets_are_exact() {
    for problem in problems() {
        for p in PLANS {
            for budget in 1..=200 {
                let report = match problem.minimize().method(plan(p)).max_evaluations(budget).run() {
                    Ok(report) => report,
                    Err(Error::EndedWithoutPoint { termination, found }) => {
                        assert_eq!((termination, found.n_evaluations), (Termination::MaxEvaluations, budget));
                        continue;
                    }
                    Err(e) => panic!("{}: {e}", problem.name),
                };
                assert!(report.n_evaluations <= budget && report.trace.len() == report.n_evaluations);
                if report.termination == Termination::MaxEvaluations {
                    assert_eq!(report.n_evaluations, budget);
                }
                assert_eq!(
                    report.trace.best(),
                    Some((&report.x[..], report.fun)),
                    "{} {budget}",
                    problem.name
                );
                assert_eq!((problem.f)(&report.x), report.fun);
            }
        }
    }
}

#[test]
fn budget_truncates_path_without_changing_it() {
    for p in PLANS {
        let whole = minimize(probe).start(&[-0.5, 1.0]).method(plan(p)).run().unwrap();
        for budget in 1..whole.n_evaluations {
            let part =
                minimize(probe).start(&[-0.5, 1.0]).method(plan(p)).max_evaluations(budget).run().unwrap();
            for (a, b) in part.trace.iter().zip(whole.trace.iter()) {
                assert_eq!((a.x, a.id, a.batch), (b.x, b.id, b.batch));
                // The last batch may be truncated before the point that determines whether an earlier point
                // is needed.
                let cut = p == Lookahead::Points(20) && !a.used && a.batch + 1 == part.n_batches as u64;
                assert!(a.used == b.used || cut, "{p:?} {budget}");
            }
        }
    }
}

#[test]
fn iteration_budgets_are_exact_for_every_plan() {
    for problem in problems() {
        for budget in [0, 1, 2, 7, 33] {
            let reports =
                PLANS.map(|p| problem.minimize().method(plan(p)).max_iterations(budget).run().unwrap());
            for report in &reports {
                let is_over = report.is_success() || report.termination == Termination::ConstantCost;
                assert!(report.n_iterations == budget || is_over, "{}", problem.name);
                assert_eq!(
                    (&report.x, report.fun, report.n_iterations),
                    (&reports[0].x, reports[0].fun, reports[0].n_iterations)
                );
                assert_eq!(report.final_simplex, reports[0].final_simplex);
            }
        }
    }
}

#[test]
fn setting_one_limit_removes_the_default_of_the_other() {
    // A cost that decreases with every evaluation never converges, so only limits end the run.
    let falling = |_: &[f64], e: &Query<'_>| Outcome::Value(-(e.id as f64));
    let mirrored = NelderMead::default().bounds_handling(BoundsHandling::Mirror);
    let problem = || minimize(with_query(falling)).start(&[0.5]).bounds(&[0.0], &[1.0]).unwrap();
    let run = || problem().method(mirrored.clone());
    let by_default = run().run().unwrap();
    assert_eq!((by_default.termination, by_default.n_iterations), (Termination::MaxIterations, 2000));
    let more = run().max_evaluations(15_000).run().unwrap();
    assert_eq!((more.termination, more.n_evaluations), (Termination::MaxEvaluations, 15_000));
    let more = run().max_iterations(12_000).run().unwrap();
    assert_eq!((more.termination, more.n_iterations), (Termination::MaxIterations, 12_000));
    assert!(more.n_evaluations > 5000 * 2);
}

#[test]
fn target_ends_the_run_with_its_batch() {
    for p in PLANS {
        let report = minimize(rosenbrock).start(&[-1.2, 1.0]).method(plan(p)).target(0.5).run().unwrap();
        assert!(
            report.fun <= 0.5
                && report.termination == Termination::Target
                && report.message.contains("target")
        );
        let last = report.trace.get(report.trace.len() - 1).unwrap().batch;
        assert!(
            report.trace.iter().filter(|e| e.batch < last && e.used).all(|e| e.outcome.value() > Some(0.5))
        );
    }
}

#[test]
fn time_limit_returns_best_point() {
    let slow = with_query(|x: &[f64], e: &Query<'_>| {
        let until = std::time::Instant::now() + Duration::from_millis(if e.id < 3 { 1 } else { 5000 });
        while std::time::Instant::now() < until {
            if e.cancelled() {
                return Outcome::cancelled();
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Outcome::Value(rosenbrock(x))
    });
    let slow = &slow;
    for workers in [1, 4] {
        let report = minimize(dfo::ByRef(slow))
            .start(&[-1.2, 1.0])
            .workers(workers)
            .max_time(Duration::from_millis(100))
            .run()
            .unwrap();
        assert_eq!(report.termination, Termination::MaxTime, "{report}");
        assert!(report.seconds < 2.0 && report.fun <= rosenbrock(&[-1.2, 1.0]), "{report}");
        assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
        assert!(report.message.contains("0.1 s"), "{report}");
    }
    // Time spent before the run counts, and the message reports the whole limit.
    let hour = Duration::from_secs(3600);
    let short = hour - Duration::from_millis(100);
    let run = || minimize(dfo::ByRef(slow)).start(&[-1.2, 1.0]).max_time(hour);
    let report = run().spent(short).run().unwrap();
    assert_eq!(report.termination, Termination::MaxTime, "{report}");
    assert!(report.message.contains("3600 s"), "{report}");
    let nothing = run().spent(hour).run();
    assert!(matches!(nothing, Err(Error::EndedWithoutPoint { termination: Termination::MaxTime, .. })));
    let nothing = minimize(rosenbrock).start(&[-1.2, 1.0]).max_time(Duration::ZERO).run();
    assert!(matches!(nothing, Err(Error::EndedWithoutPoint { termination: Termination::MaxTime, .. })));
}

/// Objective that fails at one point, in one of several ways.
fn failing_at(k: usize, at: &[f64], how: usize) -> impl Fn(&[f64], &Query<'_>) -> Outcome + Sync {
    move |x, _| match (x == at, how) {
        (false, _) => Outcome::Value(rosenbrock(x)),
        (true, 0) => Outcome::failed("raised"),
        (true, 1) => Outcome::Value(f64::NAN),
        (true, 2) => panic!("on purpose at {k}"),
        (true, 3) => Outcome::Value(f64::NEG_INFINITY),
        (true, _) => Outcome::Abort("exception".to_owned()),
    }
}

#[test]
fn failure_at_any_evaluation_preserves_best_point() {
    quiet_panics_on_purpose();
    let plain = minimize(rosenbrock).start(&[-1.2, 1.0]).run().unwrap();
    for k in 0..60 {
        let at = plain.trace.get(k).unwrap().x;
        for how in 0..5 {
            for (p, workers) in PLANS.into_iter().zip([1, 2, 4]).chain([(PLANS[2], 1), (PLANS[0], 3)]) {
                let run = minimize(with_query(failing_at(k, at, how)))
                    .start(&[-1.2, 1.0])
                    .method(plan(p))
                    .workers(workers)
                    .max_evaluations(120)
                    .run();
                let report = match run {
                    Ok(report) => report,
                    Err(Error::EndedWithoutPoint { termination: Termination::Aborted(m), .. })
                        if how == 4 =>
                    {
                        assert_eq!((k, m.as_str()), (0, "exception"));
                        continue;
                    }
                    Err(e) => panic!("{e}"),
                };
                assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)), "{k} {how} {p:?}");
                assert_eq!(report.fun, rosenbrock(&report.x));
                if how == 4 {
                    assert_eq!(report.termination, Termination::Aborted("exception".to_owned()));
                    assert_eq!(report.n_failed, 0);
                    // All points requested before the failure count as usual.
                    for id in 0..=k as u64 {
                        assert!(report.trace.iter().any(|e| e.id == id), "{k} {p:?} lost {id}");
                    }
                } else {
                    // If the failure changes the path, the path may return to the point.
                    let failed = report.trace.iter().filter(|e| e.x == at).count();
                    assert!(failed > 0, "{k} {how} {p:?}");
                    assert_eq!((report.n_evaluations, report.n_failed), (120, failed), "{k} {how} {p:?}");
                }
            }
        }
    }
}

#[test]
fn observer_sees_each_evaluation_once_and_may_stop() {
    for p in PLANS {
        let mut seen = 0;
        let mut lines = Vec::new();
        let report = minimize(rosenbrock)
            .start(&[-1.2, 1.0])
            .method(plan(p))
            .observer(|progress| {
                seen += progress.recent().len();
                assert_eq!(seen, progress.n_evaluations);
                assert_eq!(progress.simplex.unwrap().cost(0), Some(progress.fun));
                assert_eq!(progress.simplex.unwrap().vertex(0), progress.x);
                lines.push((progress.n_iterations, progress.operation.to_string()));
                if progress.n_iterations == 9 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            })
            .run()
            .unwrap();
        assert_eq!(
            (report.termination.clone(), report.n_iterations, lines.len()),
            (Termination::StoppedByObserver, 9, 10)
        );
        assert_eq!((lines[0].1.as_str(), lines[9].0), ("initial", 9));
        assert!(!report.is_success() && report.message.contains("callback"));
    }
}

#[test]
fn too_many_failures_end_run_with_best_point() {
    for workers in [1, 3] {
        let cost = |x: &[f64]| if x[0] > 0.3 { f64::NAN } else { common::rosenbrock(x) };
        let run = minimize(cost).bounds(&[-1.0; 2], &[1.0; 2]).unwrap().seed(1).workers(workers);
        let run = run.method("de".parse::<dfo::AnyMethod>().unwrap());
        let report = run.max_failed(0.25).run().unwrap();
        assert_eq!(report.termination, Termination::TooManyFailed, "{report}");
        assert!(4 * report.n_failed > report.n_evaluations && report.n_evaluations >= 20, "{report}");
        assert!(report.fun.is_finite() && !report.is_success(), "{report}");
        assert!(report.message.contains("more than the allowed share of 0.25"), "{}", report.message);
    }
    let error = minimize(common::rosenbrock).start(&[1.0, 1.0]).max_failed(1.5).run().unwrap_err();
    assert!(matches!(error, dfo::Error::Option { name: "max_failed", .. }));
}
