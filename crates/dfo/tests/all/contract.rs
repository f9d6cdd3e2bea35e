//! Contracts of every method.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{cutting, methods_for_costs, probe, probe_fails, quiet_panics_on_purpose, rosenbrock, timeless};
use dfo::{
    Answers, AnyMethod, Bounds, ByHand, Checkpoint, Error, Limits, Lookahead, Minimize, NelderMead, Outcome,
    Query, Report, Resume, Setup, Space, Termination, by_hand, minimize, with_query,
};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Returns every method, with additional batch plans for Nelder-Mead.
fn methods() -> Vec<AnyMethod> {
    let mut all: Vec<AnyMethod> = methods_for_costs();
    all.push(NelderMead::default().batch(Lookahead::Points(20)).into());
    all.push(NelderMead::default().batch(Lookahead::Points(4)).into());
    all
}

fn boxed<'a>(m: Minimize<'a, NelderMead>, method: &AnyMethod) -> Minimize<'a, AnyMethod> {
    m.start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap().method(method.clone()).seed(11)
}

#[test]
fn budgets_are_exact_and_best_is_returned() {
    for method in methods() {
        for budget in 1..=200 {
            let calls = AtomicUsize::new(0);
            let cost = |x: &[f64]| {
                calls.fetch_add(1, Ordering::Relaxed);
                probe(x)
            };
            let report = match boxed(minimize(cost), &method).max_evaluations(budget).run() {
                Ok(report) => report,
                // Methods that sample may find only failures at first.
                Err(Error::EndedWithoutPoint { termination: Termination::MaxEvaluations, found }) => {
                    assert!(found.trace.iter().all(|e| e.outcome.value().is_none()));
                    continue;
                }
                Err(e) => panic!("{method:?} {budget}: {e}"),
            };
            assert_eq!(calls.into_inner(), report.n_evaluations + report.n_speculative);
            assert!(report.n_evaluations <= budget, "{method:?}");
            if report.termination == Termination::MaxEvaluations {
                assert_eq!(report.n_evaluations, budget, "{method:?}");
            }
            assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)), "{method:?} {budget}");
            assert_eq!(probe(&report.x), report.fun);
            assert!(report.trace.get(0).unwrap().x != [-0.5, 1.0] || report.fun <= probe(&[-0.5, 1.0]));
        }
    }
}

#[test]
fn iterations_targets_and_observers_end_every_method() {
    for method in methods() {
        for iterations in [0, 1, 5] {
            let report = boxed(minimize(rosenbrock), &method).max_iterations(iterations).run().unwrap();
            assert_eq!((report.n_iterations, &report.termination), (iterations, &Termination::MaxIterations));
        }
        let report = boxed(minimize(rosenbrock), &method).target(0.2).max_evaluations(5000).run().unwrap();
        assert!(report.fun <= 0.2 && report.termination == Termination::Target, "{report}");
        let mut seen = Vec::new();
        let report = boxed(minimize(rosenbrock), &method)
            .observer(|p| {
                seen.push(p.n_iterations);
                assert!(p.simplex.is_some() || p.population.is_some());
                if p.n_iterations == 4 {
                    std::ops::ControlFlow::Break(())
                } else {
                    std::ops::ControlFlow::Continue(())
                }
            })
            .run()
            .unwrap();
        assert_eq!(report.termination, Termination::StoppedByObserver);
        assert_eq!(seen, [0, 1, 2, 3, 4], "{method:?}");
    }
}

