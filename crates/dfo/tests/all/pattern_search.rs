//! Pattern search: comparison with a compass search, costs with kinks, and plans.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;
use crate::problems;

use common::{rosenbrock, timeless};
use dfo::{
    Checkpoint, Lookahead, Minimize, Outcome, PatternSearch, Query, Report, Resume, Termination, minimize,
    with_query,
};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Returns the best cost of a compass search within the budget, and the evaluations that it needs to reach a
/// cost. The search tries both directions along each axis, accepts the first better point and otherwise
/// halves the step.
fn compass(f: &dyn Fn(&[f64]) -> f64, x0: &[f64], budget: usize, goal: f64) -> (f64, Option<usize>) {
    let (mut x, mut best) = (x0.to_vec(), f(x0));
    let sizes: Vec<f64> = x0.iter().map(|x| if *x != 0.0 { x.abs() } else { 1.0 }).collect();
    let (mut count, mut step) = (1, 0.3);
    while count < budget && step > 1e-12 {
        let before = best;
        'poll: for k in 0..x.len() {
            for sign in [1.0, -1.0] {
                let here = x[k];
                x[k] += sign * step * sizes[k];
                let cost = f(&x);
                count += 1;
                if cost < best {
                    best = cost;
                    break 'poll;
                }
                x[k] = here;
                if count == budget {
                    break 'poll;
                }
            }
        }
        if best <= goal {
            return (best, Some(count));
        }
        if best >= before {
            step *= 0.5;
        }
    }
    (best, None)
}

#[test]
fn valleys_need_fewer_evaluations_than_compass_search() {
    for n in [2, 5] {
        let x0 = vec![-1.2; n];
        let ours = minimize(rosenbrock).start(&x0).method(PatternSearch::default());
        let ours = ours.target(1e-4).max_evaluations(50_000).run().unwrap();
        let (_, theirs) = compass(&rosenbrock, &x0, 50_000, 1e-4);
        println!("{n}: {} and {theirs:?}", ours.n_evaluations);
        assert!(
            ours.fun <= 1e-4 && theirs.is_none_or(|theirs| 3 * ours.n_evaluations < theirs),
            "{theirs:?} {ours}"
        );
    }
}

/// Sums of absolute residuals of the instances of Moré and Wild. Only odd instances are used, because even
/// ones were used for tuning.
#[test]
fn pattern_search_reaches_lower_cost_than_compass_search_on_kinks() {
    let (mut lower, mut total) = (0, 0);
    for instance in problems::instances().iter().filter(|i| i.number % 2 == 1) {
        let cost = |x: &[f64]| -> f64 {
            problems::residuals(instance.number, instance.m, x).iter().map(|r| r.abs()).sum()
        };
        let budget = 100 * (instance.n + 1);
        let ours = minimize(cost).start(&instance.start()).method(PatternSearch::default());
        let ours = ours.max_evaluations(budget).run().unwrap();
        let (theirs, _) = compass(&cost, &instance.start(), budget, f64::NEG_INFINITY);
        lower += usize::from(ours.fun <= theirs);
        total += 1;
    }
    println!("{lower} of {total}");
    assert!(4 * lower >= 3 * total, "{lower} of {total}");
}

#[test]
fn plans_save_rounds_without_changing_the_path() {
    let run = |plan, workers| -> Report {
        let search =
            minimize(rosenbrock).start(&[-1.2, 1.0, 0.5]).bounds(&[-2.0; 3], &[0.9, 2.0, 2.0]).unwrap();
        search.method(PatternSearch::default().batch(plan)).workers(workers).run().unwrap()
    };
    let serial = run(Lookahead::None, 1);
    assert!(serial.is_success() && serial.n_speculative == 0 && serial.batch == "serial", "{serial}");
    for (plan, workers) in [
        (Lookahead::Points(6), 1),
        (Lookahead::Workers, 4),
        (Lookahead::Workers, 16),
        (Lookahead::Measured, 3),
    ] {
        let other = run(plan, workers);
        assert_eq!((&other.x, other.fun, &other.message), (&serial.x, serial.fun, &serial.message));
        assert_eq!((other.n_evaluations, other.n_iterations), (serial.n_evaluations, serial.n_iterations));
    }
    let ahead = run(Lookahead::Points(6), 6);
    println!("{} rounds, {} serial", ahead.n_batches, serial.n_batches);
    assert!(ahead.n_speculative > 0);
}

#[test]
fn pattern_search_finds_narrow_cones_of_descent() {
    let kinks = |x: &[f64]| (x[0] - 1.0).abs() + 10.0 * (x[1] - x[0]).abs();
    for x0 in [[-1.0, 2.0], [3.0, 1.0], [-2.0, -2.0], [0.5, 7.0]] {
        let report = minimize(kinks).start(&x0).method(PatternSearch::default()).run().unwrap();
        assert!(report.is_success() && report.fun < 1e-3, "{report}");
    }
}

