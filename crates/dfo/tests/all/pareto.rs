//! Fronts of several criteria: closed forms, constraints, and the contracts of every method.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::{checkpoint, common};

use checkpoint::Folder;
use common::timeless;
use dfo::{
    Answer, Checkpoint, Constraints, Error, EvaluationKind, LinearConstraint, Minimize, NonlinearConstraint,
    Nsga2, Objective, Outcome, ParameterKind, ParetoFront, Progress, Query, Report, Termination, constrained,
    hypervolume, minimize, pareto, residuals,
};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Squared distances to (1, 0) and (-1, 0). On the front, between the two points, the sum of the distances is 2.
fn distances(x: &[f64], out: &mut Vec<f64>) {
    out.extend([(x[0] - 1.0).powi(2) + x[1] * x[1], (x[0] + 1.0).powi(2) + x[1] * x[1]]);
}

fn two_points<'a>() -> Minimize<'a, Nsga2> {
    pareto(distances).bounds(&[-3.0; 2], &[3.0; 2]).unwrap().method(Nsga2::default().population(40)).seed(7)
}

fn front(report: &Report) -> &ParetoFront {
    report.front.as_ref().unwrap()
}

#[test]
fn front_of_two_convex_criteria_matches_its_closed_form() {
    let report = two_points().max_evaluations(4000).run().unwrap();
    let front = front(&report);
    assert_eq!(front.points.len(), 40, "{report}");
    // A point exceeds the criteria of the nearest point of the exact front by y^2. If it exceeded them by the distance
    // of neighbours, about 4 / 40, a neighbour would dominate it.
    let is_near = |x: &[f64]| x[1] * x[1] < 0.1 && x[0].abs() < 1.01;
    assert!(front.points.iter().all(|point| is_near(&point.x)), "{front:?}");
    let sums = front.points.iter().map(|point| point.criteria.iter().map(|f| f.sqrt()).sum::<f64>());
    let mean = sums.sum::<f64>() / 40.0;
    assert!((2.0..2.01).contains(&mean), "{mean}");
    let first = |k: usize| front.points[k].criteria[0];
    assert!((1..40).all(|k| first(k - 1) <= first(k)));
    assert!(first(0) < 1e-3 && first(39) > 3.9, "{report}");
    // The volume below the curve sqrt(f1) + sqrt(f2) = 2 up to (4, 4) is 16 - 8 / 3.
    let volume = front.hypervolume(&[4.0, 4.0]).unwrap();
    assert!((0.98..1.0).contains(&(volume / (16.0 - 8.0 / 3.0))), "{volume}");
    // The result is the compromise. By symmetry it is near the middle.
    let (compromise, distance) = front.compromise().unwrap();
    assert_eq!((&report.x, report.fun), (&compromise.x, distance));
    assert_eq!(report.residuals.as_ref(), Some(&compromise.criteria));
    assert!(report.x[0].abs() < 0.1 && report.is_success(), "{report}");
    assert!(report.message.contains("40 points"), "{}", report.message);
}

#[test]
fn front_of_zdt1_has_nearly_the_hypervolume_of_the_true_front() {
    // Zitzler, Deb and Thiele (2000); the front is f2 = 1 - sqrt(f1), its volume up to (1.1, 1.1) is 0.8767.
    let zdt1 = |x: &[f64], out: &mut Vec<f64>| {
        let g = 1.0 + 9.0 * x[1..].iter().sum::<f64>() / (x.len() - 1) as f64;
        out.extend([x[0], g * (1.0 - (x[0] / g).sqrt())]);
    };
    let report = pareto(zdt1).bounds(&[0.0; 30], &[1.0; 30]).unwrap().seed(1).run().unwrap();
    assert_eq!((report.n_evaluations, report.n_iterations), (25_000, 249), "{report}");
    let exact = 1.1 * 1.1 - 1.0 / 3.0;
    let volume = front(&report).hypervolume(&[1.1, 1.1]).unwrap();
    assert!((0.99..1.0).contains(&(volume / exact)), "{volume}");
}

