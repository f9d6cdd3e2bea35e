//! Success is claimed only at minima: for starts close to zero, next to failing points, far away, and at a
//! limit.
#![allow(clippy::unwrap_used)]

use dfo::{
    AnyMethod, LeastSquares, Minimize, Multistart, NelderMead, PatternSearch, QuadraticModel, Report, Search,
    Termination, least_squares, minimize,
};

/// Methods that search from a point.
fn local_methods() -> [AnyMethod; 4] {
    [
        AnyMethod::auto(Search::Local),
        NelderMead::default().into(),
        QuadraticModel::default().into(),
        PatternSearch::default().into(),
    ]
}

fn run(cost: impl Fn(&[f64]) -> f64 + Sync, start: &[f64], method: AnyMethod) -> Report {
    minimize(cost).start(start).method(method).seed(1).run().unwrap()
}

#[test]
fn every_method_finds_the_minimum_when_the_start_is_next_to_zero() {
    for start in [1e-15, 1e-12, -1e-10, 1e-8] {
        for method in local_methods() {
            let report = run(|x| (x[0] - 3.0).powi(2), &[start], method);
            assert!(report.is_success() && report.fun < 1e-8, "{start:e}: {report}");
        }
        let report =
            least_squares(|x: &[f64], r: &mut Vec<f64>| r.push(x[0] - 3.0)).start(&[start]).run().unwrap();
        assert!(report.is_success() && report.fun < 1e-12, "{start:e}: {report}");
    }
}

/// `a exp(-t/2) + b t`: the minimum is zero at (2, 0.3).
#[test]
fn every_method_finds_the_minimum_when_one_of_two_parameters_starts_next_to_zero() {
    let cost = |x: &[f64]| {
        let at = |t: f64| (x[0] - 2.0) * (-0.5 * t).exp() + (x[1] - 0.3) * t;
        (0..30).map(|k| at(5.0 * f64::from(k) / 29.0).powi(2)).sum::<f64>()
    };
    for start in [1e-15, 1e-8] {
        for method in local_methods() {
            let report = run(cost, &[1.0, start], method);
            assert!(report.is_success() && report.fun < 1e-6, "{start:e}: {report}");
        }
    }
}

/// A parameter as small as its start is also found.
#[test]
fn every_method_finds_small_parameters_from_starts_of_their_size() {
    for size in [1e-12, 1e-9, 1e-6] {
        let cost = |x: &[f64]| (x[0] / size - 3.0).powi(2) + 2.0 * (x[1] - x[0] / size).powi(2);
        for method in local_methods() {
            let report = run(cost, &[size, 1.0], method);
            assert!(report.is_success() && report.fun < 1e-8, "{size:e}: {report}");
        }
    }
}

