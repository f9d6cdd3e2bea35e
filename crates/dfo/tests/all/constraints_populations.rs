//! Constraints in the methods with populations, Nelder-Mead, pattern search and multistart: minima with a
//! closed form, feasible points, and the contracts of every method.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::{checkpoint, common};

use checkpoint::Folder;
use common::timeless;
use dfo::{
    Answer, AnyMethod, Checkpoint, Constraints, Error, LinearConstraint, NonlinearConstraint, Outcome,
    ParameterKind, Report, Search, Termination, by_hand, constrained, minimize,
};
use std::sync::atomic::{AtomicUsize, Ordering};

const INF: f64 = f64::INFINITY;
const LINEAR: [&str; 6] = ["de", "de-classic", "cma-es", "nelder-mead", "pattern-search", "multistart"];
const NONLINEAR: [&str; 4] = ["de", "de-classic", "cma-es", "multistart"];

fn row(coefficients: &[f64], lower: f64, upper: f64) -> LinearConstraint {
    LinearConstraint { coefficients: coefficients.to_vec(), lower, upper }
}

fn method(name: &str) -> AnyMethod {
    name.parse().unwrap()
}

/// Half-planes `x + y <= 1`, `x - y <= 0.5`, and the plane `x + 2 z = 1`.
fn rows() -> Constraints {
    let linear = vec![
        row(&[1.0, 1.0, 0.0], -INF, 1.0),
        row(&[1.0, -1.0, 0.0], -INF, 0.5),
        row(&[1.0, 0.0, 2.0], 1.0, 1.0),
    ];
    Constraints { linear, ..Constraints::default() }
}

fn assert_inside(x: &[f64], constraints: &Constraints, what: &str) {
    for row in &constraints.linear {
        let value: f64 = row.coefficients.iter().zip(x).map(|(a, x)| a * x).sum();
        let terms: f64 = row.coefficients.iter().zip(x).map(|(a, x)| (a * x).abs()).sum();
        let rounding = 1e-14 * (terms + 1.0);
        assert!(row.lower - rounding <= value && value <= row.upper + rounding, "{what}: {x:?}");
    }
}

/// The nearest point to (2, 1, 0) in units that favour x. Its minimum is the corner of the half-planes.
fn corner(x: &[f64]) -> f64 {
    4.0 * (x[0] - 2.0).powi(2) + (x[1] - 1.0).powi(2) + 1e-3 * x[2] * x[2]
}

fn with_rows(name: &str, budget: usize, workers: usize) -> Report {
    let constraints = rows();
    let cost = |x: &[f64]| {
        assert_inside(x, &rows(), name);
        corner(x)
    };
    minimize(cost)
        .start(&[-0.5, 0.5, 1.0])
        .bounds(&[-3.0; 3], &[3.0; 3])
        .unwrap()
        .constraints(constraints)
        .method(method(name))
        .seed(5)
        .workers(workers)
        .max_evaluations(budget)
        .run()
        .unwrap()
}

#[test]
fn methods_reach_the_corner_of_linear_constraints() {
    for name in LINEAR {
        let report = with_rows(name, 6000, 1);
        let error = [0.75, 0.25, 0.125].iter().zip(&report.x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error < 1e-4, "{report}");
    }
    let report = with_rows("ga", 6000, 1);
    assert!((report.x[0] - 0.75).abs() < 0.02, "{report}");
}

#[test]
fn methods_slide_along_a_linear_constraint() {
    // The nearest point to (1, 2, 3, 4) in the half-space x + y + z + w <= 2: each coordinate decreases by 2.
    let constraints = Constraints { linear: vec![row(&[1.0; 4], -INF, 2.0)], ..Constraints::default() };
    for name in LINEAR {
        let cost = |x: &[f64]| {
            assert_inside(x, &constraints, name);
            x.iter().enumerate().map(|(k, x)| (x - 1.0 - k as f64).powi(2)).sum()
        };
        let report = minimize(cost)
            .start(&[0.0; 4])
            .bounds(&[-6.0; 4], &[6.0; 4])
            .unwrap()
            .constraints(constraints.clone())
            .method(method(name))
            .seed(3)
            .max_evaluations(20_000)
            .run()
            .unwrap();
        assert!(report.fun < 16.0 + 1e-3, "{report}");
        assert!(report.x.iter().enumerate().all(|(k, x)| (x + 1.0 - k as f64).abs() < 0.02), "{report}");
    }
}