#[test]
fn result_is_independent_of_workers_and_cutoffs() {
    for method in methods() {
        let one = boxed(minimize(probe), &method).max_evaluations(600).run().unwrap();
        for workers in [2, 7] {
            let pinned = match &method {
                // The automatic plan depends on the workers; a fixed plan does not.
                AnyMethod::NelderMead(m) if m.batch == Lookahead::Measured => {
                    m.clone().batch(Lookahead::None).into()
                }
                AnyMethod::Barrier(m) => m.clone().batch(Lookahead::None).into(),
                AnyMethod::PatternSearch(m) => m.clone().batch(Lookahead::None).into(),
                other => other.clone(),
            };
            let many = boxed(minimize(probe), &pinned).max_evaluations(600).workers(workers).run().unwrap();
            assert_eq!(timeless(&many.trace), timeless(&one.trace), "{method:?} {workers}");
            assert_eq!((&many.x, many.fun, &many.message), (&one.x, one.fun, &one.message));
            assert_eq!((&many.final_population, &many.schedule), (&one.final_population, &one.schedule));
        }
        let cut = boxed(minimize(cutting(probe)), &method).max_evaluations(600).run().unwrap();
        let path = |r: &Report| -> Vec<_> { r.trace.iter().map(|e| (e.x.to_vec(), e.id, e.used)).collect() };
        assert_eq!(path(&cut), path(&one), "{method:?}");
        assert_eq!(
            (&cut.x, cut.fun, &cut.tests, &cut.final_simplex),
            (&one.x, one.fun, &one.tests, &one.final_simplex)
        );
    }
}

/// Four ways to fail at the same points.
fn failing(how: usize) -> impl Fn(&[f64], &Query<'_>) -> Outcome + Sync {
    move |x, _| match (probe_fails(x), how) {
        (false, _) => Outcome::Value(rosenbrock(x)),
        (true, 0) => Outcome::Value(f64::NAN),
        (true, 1) => Outcome::Value(f64::INFINITY),
        (true, 2) => Outcome::failed("no"),
        (true, _) => panic!("on purpose"),
    }
}

#[test]
fn every_method_handles_failing_regions() {
    quiet_panics_on_purpose();
    for method in methods() {
        let mut first: Option<Report> = None;
        for how in 0..4 {
            let report =
                boxed(minimize(with_query(failing(how))), &method).max_evaluations(2000).run().unwrap();
            if how == 0 {
                println!(
                    "{}: {:.2e} in {}, {} failed",
                    report.method, report.fun, report.n_evaluations, report.n_failed
                );
            }
            let bar = match &method {
                AnyMethod::NelderMead(_) | AnyMethod::CmaEs(_) | AnyMethod::QuadraticModel(_) => 1e-6,
                AnyMethod::DifferentialEvolution(_) => 1e-3,
                _ => rosenbrock(&[-0.5, 1.0]),
            };
            assert!(report.fun < bar && report.n_failed > 0, "{method:?}: {report}");
            assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
            match &first {
                None => first = Some(report),
                Some(first) => assert_eq!((&report.x, report.n_failed), (&first.x, first.n_failed)),
            }
        }
    }
    for method in methods() {
        let hopeless = boxed(minimize(|_: &[f64]| f64::NAN), &method).max_evaluations(500).run();
        assert!(matches!(hopeless, Err(Error::AllStartsFailed(_))), "{method:?}");
    }
}

fn optimizer(method: &AnyMethod, limits: Limits) -> Minimize<'static, AnyMethod, ByHand> {
    let run = by_hand().start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap();
    run.method(method.clone()).seed(11).limits(limits)
}

#[test]
fn ask_tell_in_any_order_matches_driven_run() {
    for method in methods() {
        let driven = boxed(minimize(probe), &method).max_evaluations(333).run().unwrap();
        for (at_most, backwards) in [(1, false), (3, true), (1000, true)] {
            let limits = Limits { max_evaluations: Some(333), ..Limits::default() };
            let mut o = optimizer(&method, limits).optimizer().unwrap();
            let mut waiting = Vec::new();
            while o.termination().is_none() {
                let points = o.ask(at_most);
                waiting.extend(points.clone());
                if !points.is_empty() && waiting.len() < 5 {
                    continue;
                }
                if backwards {
                    waiting.reverse();
                }
                // Some answers come late; some points are returned and requested again.
                let keep = waiting.len() / 2;
                for point in waiting.split_off(keep) {
                    if point.id % 7 == 3 && backwards {
                        o.tell(point.id, Outcome::Skipped).unwrap();
                        // A point that the path has left is not handed out again.
                        let Some(again) = o.ask(1).pop() else { continue };
                        o.tell(again.id, Outcome::Value(probe(&again.x))).unwrap();
                        waiting.retain(|p| p.id != again.id);
                        if again.id != point.id {
                            waiting.extend(o.ask(1));
                        }
                    } else {
                        o.tell(point.id, Outcome::Value(probe(&point.x))).unwrap();
                    }
                }
            }
            let report = o.report().unwrap();
            assert_eq!(timeless(&report.trace), timeless(&driven.trace), "{method:?}");
            assert_eq!((&report.x, report.fun, &report.message), (&driven.x, driven.fun, &driven.message));
            assert_eq!(report.n_cached, driven.n_cached);
        }
    }
}