/// Returns numbers from 0 to 1.
fn dice(k: u64) -> f64 {
    let z = k.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    ((z ^ (z >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40) as f64 / 16_777_216.0
}

/// `|x|^2` if `x0 > x1` and all parameters are above 0.1; otherwise it fails. The infimum is 0.03, in a
/// corner.
#[test]
fn nelder_mead_claims_success_only_near_minimum_when_neighbours_fail() {
    let cost = |x: &[f64]| {
        let is_good = x[0] > x[1] && x.iter().all(|x| *x > 0.1);
        if is_good { x.iter().map(|x| x * x).sum::<f64>() } else { f64::NAN }
    };
    let (mut n_found, mut wrong) = (0, Vec::new());
    for k in 0..40 {
        let mut start: Vec<f64> = (0..3).map(|i| 0.1 + 0.9 * dice(3 * k + i + 1)).collect();
        start.sort_by(|a, b| b.total_cmp(a));
        let problem = minimize(cost).start(&start).bounds(&[0.0; 3], &[1.0; 3]).unwrap();
        let report = problem.method(NelderMead::default()).run().unwrap();
        n_found += usize::from(report.is_success() && report.fun < 0.03 * 1.001);
        if report.is_success() && report.fun > 0.03 * 1.001 {
            wrong.push(report.fun);
        }
    }
    assert!(wrong.is_empty() && n_found >= 30, "{n_found} found, {wrong:?}");
}

/// Squared distance from a point at which the cost fails, beyond a slanted plane or outside a ball. The
/// infimum is the squared distance of that point from the border.
#[test]
fn local_methods_claim_success_only_at_minimum_when_it_is_on_failure_border() {
    let (mut n_found, mut n_success) = ([0; 4], 0);
    for k in 0..30u64 {
        let n = 2 + (k % 4) as usize;
        let numbers = |from: u64| -> Vec<f64> {
            (0..n as u64).map(|i| 2.0 * dice(1000 * k + 20 * from + i + 1) - 1.0).collect()
        };
        let normal = numbers(0);
        let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
        let is_ball = k % 3 == 0;
        let least = (0.2 + dice(k + 77)).powi(2);
        // From the centre of the ball of radius 1, or from a point on the plane.
        let beyond = least.sqrt() + if is_ball { 1.0 } else { 0.0 };
        let cost = |x: &[f64]| {
            let along = x.iter().zip(&normal).map(|(x, v)| x * v / length).sum::<f64>();
            let square = x.iter().map(|x| x * x).sum::<f64>();
            let is_good = if is_ball { square < 1.0 } else { along < 0.0 };
            let apart = x.iter().zip(&normal).map(|(x, v)| (x - beyond * v / length).powi(2));
            if is_good { apart.sum::<f64>() } else { f64::NAN }
        };
        let mut start: Vec<f64> = numbers(1).iter().map(|v| 0.4 * v).collect();
        if cost(&start).is_nan() {
            start.iter_mut().for_each(|x| *x = -*x);
        }
        for (method, n_found) in local_methods().into_iter().zip(&mut n_found) {
            let report = run(cost, &start, method);
            let is_minimum = report.fun < least * 1.001;
            assert!(is_minimum || !report.is_success(), "{k}: {least} {report}");
            *n_found += usize::from(is_minimum);
            n_success += usize::from(report.is_success());
        }
    }
    assert!(n_found.iter().all(|n| *n >= 28) && n_success >= 110, "{n_found:?} {n_success}");
}

/// Two dipoles: from this start, the parameters diverge to 1e16, where rounding resembles noise.
#[test]
fn least_squares_claims_no_success_when_parameters_diverge() {
    let moments = |x: &[f64], out: &mut Vec<f64>| {
        let [a, c, t, u, v, w] = [0, 1, 2, 3, 4, 5].map(|k| x[k]);
        let (b, d) = (-0.816 - a, -0.017 - c);
        let r = [
            t * a + u * b - v * c - w * d,
            v * a + w * b + t * c + u * d,
            a * (t * t - v * v) - 2.0 * c * t * v + b * (u * u - w * w) - 2.0 * d * u * w,
            c * (t * t - v * v) + 2.0 * a * t * v + d * (u * u - w * w) + 2.0 * b * u * w,
            a * t * (t * t - 3.0 * v * v)
                + c * v * (v * v - 3.0 * t * t)
                + b * u * (u * u - 3.0 * w * w)
                + d * w * (w * w - 3.0 * u * u),
            c * t * (t * t - 3.0 * v * v) - a * v * (v * v - 3.0 * t * t) + d * u * (u * u - 3.0 * w * w)
                - b * w * (w * w - 3.0 * u * u),
        ];
        let sums = [-1.826, -0.754, -4.839, -3.259, -14.023, 15.467];
        out.extend(r.iter().zip(sums).map(|(r, s)| r - s));
    };
    let report = least_squares(moments).start(&[0.0, 0.0, 1.0, 1.0, 1.0, 1.0]).run().unwrap();
    assert!(!report.is_success() || report.fun < 1e-6, "{report}");
}

/// Only the method's own end means that no better minimum is expected.
#[test]
fn global_search_claims_no_success_when_limit_ends_it() {
    let rastrigin =
        |x: &[f64]| x.iter().map(|x| x * x - 10.0 * (std::f64::consts::TAU * x).cos() + 10.0).sum::<f64>();
    for budget in [600, 1000, 1500, 2500] {
        for method in [AnyMethod::auto(Search::Global), Multistart::default().into()] {
            let problem: Minimize<'_, _> = minimize(rastrigin).bounds(&[-4.0; 5], &[5.0; 5]).unwrap();
            let report = problem.method(method).seed(0).max_evaluations(budget).run().unwrap();
            assert_eq!(
                (report.termination.clone(), report.is_success()),
                (Termination::MaxEvaluations, false),
                "{report}"
            );
        }
    }
}

/// Overflow of the exponential ends the simplex search on a steep slope next to the overflow.
#[test]
fn least_squares_claims_success_only_at_minimum_when_residuals_overflow() {
    let decay = |x: &[f64], out: &mut Vec<f64>| {
        out.extend((0..50).map(|k| {
            let t = 4.0 * f64::from(k) / 49.0;
            x[0] * (-x[1] * t).exp() - 1000.0 * (-0.5 * t).exp() - 0.1 * (37.0 * t).sin()
        }));
    };
    for start in [[1.0, 0.0], [1.0, 1.0], [10.0, 0.1], [2.0, -0.5]] {
        let report = least_squares(decay).start(&start).method(LeastSquares::default()).run().unwrap();
        assert!(!report.is_success() || report.fun < 1.0, "{start:?}: {report}");
    }
}