/// Limits of [`values`]: outside the unit circle, and below the parabola `y = x^2 + 1/2`.
fn circle() -> Constraints {
    let limits = |lower, upper| NonlinearConstraint { lower, upper, keep_feasible: false };
    Constraints { nonlinear: vec![limits(1.0, INF), limits(-INF, 0.5)], ..Constraints::default() }
}

fn values(x: &[f64], c: &mut Vec<f64>) {
    c.extend([x[0] * x[0] + x[1] * x[1], x[1] - x[0] * x[0]]);
}

/// The nearest point to (0, 2) with `x^2 + y^2 >= 1` and `y <= x^2 + 1/2`: `y = 3/2`, `x^2 = 1`.
fn distance(x: &[f64]) -> f64 {
    x[0] * x[0] + (x[1] - 2.0).powi(2)
}

fn with_circle(name: &str, budget: usize, workers: usize) -> Report {
    minimize(constrained(distance, values, circle()))
        .start(&[-0.5, 0.2])
        .bounds(&[-3.0; 2], &[3.0; 2])
        .unwrap()
        .constraints(circle())
        .method(method(name))
        .seed(5)
        .workers(workers)
        .max_evaluations(budget)
        .run()
        .unwrap()
}

#[test]
fn methods_reach_a_minimum_on_a_nonlinear_constraint() {
    for name in NONLINEAR {
        let report = with_circle(name, 6000, 1);
        assert!((report.fun - 1.25).abs() < 2e-3 && report.constr_violation <= 1e-6, "{report}");
        assert!((report.x[0].abs() - 1.0).abs() < 0.05 && (report.x[1] - 1.5).abs() < 0.05, "{report}");
    }
    let report = with_circle("ga", 6000, 1);
    assert!(report.fun < 1.4 && report.constr_violation <= 1e-6, "{report}");
}

#[test]
fn cma_es_satisfies_an_equality() {
    // The nearest point to (2, 1) on the unit circle.
    let equality = NonlinearConstraint { lower: 1.0, upper: 1.0, keep_feasible: false };
    let constraints = Constraints { nonlinear: vec![equality], ..Constraints::default() };
    let cost = |x: &[f64]| (x[0] - 2.0).powi(2) + (x[1] - 1.0).powi(2);
    let values = |x: &[f64], c: &mut Vec<f64>| c.push(x[0] * x[0] + x[1] * x[1]);
    let report = minimize(constrained(cost, values, constraints.clone()))
        .start(&[0.0, 0.0])
        .scales(&[1.0; 2])
        .constraints(constraints)
        .method(method("cma-es"))
        .seed(1)
        .max_evaluations(4000)
        .run()
        .unwrap();
    let expected = (5f64.sqrt() - 1.0).powi(2);
    assert!((report.fun - expected).abs() < 1e-4 && report.constr_violation <= 1e-6, "{report}");
}

#[test]
fn integers_satisfy_nonlinear_constraints() {
    // The largest 5 i + 4 j with 6 i + 4 j <= 24 and i + 2 j <= 6 (integers): 20 at (4, 0); 21 is the relaxed
    // optimum.
    let limits = |upper| NonlinearConstraint { lower: -INF, upper, keep_feasible: true };
    let constraints = Constraints { nonlinear: vec![limits(24.0), limits(6.0)], ..Constraints::default() };
    for (name, kind) in [("de", ParameterKind::Integer), ("ga", ParameterKind::Categorical)] {
        let cost = |x: &[f64]| {
            assert!(6.0 * x[0] + 4.0 * x[1] <= 24.0 && x[0] + 2.0 * x[1] <= 6.0);
            -5.0 * x[0] - 4.0 * x[1]
        };
        let values = |x: &[f64], c: &mut Vec<f64>| c.extend([6.0 * x[0] + 4.0 * x[1], x[0] + 2.0 * x[1]]);
        let report = minimize(constrained(cost, values, constraints.clone()))
            .bounds(&[0.0; 2], &[10.0; 2])
            .unwrap()
            .kinds(&[kind; 2])
            .constraints(constraints.clone())
            .method(method(name))
            .seed(2)
            .max_evaluations(3000)
            .run()
            .unwrap();
        assert_eq!((report.fun, &report.x[..]), (-20.0, &[4.0, 0.0][..]), "{report}");
    }
}