/// BNH (Binh and Korn 1997): the front is x = y in [0, 3], then y = 3 with x up to 5.
fn bnh(keep_feasible: bool) -> Report {
    let limits = |lower, upper| NonlinearConstraint { lower, upper, keep_feasible };
    let nonlinear = vec![limits(f64::NEG_INFINITY, 25.0), limits(7.7, f64::INFINITY)];
    let constraints = Constraints { nonlinear, ..Constraints::default() };
    let criteria = |x: &[f64], out: &mut Vec<f64>| {
        out.extend([4.0 * (x[0] * x[0] + x[1] * x[1]), (x[0] - 5.0).powi(2) + (x[1] - 5.0).powi(2)]);
    };
    let values = |x: &[f64], c: &mut Vec<f64>| {
        c.extend([(x[0] - 5.0).powi(2) + x[1] * x[1], (x[0] - 8.0).powi(2) + (x[1] + 3.0).powi(2)]);
    };
    minimize(constrained(residuals(criteria), values, constraints.clone()))
        .bounds(&[0.0; 2], &[5.0, 3.0])
        .unwrap()
        .constraints(constraints)
        .method(Nsga2::default())
        .seed(2)
        .max_evaluations(10_000)
        .run()
        .unwrap()
}

#[test]
fn front_satisfies_nonlinear_constraints() {
    for keep_feasible in [false, true] {
        let report = bnh(keep_feasible);
        for point in &front(&report).points {
            let [x, y] = point.x[..] else { panic!("{point:?}") };
            assert!(point.constr_violation <= 1e-6 && (x - 5.0).powi(2) + y * y <= 25.0 + 1e-6);
        }
        // The volume of 100 000 points of the exact front.
        let exact = {
            let on_front = |t: f64| if t < 3.0 { [t, t] } else { [t, 3.0] };
            let criteria = |[x, y]: [f64; 2]| [4.0 * (x * x + y * y), (x - 5.0).powi(2) + (y - 5.0).powi(2)];
            let points: Vec<_> = (0..=100_000).map(|k| criteria(on_front(5e-5 * f64::from(k)))).collect();
            hypervolume(&points, &[140.0, 50.0]).unwrap()
        };
        let volume = front(&report).hypervolume(&[140.0, 50.0]).unwrap();
        assert!((0.99..=1.0).contains(&(volume / exact)), "{volume} {exact}");
    }
}

#[test]
fn no_feasible_point_gives_an_empty_front_and_the_smallest_violation() {
    let constraints = Constraints {
        nonlinear: vec![NonlinearConstraint { lower: 100.0, upper: 200.0, keep_feasible: false }],
        ..Constraints::default()
    };
    let values = |x: &[f64], c: &mut Vec<f64>| c.push(x[0] + x[1]);
    let report = minimize(constrained(residuals(distances), values, constraints.clone()))
        .bounds(&[-3.0; 2], &[3.0; 2])
        .unwrap()
        .constraints(constraints)
        .method(Nsga2::default())
        .seed(1)
        .max_evaluations(1000)
        .run()
        .unwrap();
    assert!(front(&report).points.is_empty() && !report.is_success(), "{report}");
    assert!((report.constr_violation - 94.0).abs() < 0.5, "{report}");
}

