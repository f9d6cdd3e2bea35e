//! Quadratic models with constraints: problems of Hock and Schittkowski, and the guarantee that every requested
//! point satisfies the linear constraints.

use crate::checkpoint::{Folder, same};
use crate::problems::hock_schittkowski::{Problem, linear, nonlinear};
use dfo::{
    Answer, AnyMethod, Checkpoint, Constraints, EvaluatedPoint, LinearConstraint, NonlinearConstraint,
    Outcome, QuadraticModel, Query, Report, Resume, Search, by_hand, constrained, fallible, minimize,
    with_query,
};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

type Cost = fn(&[f64]) -> f64;
type Values = fn(&[f64], &mut Vec<f64>);

const INF: f64 = f64::INFINITY;

/// Maximum number of evaluations, in units of n + 1.
const MOST: usize = 500;

/// Number of problems with nonlinear constraints that must be solved; 54 were when the test was written.
const SOLVED: usize = 50;

/// Problems with another local minimum, at which other methods from the same start end, too.
const LOCAL: [usize; 3] = [16, 20, 59];

fn run(p: &Problem) -> Report {
    minimize(constrained(p.cost, p.values, p.constraints.clone()))
        .start(&p.start)
        .bounds(&p.lower, &p.upper)
        .unwrap()
        .constraints(p.constraints.clone())
        .method(QuadraticModel::default())
        .max_evaluations(MOST * (p.start.len() + 1))
        .run()
        .unwrap()
}

/// Rows hold up to the rounding error of their terms.
fn is_kept(row: &LinearConstraint, x: &[f64]) -> bool {
    let value: f64 = row.coefficients.iter().zip(x).map(|(a, x)| a * x).sum();
    let terms: f64 = row.coefficients.iter().zip(x).map(|(a, x)| (a * x).abs()).sum();
    let error = 1e-12 * (terms + 1.0);
    row.lower - error <= value && value <= row.upper + error
}

#[test]
fn linear_problems_end_at_the_minimum_of_the_book() {
    for p in linear() {
        let report = run(&p);
        assert!(report.is_success(), "{}: {report}", p.number);
        // Problem 55 also has a local minimum of 20/3 at x0 = 1.
        let best = if p.number == 55 { 20.0 / 3.0 } else { p.best };
        let error = report.fun - best;
        assert!(error <= 1e-5 * (p.best.abs() + 1.0), "{}: {report}", p.number);
        assert!(p.violation(&report.x) <= 1e-6, "{}: {report}", p.number);
        for entry in report.trace.iter() {
            let inside = (0..p.start.len()).all(|k| p.lower[k] <= entry.x[k] && entry.x[k] <= p.upper[k]);
            assert!(inside, "{}: {:?}", p.number, entry.x);
            assert!(p.constraints.linear.iter().all(|row| is_kept(row, entry.x)), "{}", p.number);
        }
    }
}

/// The minimum of `|x - a|^2` with `x0 + x1 + ... <= 1` is the projection of `a`.
#[test]
fn minimum_on_a_plane_is_accurate() {
    for n in [2, 5, 12, 25] {
        let a: Vec<f64> = (0..n).map(|k| 1.0 + k as f64 / n as f64).collect();
        let excess = (a.iter().sum::<f64>() - 1.0) / n as f64;
        let row = LinearConstraint { coefficients: vec![1.0; n], lower: -INF, upper: 1.0 };
        let cost = |x: &[f64]| x.iter().zip(&a).map(|(x, a)| (x - a).powi(2)).sum::<f64>();
        let report = minimize(cost)
            .start(&vec![0.01; n])
            .constraints(Constraints { linear: vec![row], ..Constraints::default() })
            .method(QuadraticModel::default())
            .x_tol(if n > 20 { 1e-6 } else { 1e-9 })
            .f_tol(if n > 20 { 1e-6 } else { 1e-14 })
            .run()
            .unwrap();
        let error = report.x.iter().zip(&a).map(|(x, a)| (x - (a - excess)).abs()).fold(0.0, f64::max);
        assert!(report.is_success() && error < if n > 20 { 1e-3 } else { 1e-8 }, "{n}: {error} {report}");
        // Without a tolerance: every sum is at most 1.
        assert!(report.trace.iter().all(|entry| entry.x.iter().sum::<f64>() <= 1.0), "{n}");
    }
}