#[test]
fn budgets_are_exact_and_workers_do_not_change_the_path() {
    type Run = fn(&str, usize, usize) -> Report;
    let both: [(Run, &[&str]); 2] = [(with_rows, &LINEAR), (with_circle, &NONLINEAR)];
    for (run, names) in both {
        for name in names.iter().chain(&["ga"]) {
            let serial = run(name, 237, 1);
            assert!(serial.n_evaluations <= 237, "{serial}");
            assert!(serial.n_evaluations == 237 || serial.termination != Termination::MaxEvaluations);
            for workers in [2, 8] {
                let report = run(name, 237, workers);
                assert_eq!((&report.x, report.fun.to_bits()), (&serial.x, serial.fun.to_bits()), "{name}");
                assert_eq!(timeless(&report.trace), timeless(&serial.trace), "{name} {workers}");
            }
        }
    }
}

#[test]
fn asked_points_with_told_constraint_values_follow_the_driven_path() {
    for name in NONLINEAR {
        let driven = with_circle(name, 150, 1);
        let mut run = by_hand()
            .start(&[-0.5, 0.2])
            .bounds(&[-3.0; 2], &[3.0; 2])
            .unwrap()
            .constraints(circle())
            .method(method(name))
            .seed(5)
            .max_evaluations(150)
            .optimizer()
            .unwrap();
        loop {
            let points = run.ask(4);
            if points.is_empty() {
                break;
            }
            for point in points.iter().rev() {
                let mut answer = Answer::from(Outcome::Value(distance(&point.x)));
                values(&point.x, &mut answer.constraints);
                run.tell(point.id, answer).unwrap();
            }
        }
        let report = run.report().unwrap();
        assert_eq!((&report.x, report.fun), (&driven.x, driven.fun), "{name}");
        assert_eq!(report.constr_violation, driven.constr_violation);
    }
}

#[test]
fn stopped_runs_with_constraints_continue_bit_for_bit() {
    // L-SHADE plans with the budget.
    for name in ["de-classic", "cma-es"] {
        let whole = with_circle(name, 400, 1);
        let folder = Folder::new(&format!("constraints-{name}"));
        let calls = AtomicUsize::new(0);
        let cost = |x: &[f64]| {
            calls.fetch_add(1, Ordering::Relaxed);
            distance(x)
        };
        let reports = [90, 400].map(|budget| {
            minimize(constrained(cost, values, circle()))
                .start(&[-0.5, 0.2])
                .bounds(&[-3.0; 2], &[3.0; 2])
                .unwrap()
                .constraints(circle())
                .method(method(name))
                .seed(5)
                .checkpoint(Checkpoint::new(folder.file()))
                .max_evaluations(budget)
                .run()
                .unwrap()
        });
        assert_eq!((&reports[1].x, reports[1].fun), (&whole.x, whole.fun), "{name}");
        assert_eq!(timeless(&reports[1].trace), timeless(&whole.trace), "{name}");
        assert!(calls.load(Ordering::Relaxed) <= 400, "{name}");
    }
}

#[test]
fn unsupported_constraints_are_named_with_methods_that_support_them() {
    let error = |name: &str, constraints: Constraints| {
        let run = minimize(distance).start(&[-0.5, 0.2]).bounds(&[-3.0; 2], &[3.0; 2]).unwrap();
        run.constraints(constraints).method(method(name)).run().unwrap_err()
    };
    let linear = Constraints { linear: vec![row(&[1.0, 1.0], -INF, 1.0)], ..Constraints::default() };
    assert!(matches!(error("barrier", linear), Error::NoConstraints { kind: "linear", .. }));
    for name in ["barrier", "nelder-mead", "pattern-search"] {
        let error = error(name, circle());
        assert!(matches!(error, Error::NoConstraints { kind: "nonlinear", .. }), "{error}");
        assert!(error.to_string().contains("cma-es, de"), "{error}");
    }
    let mut equality = circle();
    equality.nonlinear[0].upper = 1.0;
    for name in ["de", "de-classic", "ga"] {
        let error = error(name, equality.clone());
        assert!(matches!(error, Error::NoConstraints { kind: "nonlinear equality", .. }), "{error}");
        assert!(error.to_string().contains("quadratic-model, cma-es or multistart"), "{error}");
    }
}