#[test]
fn linear_constraints_and_discrete_parameters_hold_at_every_point() {
    use ParameterKind::{Categorical, Continuous, Integer};
    let row =
        LinearConstraint { coefficients: vec![0.0, 1.0, 0.0, 1.0], lower: f64::NEG_INFINITY, upper: 1.0 };
    let criteria = |x: &[f64], out: &mut Vec<f64>| {
        assert!(x[1] + x[3] <= 1.0 + 1e-12 && x[0] == x[0].round() && x[2] == x[2].round());
        out.extend([(x[0] - 4.0).powi(2) + (x[3] - 2.0).powi(2) + x[2], (x[1] - 2.0).powi(2) + (3.0 - x[2])]);
    };
    let report = pareto(criteria)
        .bounds(&[-5.0, -5.0, 0.0, -5.0], &[5.0, 5.0, 3.0, 5.0])
        .unwrap()
        .kinds(&[Integer, Continuous, Categorical, Continuous])
        .constraints(Constraints { linear: vec![row], ..Constraints::default() })
        .seed(3)
        .max_evaluations(3000)
        .run()
        .unwrap();
    // The ends of the front: the integer 4 with the value 0 and x[3] = 2, and the value 3 with x[1] = 2.
    let points = &front(&report).points;
    assert!(
        points[0].criteria[0] < 0.01 && points[0].x[0] == 4.0 && points[0].x[2] == 0.0,
        "{:?}",
        points[0]
    );
    assert!(points.last().unwrap().criteria[1] < 0.01, "{:?}", points.last());
}

#[test]
fn workers_do_not_change_a_front_and_budgets_are_exact() {
    let run = |workers| two_points().workers(workers).max_evaluations(437).run().unwrap();
    let serial = run(1);
    assert_eq!((serial.n_evaluations, serial.termination.clone()), (437, Termination::MaxEvaluations));
    for workers in [2, 4] {
        let report = run(workers);
        assert_eq!(report.front, serial.front);
        assert_eq!((&report.x, report.fun.to_bits()), (&serial.x, serial.fun.to_bits()));
        assert_eq!(timeless(&report.trace), timeless(&serial.trace));
    }
}

#[test]
fn children_of_an_incomplete_generation_are_in_the_front() {
    // Points near the origin minimise both criteria. The last evaluated point dominates all others.
    let calls = AtomicUsize::new(0);
    let criteria = |_: &[f64], out: &mut Vec<f64>| {
        let last = calls.fetch_add(1, Ordering::Relaxed) == 99;
        out.extend(if last { [-1.0, -1.0] } else { [1.0, 1.0] });
    };
    let run = pareto(criteria).bounds(&[0.0; 2], &[1.0; 2]).unwrap().method(Nsga2::default().population(40));
    let report = run.seed(1).max_evaluations(100).run().unwrap();
    assert_eq!(front(&report).points.len(), 1);
    assert_eq!(front(&report).points[0].criteria, [-1.0, -1.0]);
}

#[test]
fn stopped_runs_continue_bit_for_bit() {
    let whole = two_points().max_evaluations(900).run().unwrap();
    let folder = Folder::new("pareto");
    let mut report = None;
    for budget in [15, 130, 131, 900, 900] {
        let checkpoint = Checkpoint::new(folder.file()).interval(Duration::ZERO);
        report = Some(two_points().checkpoint(checkpoint).max_evaluations(budget).workers(2).run().unwrap());
    }
    let report = report.unwrap();
    assert_eq!((&report.front, &report.x), (&whole.front, &whole.x));
    assert_eq!(timeless(&report.trace), timeless(&whole.trace));
    // An abort, as after a crash of the process.
    let folder = Folder::new("pareto-aborted");
    for crash in [300, usize::MAX] {
        let calls = AtomicUsize::new(0);
        let objective = AbortAfter { calls: &calls, crash };
        let report = minimize(objective)
            .bounds(&[-3.0; 2], &[3.0; 2])
            .unwrap()
            .method(Nsga2::default().population(40))
            .seed(7)
            .checkpoint(Checkpoint::new(folder.file()).interval(Duration::ZERO))
            .max_evaluations(900)
            .run()
            .unwrap();
        if crash == usize::MAX {
            assert_eq!((&report.front, &report.x), (&whole.front, &whole.x));
            assert!(calls.load(Ordering::Relaxed) <= 600);
        }
    }
    // Other options, and a damaged file.
    let checkpoint = || Checkpoint::new(folder.file());
    let other = two_points().method(Nsga2::default()).checkpoint(checkpoint()).max_evaluations(900).run();
    assert!(other.unwrap_err().to_string().contains("population"));
    let bytes = std::fs::read(folder.file()).unwrap();
    for (at, len) in [(bytes.len() / 2, bytes.len()), (0, bytes.len() / 2)] {
        let mut damaged = bytes[..len].to_vec();
        damaged[at] ^= 0x55;
        std::fs::write(folder.file(), &damaged).unwrap();
        let error = two_points().checkpoint(checkpoint()).max_evaluations(900).run().unwrap_err();
        assert!(error.to_string().contains("checkpoint"), "{error}");
    }
}