#[test]
fn points_satisfy_rows_exactly_with_failures_and_noise() {
    // Half of the region beyond the diagonal fails, and the cost has steps.
    let row = |a: &[f64], upper: f64| LinearConstraint { coefficients: a.to_vec(), lower: -INF, upper };
    let linear = vec![row(&[1.0, 1.0, 1.0], 2.0), row(&[1.0, -2.0, 0.5], 0.25), row(&[-1.0, -1.0, 3.0], 1.0)];
    for hand_over in [false, true] {
        let outside = Mutex::new(0);
        let cost = |x: &[f64]| {
            let inside = |row: &LinearConstraint| {
                row.coefficients.iter().zip(x).map(|(a, x)| a * x).sum::<f64>() <= row.upper
            };
            if !linear.iter().all(inside) || x.iter().any(|x| !(0.0..=3.0).contains(x)) {
                *outside.lock().unwrap() += 1;
            }
            if x[0] > 0.9 + 0.2 * x[1] {
                return Err("failed");
            }
            let f: f64 = x.iter().map(|x| (x - 2.0).powi(2)).sum();
            Ok((f * 1e3).round() / 1e3)
        };
        let report = minimize(fallible(cost))
            .start(&[0.1, 0.5, 0.1])
            .bounds(&[0.0; 3], &[3.0; 3])
            .unwrap()
            .constraints(Constraints { linear: linear.clone(), ..Constraints::default() })
            .method(QuadraticModel::default().hand_over(hand_over))
            .max_evaluations(400)
            .run()
            .unwrap();
        assert_eq!(*outside.lock().unwrap(), 0, "{report}");
        assert!(report.n_evaluations <= 400 && report.fun < 6.0, "{report}");
    }
}

#[test]
fn start_outside_the_rows_is_moved_inside() {
    let order = LinearConstraint { coefficients: vec![1.0, -1.0], lower: -INF, upper: 0.0 };
    let report = minimize(|x: &[f64]| (x[0] - 3.0).powi(2) + (x[1] - 1.0).powi(2))
        .start(&[5.0, 1.0])
        .constraints(Constraints { linear: vec![order], ..Constraints::default() })
        .method(QuadraticModel::default())
        .run()
        .unwrap();
    assert!(report.is_success() && (report.fun - 2.0).abs() < 1e-9, "{report}");
    assert!(report.trace.iter().all(|entry| entry.x[0] <= entry.x[1]));
}

/// The minimum of problem 12 is -30 at (2, 3), where `25 - 4 x0^2 - x1^2 >= 0` is active.
fn ellipse(keep_feasible: bool) -> (Constraints, Cost, Values) {
    let limits = NonlinearConstraint { lower: 0.0, upper: INF, keep_feasible };
    let constraints = Constraints { nonlinear: vec![limits], ..Constraints::default() };
    let cost = |x: &[f64]| 0.5 * x[0] * x[0] + x[1] * x[1] - x[0] * x[1] - 7.0 * x[0] - 7.0 * x[1];
    (constraints, cost, |x: &[f64], c: &mut Vec<f64>| c.push(25.0 - 4.0 * x[0] * x[0] - x[1] * x[1]))
}

#[test]
fn nonlinear_problems_are_solved_without_wrong_success() {
    let (mut solved, mut count) = (0, 0);
    for p in nonlinear() {
        let report = run(&p);
        count += 1;
        let is_feasible = p.violation(&report.x) <= 1e-6;
        solved += usize::from(is_feasible && report.fun - p.best <= 1e-5 * (p.best.abs() + 1.0));
        assert!(!report.is_success() || is_feasible, "{}: {report}", p.number);
        let is_best = report.fun - p.best <= 1e-3 * (p.best.abs() + 1.0);
        let is_right = is_best || LOCAL.contains(&p.number);
        assert!(!report.is_success() || is_right, "{}: {report}", p.number);
        assert!((report.constr_violation <= 1e-6) == is_feasible, "{}: {report}", p.number);
        // Linear constraints of these problems hold at every point, too.
        for entry in report.trace.iter() {
            assert!(p.constraints.linear.iter().all(|row| is_kept(row, entry.x)), "{}", p.number);
        }
    }
    assert!(solved >= SOLVED, "{solved} of {count}");
}