/// Two equalities of which one is a circle: `x^2 + y^2 + z^2 = 1` and `x y = 0.3`.
#[test]
fn global_search_with_equalities_uses_multistart() {
    let equality = |value| NonlinearConstraint { lower: value, upper: value, keep_feasible: false };
    let constraints = Constraints { nonlinear: vec![equality(1.0), equality(0.3)], ..Constraints::default() };
    let values = |x: &[f64], c: &mut Vec<f64>| c.extend([x.iter().map(|x| x * x).sum(), x[0] * x[1]]);
    let cost = |x: &[f64]| x[0] + x[1] + 0.2 * x[2];
    let report = minimize(constrained(cost, values, constraints.clone()))
        .bounds(&[-2.0; 3], &[2.0; 3])
        .unwrap()
        .constraints(constraints)
        .search(Search::Global)
        .seed(1)
        .run()
        .unwrap();
    // With s = x + y, z^2 = 1.6 - s^2: the smallest s + z / 5 is -sqrt(1.6 * 1.04).
    let expected = -(1.6f64 * 1.04).sqrt();
    assert_eq!(report.method, "multistart", "{report}");
    assert!((report.fun - expected).abs() < 1e-5 && report.constr_violation <= 1e-6, "{report}");
}

/// A fixed parameter does not shift the kinds of the others.
#[test]
fn fixed_parameters_do_not_affect_the_choice() {
    for fixed in [ParameterKind::Integer, ParameterKind::Categorical, ParameterKind::Continuous] {
        let report = minimize(|x: &[f64]| (x[0] + x[1] - 2.6).powi(2))
            .start(&[2.0, 0.0])
            .bounds(&[2.0, 0.0], &[2.0, 1.0])
            .unwrap()
            .kinds(&[fixed, ParameterKind::Integer])
            .search(Search::Local)
            .seed(1)
            .max_evaluations(100)
            .run()
            .unwrap();
        // Differential evolution solves more of the binary problems.
        assert_eq!((&*report.method, &report.x[..]), ("de", &[2.0, 1.0][..]), "{report}");
    }
}

/// Nelder-Mead collapses along active rows, away from the minimum of a convex program, unless its simplex is
/// rebuilt there. The minimum is that of the best set of active rows.
#[test]
fn nelder_mead_does_not_stop_on_the_wrong_rows() {
    let hessian =
        [[8.1, 6.0, 0.0, 8.0], [6.0, 18.1, 3.0, -2.0], [0.0, 3.0, 21.1, -4.0], [8.0, -2.0, -4.0, 13.1]];
    let slope = [1.0, -9.0, -3.0, -9.0];
    let linear = vec![
        row(&[0.0, 0.0, 0.0, -1.0], -INF, 5.0),
        row(&[2.0, 0.0, 5.0, -5.0], -INF, 2.0),
        row(&[-1.0, 5.0, 0.0, 4.0], -INF, 3.0),
        row(&[5.0, -4.0, -1.0, -5.0], -INF, 5.0),
        row(&[-2.0, 2.0, 4.0, 1.0], -INF, 1.0),
    ];
    let cost = |x: &[f64]| {
        let bent = |row: &[f64; 4]| row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
        hessian.iter().zip(slope).zip(x).map(|((row, c), x)| x * (c + 0.5 * bent(row))).sum()
    };
    let report = minimize(cost)
        .start(&[7.0, 8.0, -8.0, -5.0])
        .constraints(Constraints { linear, ..Constraints::default() })
        .method(method("nelder-mead"))
        .run()
        .unwrap();
    assert!(report.is_success() && (report.fun + 5.046_846_036).abs() < 1e-5, "{report}");
}