#[test]
fn ask_tell_run_resumes_from_its_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let limits = Limits { max_evaluations: Some(150), ..Limits::default() };
    for (k, method) in methods().into_iter().enumerate() {
        let whole = boxed(minimize(probe), &method).max_evaluations(150).trace_limit(100).run().unwrap();
        let path = folder.path().join(k.to_string());
        let mut reported = 0;
        // Abandoned after an increasing number of answers, in the middle of rounds. The file contains the
        // last explicit save.
        for leave in 1.. {
            let mut o = optimizer(&method, limits)
                .trace_limit(100)
                .checkpoint(Checkpoint::new(&path).interval(Duration::from_secs(3600)))
                .optimizer()
                .unwrap();
            let mut left = 3 * leave;
            'run: while o.termination().is_none() {
                for point in o.ask(4).into_iter().rev() {
                    if left == 0 {
                        break 'run;
                    }
                    o.tell(point.id, Outcome::Value(probe(&point.x))).unwrap();
                    (left, reported) = (left - 1, reported + 1);
                }
            }
            o.save().unwrap();
            if o.termination().is_some() {
                let report = o.report().unwrap();
                assert_eq!(timeless(&report.trace), timeless(&whole.trace), "{method:?}");
                assert_eq!((&report.x, report.fun, &report.message), (&whole.x, whole.fun, &whole.message));
                assert_eq!(report.trace.len(), whole.trace.len());
                assert!(report.n_speculative > 0 || report.n_evaluations == reported);
                break;
            }
        }
        // The driven run resumes from the same file and has already ended.
        let again = boxed(minimize(probe), &method).max_evaluations(150).trace_limit(100);
        let again = again.checkpoint(Checkpoint::new(&path).resume(Resume::Require)).run().unwrap();
        let n = whole.n_evaluations;
        assert_eq!((again.x, again.n_evaluations, again.message), (whole.x, n, whole.message));
    }
}

#[test]
fn ids_are_checked_and_runs_can_be_stopped() {
    let mut o = optimizer(&"de".parse().unwrap(), Limits::default()).optimizer().unwrap();
    assert_eq!(o.tell(0, Outcome::Value(1.0)), Err(Error::UnknownPoint { id: 0 }));
    let points = o.ask(10);
    assert_eq!((points.len(), o.n_pending()), (10, 10));
    o.tell(points[4].id, Outcome::Value(1.0)).unwrap();
    assert_eq!(o.tell(points[4].id, Outcome::Value(1.0)), Err(Error::UnknownPoint { id: points[4].id }));
    assert!(o.best().is_none() && matches!(o.report(), Err(Error::EndedWithoutPoint { .. })));
    o.stop().unwrap();
    assert_eq!(o.termination(), Some(Termination::Interrupted));
    assert_eq!((o.report().unwrap().fun, o.report().unwrap().n_evaluations), (1.0, 1));
    assert!(o.ask(1).is_empty());
    let mut o = optimizer(&"nelder-mead".parse().unwrap(), Limits::default()).optimizer().unwrap();
    let id = o.ask(1)[0].id;
    o.tell(id, Outcome::Abort("enough".to_owned())).unwrap();
    assert_eq!(o.termination(), Some(Termination::Aborted("enough".to_owned())));
    for bad in ["simplex", "", "5"] {
        assert!(matches!(bad.parse::<AnyMethod>(), Err(Error::UnknownMethod { .. })));
    }
    assert!(AnyMethod::by_number(0).is_err() && AnyMethod::by_number(3).is_ok());
}