#[test]
fn multipliers_are_the_sensitivities_of_the_minimum() {
    let (constraints, cost, values) = ellipse(false);
    let at = |limit: f64| {
        let mut constraints = constraints.clone();
        constraints.nonlinear[0].lower = limit;
        minimize(constrained(cost, values, constraints.clone()))
            .start(&[0.5, 0.5])
            .constraints(constraints)
            .method(QuadraticModel::default())
            .x_tol(1e-8)
            .run()
            .unwrap()
    };
    let report = at(0.0);
    assert!(report.is_success() && (report.fun + 30.0).abs() < 1e-5, "{report}");
    // grad f = (-8, -3) and grad c = (-16, -6): the multiplier is 1/2.
    let [active] = report.multipliers[..] else { panic!("{:?}", report.multipliers) };
    assert!(!active.is_linear && active.index == 0 && (active.multiplier - 0.5).abs() < 1e-4, "{active:?}");
    let change = (at(0.0).fun - at(-0.01).fun) / 0.01;
    assert!((change - 0.5).abs() < 1e-2, "{change}");
}

#[test]
fn linear_multipliers_are_reported_in_the_unit_of_the_constraint() {
    // min x0^2 + x1^2 with 2 x0 + 2 x1 >= 4: x = (1, 1) and multiplier 1.
    let row = LinearConstraint { coefficients: vec![2.0, 2.0], lower: 4.0, upper: INF };
    let report = minimize(|x: &[f64]| x[0] * x[0] + x[1] * x[1])
        .start(&[5.0, 1.0])
        .constraints(Constraints { linear: vec![row], ..Constraints::default() })
        .method(QuadraticModel::default())
        .run()
        .unwrap();
    let [active] = report.multipliers[..] else { panic!("{:?}", report.multipliers) };
    assert!(active.is_linear && active.index == 0 && (active.multiplier - 1.0).abs() < 1e-4, "{active:?}");
}

#[test]
fn cost_is_not_evaluated_where_a_kept_constraint_is_violated() {
    let (constraints, cost, values) = ellipse(true);
    let outside = Mutex::new(0);
    let guarded = |x: &[f64]| {
        let mut c = Vec::new();
        values(x, &mut c);
        *outside.lock().unwrap() += i32::from(c[0] < -1e-6);
        cost(x)
    };
    let report = minimize(constrained(guarded, values, constraints.clone()))
        .start(&[0.5, 0.5])
        .constraints(constraints)
        .method(QuadraticModel::default())
        .max_evaluations(500)
        .run()
        .unwrap();
    assert_eq!(*outside.lock().unwrap(), 0);
    assert!((report.fun + 30.0).abs() < 1e-3 && report.constr_violation <= 1e-6, "{report}");
}

#[test]
fn infeasible_problems_do_not_succeed() {
    let limits = NonlinearConstraint { lower: -INF, upper: -1.0, keep_feasible: false };
    let constraints = Constraints { nonlinear: vec![limits], ..Constraints::default() };
    let square = |x: &[f64], c: &mut Vec<f64>| c.push(x[0] * x[0] + x[1] * x[1]);
    let report = minimize(constrained(|x: &[f64]| x[0], square, constraints.clone()))
        .start(&[1.0, 1.0])
        .constraints(constraints)
        .method(QuadraticModel::default())
        .max_evaluations(300)
        .run()
        .unwrap();
    assert!(!report.is_success() && report.n_evaluations <= 300, "{report}");
    assert!((report.constr_violation - 1.0).abs() < 1e-2, "{report}");
}

/// One path for any number of workers, and for a run that is continued.
#[test]
fn constrained_runs_are_reproducible_and_resume() {
    let all: Vec<Problem> = linear()
        .into_iter()
        .chain(nonlinear())
        .filter(|p| [112, 86, 43, 71, 113].contains(&p.number))
        .collect();
    for p in &all {
        let calls = AtomicUsize::new(0);
        let counted = |limit: usize| {
            let calls = &calls;
            with_query(move |x: &[f64], _: &Query<'_>| match calls.fetch_add(1, Ordering::Relaxed) {
                k if k >= limit => Outcome::Abort("stopped".to_owned()),
                _ => Outcome::Value((p.cost)(x)),
            })
        };
        let set_up = |limit: usize, workers: usize| {
            minimize(constrained(counted(limit), p.values, p.constraints.clone()))
                .start(&p.start)
                .bounds(&p.lower, &p.upper)
                .unwrap()
                .constraints(p.constraints.clone())
                .method(QuadraticModel::default())
                .workers(workers)
                .max_evaluations(80)
        };
        let whole = set_up(usize::MAX, 1).run().unwrap();
        assert!(whole.n_evaluations <= 80, "{}", p.number);
        for workers in [2, 8] {
            same(&whole, &set_up(usize::MAX, workers).run().unwrap(), "workers");
        }
        let folder = Folder::new(&format!("constraints-{}", p.number));
        let place = || Checkpoint::new(folder.file()).interval(Duration::ZERO);
        calls.store(0, Ordering::Relaxed);
        let first = set_up(22, 1).checkpoint(place()).run().unwrap();
        assert!(!first.is_success(), "{}", p.number);
        calls.store(0, Ordering::Relaxed);
        let place = place().resume(Resume::Require);
        same(&whole, &set_up(usize::MAX, 1).checkpoint(place).run().unwrap(), "resumed");
        assert_eq!(calls.load(Ordering::Relaxed) + 22, whole.n_evaluations, "{}", p.number);
    }
}

