//! The Adams formulae: order, restart, repetition, and points that cannot be evaluated.

#![allow(clippy::unwrap_used, clippy::panic)]

use ode::*;

fn decay(method: Method, rtol: f64, rate: f64, end: f64) -> Solution {
    let f = move |t: f64, x: &[f64], dx: &mut [f64]| {
        (dx[0], dx[1]) = (x[1] - rate * (x[0] - t.sin()), -x[0]);
    };
    let run = ode::solve(f, 0.0..end, &[1.0, 0.0]).method(method).relative_tolerance(rtol);
    run.absolute_tolerance(rtol).run().unwrap()
}

/// For a smooth solution, the number of right-hand sides grows with the tolerance as for a method of order 7 or
/// more. BDF has order 5 at most.
#[test]
fn adams_reaches_a_high_order_for_smooth_solutions() {
    let work = |method, rtol| decay(method, rtol, 0.0, 100.0).report.stats.right_hand_sides as f64;
    let order = |method| 3.0 / (work(method, 1e-11) / work(method, 1e-8)).log10();
    assert!(order(Method::Adams) > 7.0 && order(Method::Bdf) < 6.0, "{}", order(Method::Adams));
    assert!(work(Method::Adams, 1e-9) < 0.5 * work(Method::Tsit5, 1e-9));
    for rtol in [1e-5, 1e-7, 1e-9, 1e-11] {
        let x = decay(Method::Adams, rtol, 0.0, 100.0).last()[0];
        assert!((x - 100f64.cos()).abs() < 2000.0 * rtol, "{rtol:e}: {:e}", x - 100f64.cos());
    }
}

/// Iterations without a matrix converge only for steps of less than two time constants. With a matrix, only
/// stability limits the steps.
#[test]
fn adams_exceeds_the_steps_of_explicit_methods_for_fast_components() {
    let stats = decay(Method::Adams, 1e-6, 100.0, 20.0).report.stats;
    let explicit = decay(Method::Tsit5, 1e-6, 100.0, 20.0).report.stats;
    assert!(stats.jacobians > 0 && 2 * stats.right_hand_sides < explicit.right_hand_sides, "{stats:?}");
}

#[test]
fn adams_repeats_the_same_bits() {
    let run = || decay(Method::Adams, 1e-7, 3.0, 30.0);
    let (a, b) = (run(), run());
    assert_eq!(a.last(), b.last());
    assert_eq!(a.report.stats.right_hand_sides, b.report.stats.right_hand_sides);
}

/// `x' = sqrt(x)` cannot be evaluated below zero; near it, steps are repeated with a smaller size.
#[test]
fn adams_treats_nan_as_a_failed_step() {
    let f = |_: f64, x: &[f64], dx: &mut [f64]| dx[0] = -x[0].sqrt();
    let run = ode::solve(f, 0.0..1.9, &[1.0]).method(Method::Adams).relative_tolerance(1e-8).run().unwrap();
    assert!((run.last()[0] - 0.05f64.powi(2)).abs() < 1e-7, "{:?}", run.last());
}