#[test]
fn exact_repeats_cost_nothing() {
    for method in methods() {
        let calls = AtomicUsize::new(0);
        let cost = |x: &[f64]| {
            calls.fetch_add(1, Ordering::Relaxed);
            (4.0 * x[0]).floor().powi(2) + (4.0 * x[1]).floor().powi(2)
        };
        let plain = boxed(minimize(cost), &method).cache(0).max_iterations(30).run().unwrap();
        let before = calls.swap(0, Ordering::Relaxed);
        let cached = boxed(minimize(cost), &method).cache(100_000).max_iterations(30).run().unwrap();
        assert_eq!((&plain.x, plain.fun, plain.n_iterations), (&cached.x, cached.fun, cached.n_iterations));
        assert_eq!(cached.n_evaluations + cached.n_cached, plain.n_evaluations, "{method:?}");
        let called = |r: &Report| r.n_evaluations + r.n_speculative;
        assert_eq!((before, calls.into_inner()), (called(&plain), called(&cached)));
        let mut points: Vec<_> =
            cached.trace.iter().map(|e| e.x.iter().map(|v| v.to_bits()).collect::<Vec<_>>()).collect();
        points.sort();
        points.dedup();
        // A point may be requested again with a larger cutoff only if it was abandoned, which this cost never
        // does.
        assert_eq!(points.len(), cached.n_evaluations);
    }
}

#[test]
fn trace_length_can_be_limited() {
    for method in methods() {
        let whole = boxed(minimize(probe), &method).max_evaluations(400).run().unwrap();
        for limit in [0, 1, 50] {
            let part = boxed(minimize(probe), &method).max_evaluations(400).trace_limit(limit).run().unwrap();
            assert_eq!((&part.x, part.fun, &part.message), (&whole.x, whole.fun, &whole.message));
            assert_eq!((part.n_speculative, part.n_evaluations), (whole.n_speculative, whole.n_evaluations));
            assert_eq!((part.trace.len(), part.trace.n_dropped()), (limit, whole.trace.len() - limit));
            let all = timeless(&whole.trace);
            assert_eq!(timeless(&part.trace), all[all.len() - limit..]);
        }
    }
}

#[test]
fn warm_start_begins_with_evaluated_points() {
    let first = boxed(minimize(probe), &"de".parse().unwrap());
    let first = first.problem("probe").max_evaluations(200).run().unwrap();
    assert_eq!(first.trace.problem(), Some("probe"));
    for method in methods() {
        let requested = std::sync::Mutex::new(Vec::new());
        let cost = |x: &[f64]| {
            requested.lock().unwrap().push(x.to_vec());
            probe(x)
        };
        let warm = boxed(minimize(cost), &method)
            .problem("probe")
            .warm_start(&first.trace)
            .max_evaluations(100)
            .run();
        let warm = warm.unwrap();
        assert!(warm.fun <= first.fun && warm.n_cached > 0, "{method:?}");
        let requested = requested.into_inner().unwrap();
        assert!(
            first
                .trace
                .iter()
                .filter(|e| e.outcome.value().is_some())
                .all(|e| !requested.iter().any(|x| x == e.x))
        );
        // Even if no better point can be evaluated, the best point of the earlier run is the result.
        let flat = boxed(minimize(|_: &[f64]| 1e9), &method)
            .problem("probe")
            .warm_start(&first.trace)
            .max_evaluations(60)
            .run()
            .unwrap();
        assert_eq!((&flat.x, flat.fun), (&first.x, first.fun), "{method:?}");
    }
    // Points outside the box of the new run are not used.
    let elsewhere = minimize(rosenbrock).start(&[5.0, 5.0]).bounds(&[4.0; 2], &[6.0; 2]).unwrap();
    let cold = elsewhere.warm_start(&first.trace).max_evaluations(50).run().unwrap();
    assert_eq!((cold.trace.get(0).unwrap().x, cold.n_cached), (&[5.0, 5.0][..], 0));
}