/// The first step to an active row ends on it, and the next steps along it violate it by rounding.
#[test]
fn steps_along_an_active_row_are_not_cut_by_rounding() {
    let row = |a: [f64; 2], upper: f64| LinearConstraint { coefficients: a.to_vec(), lower: -INF, upper };
    let linear =
        vec![row([-3.0, -2.0], 5.0), row([-1.0, -1.0], 4.0), row([3.0, -5.0], 1.0), row([-2.0, -1.0], 3.0)];
    // 1/2 x'Qx + c'x with Q = LL' + 0.1, L = [-2 -1; 3 1].
    let cost =
        |x: &[f64]| 0.5 * (5.1 * x[0] * x[0] - 14.0 * x[0] * x[1] + 10.1 * x[1] * x[1]) - x[0] + 9.0 * x[1];
    for method in [AnyMethod::auto(Search::Local), QuadraticModel::default().into()] {
        let report = minimize(cost)
            .start(&[1.0, -7.0])
            .constraints(Constraints { linear: linear.clone(), ..Constraints::default() })
            .method(method)
            .run()
            .unwrap();
        assert!(report.is_success() && (report.fun + 6.344_082_840).abs() < 1e-6, "{report}");
    }
}

/// With all parameters fixed, the only point is evaluated.
#[test]
fn all_parameters_may_be_fixed() {
    for (limit, is_feasible) in [(20.0, true), (5.0, false)] {
        let limits = NonlinearConstraint { lower: -INF, upper: limit, keep_feasible: false };
        let constraints = Constraints { nonlinear: vec![limits], ..Constraints::default() };
        for name in ["quadratic-model", "cma-es", "de", "ga", "multistart", "auto"] {
            let square = |x: &[f64], c: &mut Vec<f64>| c.push(x[0] * x[0] + x[1] * x[1]);
            let report = minimize(constrained(|x: &[f64]| x[0] + x[1], square, constraints.clone()))
                .start(&[2.0, 3.0])
                .bounds(&[2.0, 3.0], &[2.0, 3.0])
                .unwrap()
                .constraints(constraints.clone())
                .method(name.parse::<AnyMethod>().unwrap())
                .run()
                .unwrap();
            assert_eq!((report.fun, report.n_evaluations), (5.0, 1), "{report}");
            assert_eq!(report.constr_violation == 0.0, is_feasible, "{report}");
        }
    }
}

/// A warm start uses the constraint values of earlier points, and ignores points without them.
#[test]
fn warm_start_needs_the_constraint_values_of_earlier_points() {
    let (constraints, cost, values) = ellipse(false);
    let calls = AtomicUsize::new(0);
    let counted = |x: &[f64]| {
        calls.fetch_add(1, Ordering::Relaxed);
        cost(x)
    };
    let set_up = |constraints: Constraints| {
        minimize(constrained(counted, values, constraints.clone()))
            .start(&[0.5, 0.5])
            .constraints(constraints)
            .method(QuadraticModel::default())
            .problem("ellipse")
    };
    let first = set_up(constraints.clone()).run().unwrap();
    let n = calls.swap(0, Ordering::Relaxed);
    let again = set_up(constraints.clone()).warm_start(&first.trace).run().unwrap();
    assert!(again.is_success() && again.n_cached >= 1 && again.fun <= first.fun + 1e-9, "{again}");
    assert!(calls.swap(0, Ordering::Relaxed) < n + 10, "{again}");
    // The best earlier point is feasible, although an infeasible one has a lower cost.
    let point = |x: [f64; 2]| {
        let mut constraints = Vec::new();
        values(&x, &mut constraints);
        let problem = Some("ellipse".to_owned());
        EvaluatedPoint { x: x.to_vec(), cost: cost(&x), residuals: Vec::new(), constraints, problem }
    };
    let points = [point([2.0, 4.0]), point([1.0, 1.25])];
    assert!(points[0].cost < points[1].cost && points[0].constraints[0] < 0.0);
    let again = set_up(constraints.clone()).evaluated_points(points).max_evaluations(1).run().unwrap();
    let next = again.trace.iter().next().unwrap();
    assert!(again.n_cached == 1 && next.x[1] == 1.25, "{again} {next:?}");
    // Points of a run with another number of constraints.
    let free = minimize(cost).start(&[3.0, 3.0]).problem("ellipse").max_evaluations(30).run().unwrap();
    let fresh = set_up(constraints.clone()).warm_start(&free.trace).run().unwrap();
    assert_eq!((&fresh.x, fresh.n_cached), (&first.x, first.n_cached));
    let unconstrained = minimize(cost).start(&[3.0, 3.0]).problem("ellipse").warm_start(&first.trace);
    assert_eq!(unconstrained.max_evaluations(30).run().unwrap().x, free.x);
}

