//! Boxes from moderately to extremely wide. Boxes that do not determine the size of a parameter do not change
//! the result.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use dfo::{
    AnyMethod, CmaEs, DifferentialEvolution, LeastSquares, NelderMead, PatternSearch, QuadraticModel, Report,
    StopRule, ToleranceMeasure, Tolerances, Transform, minimize, residuals, typical_size,
};

const UPPER: [f64; 11] = [2.002, 2.1, 3.0, 10.0, 99.0, 101.0, 1e3, 1e5, 1e7, 1e9, 1e12];

/// Residuals of a decay `exp(-k t)` with an optional offset. The measurements use k = 2 and a deviation that no k
/// explains. The offset is in units of 1e-6.
fn decay(x: &[f64], out: &mut Vec<f64>) {
    out.extend((0..51).map(|i| {
        let t = 0.1 * f64::from(i);
        let deviation = 1e-3 * (7.0 * t).sin();
        (-x[0] * t).exp() - (-2.0 * t).exp() - deviation + x.get(1).map_or(0.0, |b| 1e-6 * (b - 3e5))
    }));
}

fn local() -> Vec<AnyMethod> {
    vec![
        NelderMead::default().into(),
        LeastSquares::default().into(),
        QuadraticModel::default().into(),
        PatternSearch::default().into(),
        CmaEs::default().into(),
    ]
}

fn run(method: AnyMethod, x0: &[f64], bounds: (&[f64], &[f64]), transforms: &[Transform]) -> Report {
    let tolerances =
        Tolerances { x_tol: 1e-4, f_tol: 1e-4, measure: ToleranceMeasure::Relative, stop: StopRule::All };
    minimize(residuals(decay))
        .start(x0)
        .bounds(bounds.0, bounds.1)
        .unwrap()
        .transforms(transforms)
        .method(method)
        .seed(1)
        .x_tol(tolerances.x_tol)
        .f_tol(tolerances.f_tol)
        .run()
        .unwrap()
}

#[test]
fn local_methods_find_same_answer_for_any_box_width() {
    for method in local() {
        let name = format!("{method:?}");
        for (x0, lower, upper, transform) in UPPER
            .iter()
            .flat_map(|&u| {
                [
                    (1.0, 0.0, u, Transform::Linear),
                    (1.0, -u, u, Transform::Linear),
                    (1.0, 1.0 / u, u, Transform::Log),
                ]
            })
            .chain(UPPER.map(|u| (0.0, 0.0, u, Transform::Linear)))
        {
            let report = run(method.clone(), &[x0], (&[lower], &[upper]), &[transform]);
            let is_right = (report.x[0] - 2.0).abs() < 2e-3;
            assert!(
                is_right && report.is_success(),
                "{name} from {x0} in [{lower}, {upper}] {transform:?}: {report}"
            );
        }
    }
}

#[test]
fn parameters_with_different_bounds_do_not_affect_each_other() {
    for method in local() {
        for (k, b) in [(10.0, 1e6), (1e9, 1e6), (10.0, 1e12), (1e9, 1e12), (2.5, 1e300)] {
            let report = run(method.clone(), &[1.0, 1e5], (&[0.0, 0.0], &[k, b]), &[]);
            let is_right = (report.x[0] - 2.0).abs() < 5e-3 && (report.x[1] / 3e5 - 1.0).abs() < 5e-3;
            assert!(is_right && report.is_success(), "{method:?} {k:e} {b:e}: {report}");
        }
    }
}

/// The best value may also be at a bound more than 100 times as far away as the start.
#[test]
fn local_methods_reach_and_respect_far_bound() {
    for method in local() {
        for upper in [0.5, 1.5] {
            let report = run(method.clone(), &[1e-3], (&[0.0], &[upper]), &[]);
            let is_at_bound = (report.x[0] / upper - 1.0).abs() < 1e-3;
            assert!(is_at_bound && report.is_success(), "{method:?} {upper}: {report}");
            assert!(report.trace.iter().all(|e| (0.0..=upper).contains(&e.x[0])));
        }
    }
}

/// A method that samples its box searches all of it and ends with the x test in units of the parameter.
#[test]
fn differential_evolution_resolves_parameter_in_wide_box() {
    for upper in [10.0, 1e3, 1e5] {
        let report = run(DifferentialEvolution::default().into(), &[1.0], (&[0.0], &[upper]), &[]);
        assert!((report.x[0] - 2.0).abs() < 2e-3 && report.is_success(), "{upper:e}: {report}");
    }
}

#[test]
fn typical_size_comes_from_box_or_start() {
    use Transform::{Linear, Log};
    let size = |transform, start, bounds, given| typical_size(transform, start, bounds, given);
    for (transform, start, bounds, given, expected) in [
        (Linear, 1.0, (0.0, 100.0), None, Some(100.0)),
        (Linear, 1.0, (0.0, 100.1), None, Some(1.0)),
        (Linear, -3.0, (-1e9, 1e9), None, Some(3.0)),
        (Linear, 1.0, (0.0, 4.0), Some(0.1), Some(0.1)),
        (Linear, 0.0, (-1.0, 1.0), None, Some(2.0)),
        (Linear, 0.0, (0.0, 1e6), None, None),
        (Linear, 0.0, (f64::NEG_INFINITY, f64::INFINITY), None, None),
        (Log, 1.0, (1e-12, 1e12), None, Some(1.0)),
        (Log, 1.0, (0.0, f64::INFINITY), None, Some(1.0)),
    ] {
        assert_eq!(size(transform, start, bounds, given), expected, "{start} {bounds:?}");
    }
    let log = size(Log, 0.3, (0.1, 10.0), None).unwrap();
    assert!((log - 100.0f64.ln()).abs() < 1e-14);
}