#[test]
fn costs_of_another_problem_are_never_reused() {
    let first = |problem: Option<&str>| {
        let run = boxed(minimize(probe), &"de".parse().unwrap()).max_evaluations(200);
        match problem {
            Some(problem) => run.problem(problem).run().unwrap(),
            None => run.run().unwrap(),
        }
    };
    // The other problem has higher costs everywhere: costs below 1000 belong to the first problem.
    let dearer = |x: &[f64]| 1000.0 + rosenbrock(x);
    for method in methods() {
        for (then, now) in
            [(Some("first"), Some("second")), (None, Some("second")), (Some("first"), None), (None, None)]
        {
            let earlier = first(then);
            let run =
                boxed(minimize(dearer), &method).warm_start(&earlier.trace).cache(0).max_evaluations(100);
            let run = match now {
                Some(problem) => run.problem(problem),
                None => run,
            };
            let report = run.run().unwrap();
            assert_eq!(report.fun, dearer(&report.x), "{method:?}");
            // The search starts from the points of the earlier run.
            assert!(report.n_cached == 0 && report.trace.iter().take(40).any(|e| e.x == earlier.x));
        }
    }
}

#[test]
fn generations_allocate_nothing_after_first_rounds() {
    use dfo::{Batch, DifferentialEvolution, Genetic, Method, MethodOptions};
    fn measure<M: MethodOptions>(options: &M) -> u64 {
        let n = 6;
        let bounds = Bounds::new(&vec![-2.0; n], &vec![2.0; n]).unwrap();
        let setup = Setup::new(Space::new(&vec![-1.2; n], bounds, &[], &[]).unwrap());
        let setup = Setup { seed: Some(3), max_evaluations: Some(6000), ..setup };
        let mut method = options.begin(&setup).unwrap();
        let (mut batch, mut answers) = (Batch::new(), Answers::default());
        let mut round = || {
            method.ask(&mut batch);
            answers.clear();
            answers.extend(batch.points().map(|x| Outcome::Value(rosenbrock(x))));
            method.tell(&answers).unwrap();
        };
        (0..4).for_each(|_| round());
        allocation_counter::measure(|| (0..30).for_each(|_| round())).count_total
    }
    assert_eq!(measure(&DifferentialEvolution::default()), 0);
    assert_eq!(measure(&DifferentialEvolution::classic()), 0);
    assert_eq!(measure(&Genetic::default()), 0);
}

/// A run that its budget has ended does not continue, whatever its plan. When resumed, it evaluates nothing
/// and returns the same result.
#[test]
fn run_ended_by_budget_stays_over() {
    let folder = tempfile::tempdir().unwrap();
    for (k, method) in methods().into_iter().enumerate() {
        for budget in (30..200).step_by(3) {
            let path = folder.path().join(format!("{k}-{budget}"));
            let run = |cost: &(dyn Fn(&[f64]) -> f64 + Sync)| {
                let run = boxed(minimize(|x: &[f64]| cost(x)), &method).max_evaluations(budget).workers(3);
                run.checkpoint(Checkpoint::new(&path).interval(Duration::ZERO)).run().unwrap()
            };
            let first = run(&rosenbrock);
            let again = run(&|_| panic!("on purpose: nothing is left to evaluate"));
            assert_eq!(
                (&again.x, again.fun, &again.message),
                (&first.x, first.fun, &first.message),
                "{method:?}"
            );
            let counts = |r: &Report| (r.n_evaluations, r.n_iterations, r.n_failed, r.termination.clone());
            assert_eq!(counts(&again), counts(&first), "{method:?} {budget}");
        }
    }
}