struct AbortAfter<'a> {
    calls: &'a AtomicUsize,
    crash: usize,
}

impl Objective for AbortAfter<'_> {
    fn has_residuals(&self) -> bool {
        true
    }

    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        assert_eq!(query.kind, EvaluationKind::Residuals);
        if self.calls.fetch_add(1, Ordering::Relaxed) >= self.crash {
            answer.outcome = Outcome::Abort("crash".to_owned());
            return;
        }
        residuals(distances).evaluate(x, query, answer);
    }
}

#[test]
fn failed_points_are_counted_and_never_in_the_front() {
    let criteria = |x: &[f64], out: &mut Vec<f64>| {
        distances(x, out);
        if x[0] > 0.5 {
            out[1] = f64::NAN;
        }
    };
    let report =
        pareto(criteria).bounds(&[-3.0; 2], &[3.0; 2]).unwrap().seed(1).max_evaluations(3000).run().unwrap();
    assert!(report.n_failed > 0 && front(&report).points.iter().all(|point| point.x[0] <= 0.5), "{report}");
    assert!(front(&report).points[0].criteria[0] < 0.26, "{report}");
    let all =
        pareto(|_: &[f64], out: &mut Vec<f64>| out.extend([f64::NAN, 1.0])).bounds(&[0.0], &[1.0]).unwrap();
    assert!(matches!(all.seed(1).max_evaluations(300).run(), Err(Error::AllStartsFailed(_))));
}

#[test]
fn observer_sees_the_growing_front_and_ends_the_run() {
    let sizes = std::cell::RefCell::new(Vec::new());
    let observer = |progress: &Progress<'_>| {
        let front = progress.front.unwrap();
        let (compromise, distance) = front.compromise().unwrap();
        assert_eq!((progress.x, progress.fun), (&compromise.x[..], distance));
        sizes.borrow_mut().push(front.points.len());
        if progress.n_iterations == 5 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let report = two_points().observer(observer).run().unwrap();
    assert_eq!((report.n_iterations, report.termination), (5, Termination::StoppedByObserver));
    assert_eq!(sizes.borrow().len(), 6);
}

#[test]
fn pareto_reports_unusable_problems() {
    let open =
        pareto(distances).bounds(&[-3.0, f64::NEG_INFINITY], &[3.0; 2]).unwrap().start(&[0.0; 2]).run();
    assert!(matches!(open, Err(Error::NeedsBox { method: "nsga2", index: 1, .. })));
    let cost = minimize(|x: &[f64]| x[0]).bounds(&[0.0], &[1.0]).unwrap().method(Nsga2::default()).run();
    assert!(matches!(cost, Err(Error::NeedsResiduals { method: "nsga2" })));
    let varying = |x: &[f64], out: &mut Vec<f64>| out.resize(if x[0] > 0.5 { 2 } else { 3 }, x[0]);
    let varying = pareto(varying).bounds(&[0.0], &[1.0]).unwrap().seed(1).run();
    assert!(matches!(varying, Err(Error::ResidualCount { .. })), "{varying:?}");
    let population = two_points().method(Nsga2::default().population(1)).run();
    assert!(matches!(population, Err(Error::Option { name: "population", .. })));
    // A single parameter set is its own front.
    let fixed = pareto(distances).bounds(&[0.0; 2], &[0.0; 2]).unwrap().run().unwrap();
    assert_eq!((front(&fixed).points.len(), fixed.termination), (1, Termination::AllFixed));
}