type Cost = Box<dyn Fn(&[f64]) -> f64 + Send + Sync>;

/// If kinks cross, the directions of descent form a cone that narrows with each parameter: along a chain of
/// equal parameters, along rotated lines, and between planes.
fn crossing_kinks(n: usize) -> [(&'static str, Cost); 3] {
    // The columns of a matrix of cosines are orthogonal.
    let turned = move |x: &[f64], k: usize| -> f64 {
        let angle = |i: usize| std::f64::consts::PI * (i as f64 + 0.5) * k as f64 / n as f64;
        x.iter().enumerate().map(|(i, x)| angle(i).cos() * (x - 0.3)).sum()
    };
    let chain =
        |x: &[f64]| (x[0] - 0.7).abs() + x.windows(2).map(|w| 10.0 * (w[1] - w[0]).abs()).sum::<f64>();
    let sum = move |x: &[f64]| (0..n).map(|k| (1 + 9 * (k % 2)) as f64 * turned(x, k).abs()).sum();
    let largest = move |x: &[f64]| (0..n).map(|k| turned(x, k).abs()).fold(0.0, f64::max);
    [("chain", Box::new(chain)), ("sum", Box::new(sum)), ("largest", Box::new(largest))]
}

#[test]
fn pattern_search_claims_success_only_at_minimum_when_kinks_cross() {
    for n in 2..=6 {
        for (name, cost) in crossing_kinks(n) {
            for x0 in [vec![1.5; n], vec![0.0; n], (0..n).map(|k| 2.0 - (k % 3) as f64).collect()] {
                let report =
                    minimize(|x: &[f64]| cost(x)).start(&x0).method(PatternSearch::default()).run().unwrap();
                assert!(report.is_success() && report.fun < 1e-3 * cost(&x0), "{name} {n} {x0:?}: {report}");
            }
        }
    }
}

/// Crossing kinks at bounds: the minimum is on some of the bounds.
#[test]
fn pattern_search_follows_kinks_that_cross_at_bounds() {
    for n in [2, 4] {
        let chain = |x: &[f64]| x[0].abs() + x.windows(2).map(|w| 10.0 * (w[1] - w[0]).abs()).sum::<f64>();
        let (mut lower, mut upper) = (vec![-5.0; n], vec![5.0; n]);
        (lower[1], upper[0]) = (1.0, 3.0);
        let run = minimize(chain).start(&vec![2.5; n]).bounds(&lower, &upper).unwrap();
        let report = run.method(PatternSearch::default()).run().unwrap();
        assert!(report.is_success() && report.fun < 1.0 + 1e-3, "{report}");
    }
}

/// A run that is aborted after `limit` evaluations.
fn set_up(limit: usize) -> Minimize<'static, PatternSearch> {
    let (_, kinks) = crossing_kinks(3).into_iter().next().unwrap();
    let calls = AtomicUsize::new(0);
    let cost = move |x: &[f64], _: &Query<'_>| match calls.fetch_add(1, Ordering::Relaxed) {
        k if k >= limit => Outcome::Abort("stopped".to_owned()),
        _ => Outcome::Value(kinks(x)),
    };
    minimize(with_query(cost)).start(&[1.5, -1.0, 0.5]).method(PatternSearch::default())
}

#[test]
fn discrete_gradients_path_is_independent_of_workers_and_interruptions() {
    let same = |a: &Report, b: &Report| {
        assert!(timeless(&a.trace) == timeless(&b.trace));
        assert_eq!((&a.x, a.fun.to_bits(), &a.message), (&b.x, b.fun.to_bits(), &b.message));
    };
    let whole = set_up(usize::MAX).run().unwrap();
    assert!(whole.is_success(), "{whole}");
    for workers in [2, 5] {
        for plan in [Lookahead::Workers, Lookahead::Points(6)] {
            let method = PatternSearch::default().batch(plan);
            let other = set_up(usize::MAX).method(method).workers(workers).run().unwrap();
            assert_eq!(
                (&other.x, other.n_evaluations, &other.message),
                (&whole.x, whole.n_evaluations, &whole.message)
            );
        }
    }
    let folder = tempfile::tempdir().unwrap();
    for limit in (1..whole.n_evaluations).step_by(whole.n_evaluations / 6) {
        let file = folder.path().join(format!("{limit}"));
        let checkpoint = || Checkpoint::new(&file).interval(Duration::ZERO);
        let stopped = set_up(limit).checkpoint(checkpoint()).run().unwrap();
        assert_eq!(stopped.termination, Termination::Aborted("stopped".to_owned()));
        same(&set_up(usize::MAX).checkpoint(checkpoint().resume(Resume::Require)).run().unwrap(), &whole);
    }
}