/// Failed points have no constraint values, or too few.
#[test]
fn failed_points_with_too_few_constraint_values_are_not_confused() {
    let limits = |lower, upper| NonlinearConstraint { lower, upper, keep_feasible: false };
    let nonlinear = vec![limits(-INF, 1.0), limits(-INF, 0.5)];
    let constraints = Constraints { nonlinear, ..Constraints::default() };
    for name in ["quadratic-model", "cma-es", "de", "multistart"] {
        let mut run = by_hand()
            .start(&[0.2, 0.2])
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .constraints(constraints.clone())
            .method(name.parse::<AnyMethod>().unwrap())
            .seed(1)
            .max_evaluations(800)
            .optimizer()
            .unwrap();
        loop {
            let points = run.ask(usize::MAX);
            if points.is_empty() {
                break;
            }
            for (k, point) in points.iter().enumerate() {
                let x = &point.x;
                let all = [x[0] * x[0] + x[1] * x[1], x[0]];
                // The first point of some batches fails, and points beyond a line fail.
                let fails = k == 0 && points.len() > 1 && point.id % 3 == 1 || x[1] > 1.3;
                let mut answer = Answer::from(match fails {
                    true => Outcome::failed("no"),
                    false => Outcome::Value(-2.0 * x[0] - x[1]),
                });
                answer.constraints.extend(&all[..if fails { k % 2 } else { 2 }]);
                run.tell(point.id, answer).unwrap();
            }
        }
        let report = run.report().unwrap();
        // The corner of the circle and the line.
        assert!((report.fun + 1.0 + 0.75f64.sqrt()).abs() < 5e-3, "{report}");
        assert!(report.constr_violation <= 1e-6, "{report}");
    }
}

/// A caller cannot know which points a constraint forbids, so their costs are ignored.
#[test]
fn told_costs_of_forbidden_points_are_ignored() {
    let (constraints, cost, values) = ellipse(true);
    let driven = minimize(constrained(cost, values, constraints.clone()))
        .start(&[2.3, 1.5])
        .constraints(constraints.clone())
        .method(QuadraticModel::default())
        .run()
        .unwrap();
    let mut run = by_hand()
        .start(&[2.3, 1.5])
        .constraints(constraints.clone())
        .method(QuadraticModel::default())
        .optimizer()
        .unwrap();
    loop {
        let points = run.ask(usize::MAX);
        if points.is_empty() {
            break;
        }
        for point in points {
            let mut answer = Answer::from(Outcome::Value(cost(&point.x)));
            values(&point.x, &mut answer.constraints);
            run.tell(point.id, answer).unwrap();
        }
    }
    let report = run.report().unwrap();
    assert_eq!((&report.x, report.n_evaluations), (&driven.x, driven.n_evaluations));
    assert_eq!((report.n_failed, report.n_infeasible), (0, driven.n_infeasible));
    assert!(report.n_infeasible > 0, "{report}");
    // No feasible point.
    let start = [9.0, 9.0];
    let error = minimize(constrained(cost, values, constraints.clone()))
        .start(&start)
        .bounds(&[8.0; 2], &[10.0; 2])
        .unwrap()
        .constraints(constraints)
        .method(QuadraticModel::default())
        .max_evaluations(60)
        .run()
        .unwrap_err();
    assert!(error.to_string().contains("violate a constraint with keep_feasible, none failed"), "{error}");
}
