//! Least squares: the contracts with residuals, and evaluations on published problems.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;
use crate::problems;

use common::{probe_fails, rosenbrock, timeless};
use dfo::{
    Answer, Answers, AnyMethod, Batch, Bounds, Checkpoint, Error, LeastSquares, Method, MethodOptions,
    Minimize, Objective, Outcome, Query, Record, Report, RunContext, Setup, Space, Termination, Value,
    by_hand, minimize, residuals,
};
use problems::calibration::fits;
use problems::nist::regressions;
use problems::{instances, residuals as more_wild};
use std::cell::Cell;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// Rosenbrock's function as residuals, with failing regions.
fn probe(x: &[f64], out: &mut Vec<f64>) {
    if probe_fails(x) {
        out.push(f64::NAN);
    }
    out.extend([10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
}

fn boxed<M, D>(run: Minimize<'_, M, D>, batch: usize) -> Minimize<'_, LeastSquares, D> {
    let run = run.start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap();
    run.method(LeastSquares::default().batch(batch))
}

static OVER: AtomicBool = AtomicBool::new(true);

const BATCHES: [usize; 4] = [1, 2, 4, 7];

#[test]
fn least_squares_survives_failing_regions() {
    for batch in 1..9 {
        for start in [[-0.5, 1.0], [-0.7, 1.2], [0.1, 0.9], [-1.0, 1.5], [-1.1, 1.1], [0.0, 0.3]] {
            let run = boxed(minimize(residuals(probe)), batch).start(&start).max_evaluations(2000);
            let report = run.run().unwrap();
            assert!(report.fun < 1e-6 && report.n_evaluations < 600, "{batch}, {start:?}: {report}");
        }
    }
}

type Summary = (Vec<(Vec<u64>, Outcome, u64, u64, u64, bool)>, Vec<f64>, u64, Termination, String);

fn reported(report: &Report) -> Summary {
    let Report { trace, x, fun, termination, message, .. } = report;
    (timeless(trace), x.clone(), fun.to_bits(), termination.clone(), message.clone())
}

#[test]
fn budgets_are_exact_within_rounds() {
    for batch in BATCHES {
        for budget in 1..=60 {
            let calls = AtomicUsize::new(0);
            let counted = |x: &[f64], out: &mut Vec<f64>| {
                calls.fetch_add(1, Ordering::Relaxed);
                probe(x, out);
            };
            let report = boxed(minimize(residuals(counted)), batch).max_evaluations(budget).run().unwrap();
            assert_eq!(calls.into_inner(), report.n_evaluations);
            let by_budget = report.termination == Termination::MaxEvaluations;
            assert!(
                report.n_evaluations == budget || !by_budget && report.n_evaluations < budget,
                "{report}"
            );
            assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)), "{batch} {budget}");
        }
        for iterations in [0, 1, 5] {
            let report = boxed(minimize(residuals(probe)), batch).max_iterations(iterations).run().unwrap();
            assert_eq!((report.n_iterations, &report.termination), (iterations, &Termination::MaxIterations));
        }
        let report = boxed(minimize(residuals(probe)), batch).target(0.2).run().unwrap();
        assert!(report.termination == Termination::Target && report.fun <= 0.2, "{report}");
    }
}

#[test]
fn ask_tell_run_is_identical_after_cancelled_ask() {
    // With so large a number of residuals, the model is built in blocks.
    let many = |x: &[f64], out: &mut Vec<f64>| {
        out.extend((0..30_000).map(|i| {
            let t = 1e-4 * f64::from(i);
            x[0] * (-x[1] * t).exp() - 2.0 * (-0.5 * t).exp() + 1e-3 * (37.0 * t).sin()
        }));
    };
    let objective = residuals(many);
    let run = |is_cancelled: bool| {
        let mut optimizer = boxed(by_hand(), 1).max_evaluations(20).optimizer().unwrap();
        let over = RunContext::new().flagged(&OVER);
        let context = if is_cancelled { over } else { RunContext::new() };
        let mut n_put_off = 0;
        while optimizer.termination().is_none() {
            let mut points = optimizer.ask_unless(1, &context);
            n_put_off += usize::from(points.is_empty());
            if points.is_empty() {
                points = optimizer.ask(1);
            }
            for point in points {
                let answer = objective.answer(&point.x, &point.query());
                optimizer.tell_unless(point.id, answer, &context).unwrap();
            }
        }
        let report = optimizer.report().unwrap();
        ((timeless(&report.trace), report.x, report.termination), n_put_off)
    };
    let ((cancelled, n_put_off), (plain, none)) = (run(true), run(false));
    assert!(cancelled == plain && n_put_off > 0 && none == 0, "{n_put_off} {cancelled:?} {plain:?}");
}

#[test]
fn result_is_identical_with_workers_ask_tell_and_resume() {
    let folder = tempfile::tempdir().unwrap();
    let noisy = |x: &[f64], out: &mut Vec<f64>| {
        probe(x, out);
        let shake = (1e4 * x[0] + 3e4 * x[1]).sin();
        out.iter_mut().for_each(|r| *r += 1e-3 * shake);
    };
    for batch in BATCHES {
        let run = || boxed(minimize(residuals(noisy)), batch).max_evaluations(150);
        let plain = run().run().unwrap();
        for workers in [2, 5] {
            assert_eq!(
                reported(&run().workers(workers).run().unwrap()),
                reported(&plain),
                "{batch} {workers}"
            );
        }
        let mut optimizer = boxed(by_hand(), batch).max_evaluations(150).optimizer().unwrap();
        let objective = residuals(noisy);
        while optimizer.termination().is_none() {
            for point in optimizer.ask(3).into_iter().rev() {
                optimizer.tell(point.id, objective.answer(&point.x, &point.query())).unwrap();
            }
        }
        let by_hand = optimizer.report().unwrap();
        assert_eq!(
            (timeless(&by_hand.trace), by_hand.x),
            (timeless(&plain.trace), plain.x.clone()),
            "{batch}"
        );
        for budget in 1..plain.n_evaluations {
            let place = folder.path().join(format!("{batch} {budget}"));
            let at = || Checkpoint::new(&place).interval(Duration::ZERO);
            drop(run().max_evaluations(budget).checkpoint(at()).run());
            assert_eq!(
                reported(&run().checkpoint(at()).run().unwrap()),
                reported(&plain),
                "{batch} {budget}"
            );
        }
    }
}

#[test]
fn objective_without_residuals_is_rejected_before_evaluation() {
    let calls = AtomicUsize::new(0);
    let cost = |x: &[f64]| {
        calls.fetch_add(1, Ordering::Relaxed);
        rosenbrock(x)
    };
    let refused = minimize(cost).start(&[1.0, 2.0]).method(LeastSquares::default()).run();
    let Err(error @ Error::NeedsResiduals { .. }) = refused else { panic!("{refused:?}") };
    assert!(error.to_string().starts_with("least-squares requires residuals"), "{error}");
    assert_eq!(calls.into_inner(), 0);
}

#[test]
fn least_squares_continues_after_failing_directions() {
    // Only three of the five points of the first round have residuals. One direction has none on either side.
    let wall = |x: &[f64], out: &mut Vec<f64>| {
        if x[2] == 0.5 && (x[3] == 0.5 || x[0] != 0.5) {
            out.extend([x[0] - 0.7, x[1] - 0.2, 0.0]);
        } else {
            out.push(f64::NAN);
        }
    };
    let run = |start: &[f64]| {
        let run = minimize(residuals(wall)).start(start).bounds(&[0.0; 4], &[1.0; 4]).unwrap();
        run.method(LeastSquares::default()).max_evaluations(200).run()
    };
    let report = run(&[0.5; 4]).unwrap();
    assert!((report.x[1] - 0.2).abs() < 1e-4 && (report.x[0] - 0.7).abs() < 1e-4, "{report}");
    let from_outside = |x: &[f64], out: &mut Vec<f64>| {
        if x[0] < 0.55 {
            out.push(f64::INFINITY);
        }
        out.extend([x[0] - 0.7, x[1] - 0.2]);
    };
    let run = minimize(residuals(from_outside)).start(&[0.5; 2]).bounds(&[0.0; 2], &[1.0; 2]).unwrap();
    let report = run.method(LeastSquares::default()).run().unwrap();
    assert!(report.is_success() && report.fun < 1e-10, "{report}");
}

/// Returns the percentages solved within 25 and within 100 units, and the median of the units.
fn profile(mut units: Vec<f64>) -> (f64, f64, f64) {
    units.sort_by(f64::total_cmp);
    let share = |most: f64| 100.0 * units.iter().filter(|u| **u <= most).count() as f64 / units.len() as f64;
    (share(25.0), share(f64::MAX), units[units.len() / 2])
}

/// Returns the evaluations in units of n + 1, or the rounds, until the noise-free cost is near the best known
/// cost.
fn units(tau: f64, batch: fn(usize) -> usize, in_rounds: bool, noise: Option<u64>) -> Vec<f64> {
    let instances = instances();
    let solve = |p: &problems::Instance| {
        let f = |x: &[f64], out: &mut Vec<f64>| {
            out.extend(more_wild(p.number, p.m, x));
            if let Some(seed) = noise {
                let mut dice = x
                    .iter()
                    .fold(seed, |h, v| (h ^ v.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (h >> 29));
                out.iter_mut().for_each(|r| *r *= 1.0 + 1e-3 * normal(&mut dice));
            }
        };
        let run = minimize(residuals(f)).start(&p.start()).x_tol(0.0).f_tol(0.0);
        let method = LeastSquares::default().batch(batch(p.n));
        let report = run.method(method).max_evaluations(100 * (p.n + 1)).run().unwrap();
        let first = p.cost(&p.start());
        let goal = first - (1.0 - tau) * (first - p.best);
        let solved = report.trace.iter().enumerate().find(|(_, e)| p.cost(e.x) <= goal);
        solved.map_or(f64::INFINITY, |(k, e)| {
            if in_rounds { (e.batch + 1) as f64 } else { (k + 1) as f64 / (p.n + 1) as f64 }
        })
    };
    instances.iter().map(solve).collect()
}

/// Returns an approximately normal number: the sum of twelve uniform numbers.
fn normal(dice: &mut u64) -> f64 {
    let mut next = || {
        *dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*dice >> 33) as f64 / (1u64 << 31) as f64
    };
    (0..12).map(|_| next()).sum::<f64>() - 6.0
}

#[test]
fn least_squares_solves_smooth_problems_in_few_evaluations() {
    for (tau, soon, in_all, most) in [(1e-5, 89.0, 92.0, 4.2), (1e-7, 0.0, 87.0, 8.0)] {
        let (within_25, within_100, median) = profile(units(tau, |_| 1, false, None));
        println!("tau {tau:e}: {within_25:.0} % within 25, {within_100:.0} % within 100, median {median:.1}");
        assert!(within_25 >= soon && within_100 >= in_all && median <= most);
    }
}

/// Evaluations until the end with default tolerances, in units of n + 1. SciPy's
/// `least_squares(method="trf")` needs 8.7.
#[test]
#[cfg_attr(windows, ignore = "the counts depend on the last digits of mathematical functions")]
fn least_squares_ends_in_few_evaluations() {
    let mut units = Vec::new();
    for regression in regressions() {
        for start in &regression.starts {
            let f = |x: &[f64], out: &mut Vec<f64>| out.extend(regression.residuals(x));
            let run = minimize(residuals(f)).start(start).method(LeastSquares::default());
            let report = run.max_evaluations(200 * (start.len() + 1)).run().unwrap();
            units.push(report.n_evaluations as f64 / (start.len() + 1) as f64);
        }
    }
    let (_, _, median) = profile(units);
    println!("to the end: median {median:.1}");
    assert!(median <= 8.7);
}

#[test]
fn larger_rounds_reduce_their_number() {
    type Width = fn(usize) -> usize;
    let widths: [(&str, Width, f64); 3] =
        [("n + 1", |n| n + 1, 12.0), ("n + 4", |n| n + 4, 10.0), ("4 (n + 1)", |n| 4 * n + 4, 8.0)];
    for (name, width, most) in widths {
        let (_, solved, median) = profile(units(1e-5, width, true, None));
        println!("rounds of {name}: {solved:.0} % solved, median {median}");
        assert!(solved >= 90.0 && median <= most);
    }
    let mut rounds = Vec::new();
    for fit in fits() {
        for start in fit.starts() {
            let f = |x: &[f64], out: &mut Vec<f64>| out.extend(fit.residuals(x));
            let run = minimize(residuals(f)).start(&start).x_tol(0.0).f_tol(0.0);
            let run = run.method(LeastSquares::default().rounds()).max_evaluations(100 * (start.len() + 1));
            let (report, goal) = (run.run().unwrap(), 1e-5 * fit.cost(&start));
            let solved = report.trace.iter().find(|e| e.outcome.value().is_some_and(|f| f <= goal));
            rounds.push(solved.map_or(f64::INFINITY, |e| (e.batch + 1) as f64));
        }
    }
    let (_, solved, median) = profile(rounds);
    println!("rounds of fits: {solved:.0} % solved, median {median}");
    assert!(solved >= 95.0 && median <= 8.0);
}

/// The rounds plan uses n + 4 points, even if it is chosen by name.
#[test]
fn rounds_plan_is_chosen_by_name() {
    let by_name = |plan: &str| {
        let options = Record::from([("batch".to_owned(), Value::Text(plan.to_owned()))]);
        "least-squares".parse::<AnyMethod>().unwrap().with_options(&options)
    };
    let run =
        |method: AnyMethod| minimize(residuals(chained)).start(&[-1.2, 1.0]).method(method).run().unwrap();
    let rounds = run(by_name("rounds").unwrap());
    assert_eq!(rounds.batch, "rounds");
    assert_eq!(reported(&rounds), reported(&run(LeastSquares::default().rounds().into())));
    assert_eq!(reported(&rounds), reported(&run(LeastSquares::default().batch(6).into())));
    assert_eq!(reported(&run(by_name("serial").unwrap())), reported(&run(LeastSquares::default().into())));
    let refused = by_name("four").unwrap_err();
    assert!(format!("{refused:?}").contains("an integer, 'auto', 'serial' or 'rounds'"), "{refused:?}");
}

/// Equal residuals at all points of the model are not a minimum.
#[test]
fn least_squares_leaves_a_plateau() {
    let stairs = |x: &[f64], out: &mut Vec<f64>| out.push((10.0 * rosenbrock(x)).floor() / 10.0);
    for (start, most) in [([-1.2, 1.0], 4.0), ([0.3, -0.5], 0.3), ([2.0, 2.0], 0.2)] {
        let report = minimize(residuals(stairs)).start(&start).method(LeastSquares::default()).run().unwrap();
        assert!(report.fun < most, "{report}");
    }
}

#[test]
fn least_squares_averages_noise_of_a_thousandth() {
    let (_, solved, median) = profile(units(1e-5, |_| 1, false, Some(1)));
    println!("noise 1e-3: {solved:.0} % solved, median {median:.1}");
    assert!(solved >= 86.0);
}

/// Parameters with sizes from 1e-6 to 1e6 that start at zero: saturating decays and linear models.
#[test]
fn least_squares_finds_unknown_sizes() {
    let mut evaluations = Vec::new();
    for case in 0..60i32 {
        let dice = |k: i32| f64::from((case * 7919 + k * 104_729) % 1000) / 1000.0;
        let sizes: Vec<f64> = (0..3).map(|k| 10f64.powf(12.0 * dice(k) - 6.0)).collect();
        let truth: Vec<f64> = (0..3).map(|k| sizes[k as usize] * (0.5 + dice(k + 3))).collect();
        let model = |x: &[f64], t: f64| {
            x[0] / sizes[0] * t + 1.0 - (-x[1] / sizes[1] * t).exp() - (x[2] / sizes[2]).tanh()
        };
        let f = |x: &[f64], out: &mut Vec<f64>| {
            out.extend((0..9).map(|i| 0.2 * f64::from(i)).map(|t| model(x, t) - model(&truth, t)));
        };
        let report = minimize(residuals(f)).start(&[0.0; 3]).method(LeastSquares::default()).run().unwrap();
        assert!(report.is_success() && report.fun < 1e-9, "{case}: {sizes:?} {report}");
        evaluations.push(report.n_evaluations);
    }
    evaluations.sort_unstable();
    println!("unknown sizes: median {} evaluations, at most {}", evaluations[30], evaluations[59]);
    assert!(evaluations[59] < 150);
}

/// One parameter has no effect.
#[test]
fn parameter_without_effect_needs_few_evaluations() {
    let model = |x: &[f64], out: &mut Vec<f64>| {
        out.extend(
            (0..30)
                .map(|i| 4.0 / 29.0 * f64::from(i))
                .map(|t| x[0] * (-x[1] * t).exp() - 2.0 * (-0.7 * t).exp() - 0.01 * (9.0 * t).sin()),
        );
    };
    let report =
        minimize(residuals(model)).start(&[1.0, 1.0, 5.0]).method(LeastSquares::default()).run().unwrap();
    assert!(report.is_success() && report.n_evaluations < 80, "{report}");
}

/// Many residuals of few parameters.
fn large(x: &[f64], out: &mut Vec<f64>) {
    out.extend((0..300_000).map(|i| {
        let t = f64::from(i) / 300_000.0;
        x[0] * (-x[1] * t).exp() + x[2] * (9.0 * t).sin() - 2.0 * (-0.7 * t).exp() - 0.1 * (40.0 * t).cos()
    }));
}

/// The computations of the method can be interrupted and then continue as if they had not been interrupted.
#[test]
fn computations_of_the_method_can_be_interrupted() {
    let bounds = Bounds::unbounded(3);
    let setup = Setup::new(Space::new(&[1.0, 1.0, 1.0], bounds, &[], &[]).unwrap());
    let [mut plain, mut interrupted] = [0, 1].map(|_| LeastSquares::default().begin(&setup).unwrap());
    let (mut batch, mut other, mut answers) = (Batch::new(), Batch::new(), Answers::default());
    let mut n_interrupted = 0;
    for _ in 0..12 {
        plain.ask(&mut batch);
        for most in 0.. {
            let looks = Cell::new(0);
            let ask = || {
                looks.set(looks.get() + 1);
                looks.get() > most
            };
            interrupted.ask_unless(&RunContext::new().polling(&ask), &mut other);
            if !other.is_empty() {
                break;
            }
            n_interrupted += 1;
        }
        assert_eq!(batch, other);
        answers.clear();
        for x in batch.points() {
            let mut residuals = Vec::new();
            large(x, &mut residuals);
            answers.push(Outcome::Value(residuals.iter().map(|r| r * r).sum()), &residuals);
        }
        plain.tell(&answers).unwrap();
        interrupted.tell(&answers).unwrap();
    }
    assert!(n_interrupted >= 8, "{n_interrupted}");
    let n_looks = Cell::new(0);
    let count = || {
        n_looks.set(n_looks.get() + 1);
        false
    };
    assert!(
        plain.linear_model(&RunContext::new().polling(&count)).is_some() && n_looks.get() >= 4,
        "{n_looks:?}"
    );
    assert!(plain.linear_model(&RunContext::new().polling(&|| true)).is_none());
}

/// A run that is interrupted while its method computes ends immediately and can be continued.
#[test]
fn interrupt_between_rounds_ends_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str| {
        let at = Checkpoint::new(folder.path().join(name)).interval(Duration::ZERO);
        let run = minimize(residuals(large)).start(&[1.0; 3]).method(LeastSquares::default());
        run.max_evaluations(12).checkpoint(at)
    };
    let whole = run("whole").run().unwrap();
    let stop = AtomicBool::new(false);
    let stopped = run("stopped").context(RunContext::new().flagged(&stop)).observer(|progress| {
        stop.store(progress.n_evaluations >= 7, Ordering::Relaxed);
        ControlFlow::Continue(())
    });
    let stopped = stopped.run().unwrap();
    assert_eq!((&stopped.termination, stopped.n_evaluations), (&Termination::Interrupted, 7));
    assert!(stopped.jacobian.is_none());
    assert_eq!(reported(&run("stopped").run().unwrap()), reported(&whole));
}

/// Chained Rosenbrock functions as residuals.
fn chained(x: &[f64], out: &mut Vec<f64>) {
    out.extend(x.windows(2).flat_map(|x| [10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]));
}

/// Many parameters do not stop the search: the cost decreases with the first steps.
#[test]
fn least_squares_reduces_cost_with_hundreds_of_parameters() {
    let n = 610;
    let start: Vec<f64> = (0..n).map(|k| if k % 2 == 0 { -1.2 } else { 1.0 }).collect();
    let run = minimize(residuals(chained)).start(&start).method(LeastSquares::default());
    let report = run.max_evaluations(n + 81).run().unwrap();
    assert!(report.fun < 0.02 * report.trace.iter().next().unwrap().outcome.value().unwrap(), "{report}");
}

/// A linear problem ends with the step that solves it, although its points do not determine another model.
#[test]
fn linear_problem_with_hundreds_of_parameters_ends_at_solution() {
    let n = 600;
    let linear = |x: &[f64], out: &mut Vec<f64>| {
        let term = |k: usize, scale: f64, j: usize| scale * (x[k] - 1.0) + 0.3 * (x[j % n] - 1.0);
        out.extend((0..2 * n).map(|i| term(i % n, 1.0 + (i % n) as f64 / n as f64, 7 * (i % n) + i)));
    };
    let start: Vec<f64> = (0..n).map(|k| if k % 2 == 0 { -1.2 } else { 1.0 }).collect();
    let run = minimize(residuals(linear)).start(&start).method(LeastSquares::default());
    let report = run.max_evaluations(n + 30).run().unwrap();
    assert!(report.is_success() && report.fun < 1e-12, "{report}");
}

/// The search continues next to a failing region, from the best point instead of the start.
#[test]
fn least_squares_follows_border_of_failing_region() {
    let wall = |x: &[f64], out: &mut Vec<f64>| {
        out.extend([10.0 * (x[1] - x[0] * x[0]), if x[0] > 0.9 { f64::NAN } else { 1.0 - x[0] }]);
    };
    for start in [[-1.2, 1.0], [0.3, -0.5], [-0.7, 2.0]] {
        let report = minimize(residuals(wall)).start(&start).method(LeastSquares::default()).run().unwrap();
        assert!(report.fun < 0.01001 && report.n_evaluations < 1300, "{start:?} {report}");
        let costs: Vec<f64> = report.trace.iter().filter_map(|e| e.outcome.value()).collect();
        let near = costs.iter().position(|f| *f < 0.02).unwrap();
        assert!(costs[near..].iter().all(|f| *f < 0.5 * costs[0]), "{start:?} {costs:?}");
    }
}

/// Residuals beyond the available memory are rejected as soon as their number is known: after the start
/// alone, not after all n + 1 points.
#[test]
fn residuals_beyond_memory_are_rejected() {
    let setup = Setup::new(Space::new(&vec![1.0; 3000], Bounds::unbounded(3000), &[], &[]).unwrap());
    let mut method = match LeastSquares::default().begin(&setup) {
        Ok(method) => method,
        Err(error) => return assert!(matches!(error, Error::Memory { .. }), "{error}"),
    };
    let (mut batch, mut answers) = (Batch::new(), Answers::default());
    method.ask(&mut batch);
    assert_eq!(batch.len(), 1);
    answers.push(Outcome::Value(1.0), &vec![1e-4; 10_000_000]);
    assert!(matches!(method.tell(&answers), Err(Error::Memory { .. })));
}

/// Sums of squares that decrease towards infinity: no limit of the cost on the way is a minimum.
#[test]
fn minimum_at_infinity_is_not_reported_as_success() {
    let exponential: fn(&[f64], &mut Vec<f64>) = |x, out| out.push((-x[0]).exp());
    let root: fn(&[f64], &mut Vec<f64>) = |x, out| out.push(x[0].powf(-0.4));
    let with_rest: fn(&[f64], &mut Vec<f64>) = |x, out| out.extend([1.0 / x[0], 1.0]);
    let with_another: fn(&[f64], &mut Vec<f64>) = |x, out| out.extend([(-x[0]).exp(), x[1] - 2.0]);
    for (f, x0) in
        [(exponential, vec![0.0]), (root, vec![1.0]), (with_rest, vec![1.0]), (with_another, vec![1.0, 0.5])]
    {
        let report = minimize(residuals(f)).start(&x0).method(LeastSquares::default()).run().unwrap();
        assert!(report.termination == Termination::Unbounded && !report.is_success(), "{report}");
        assert!(report.message.contains("the minimum is at infinity"), "{report}");
        // With a bound, there is a minimum.
        let run = minimize(residuals(f)).start(&x0).bounds(&vec![-1.0; x0.len()], &vec![3.0; x0.len()]);
        let report = run.unwrap().method(LeastSquares::default()).run().unwrap();
        assert!(report.is_success() && report.x[0] == 3.0, "{report}");
    }
}

/// Roots of any multiplicity are minima, however slow the convergence.
#[test]
fn multiple_roots_are_not_reported_as_unbounded() {
    for power in 1..9 {
        let f = |x: &[f64], out: &mut Vec<f64>| out.push((x[0] - 50.0).powi(power));
        let report = minimize(residuals(f)).start(&[1.0]).method(LeastSquares::default()).run().unwrap();
        assert!(report.is_success(), "{power}: {report}");
    }
}

/// If residuals are rounded, the cost is constant around its smallest value, and no test can locate the
/// minimum.
#[test]
fn rounded_residuals_are_not_reported_as_success_when_rounding_dominates() {
    for digits in [10.0, 1e4] {
        let line = |x: &[f64], out: &mut Vec<f64>| {
            out.extend((0..20).map(|k| {
                let (t, off) = (0.1 * f64::from(k), 0.1 * (f64::from(37 * k % 11) / 11.0 - 0.5));
                (digits * (x[0] + x[1] * t - 2.0 - 3.0 * t + 2.0 * off)).round() / digits
            }));
        };
        let report =
            minimize(residuals(line)).start(&[1.0, 5.0]).method(LeastSquares::default()).run().unwrap();
        assert!(report.fun > 0.0 && report.termination == Termination::Noise, "{digits}: {report}");
        assert!(!report.is_success() && report.message.contains("region of equal residuals"), "{report}");
    }
    // If only a few residuals jump within the set, their jumps create a model with a false minimum.
    for k in 0..100 {
        let (slope, start) = (0.3 + 0.017 * f64::from(k), 0.01 * f64::from(k % 7 + 1));
        let at = |x: &[f64], t: f64| (100.0 * (x[0] + x[1] * t)).round() / 100.0;
        let line = |x: &[f64], out: &mut Vec<f64>| {
            out.extend((0..35).map(|j| f64::from(20 * j) / 34.0).map(|t| at(x, t) - at(&[1.0, slope], t)));
        };
        let method = LeastSquares::default().radius(1e-3);
        let run = minimize(residuals(line)).start(&[1.0 + start, slope - 2.0 * start]).method(method);
        let report = run.run().unwrap();
        let off = |t: f64| (report.x[0] - 1.0 + (report.x[1] - slope) * t).abs();
        assert!(!report.is_success() || off(0.0).max(off(20.0)) < 0.01, "{k}: {report}");
    }
}

/// A sine with an amplitude of 1e-4 in one of three residuals. The model always predicts more than ten times
/// the tolerance, and each step gains little.
#[test]
fn fine_noise_does_not_exhaust_the_budget() {
    let fine = |x: &[f64], out: &mut Vec<f64>| {
        out.extend([x[0] - 3.3, x[1] + 1.7, 0.5 + 0.3 * (1e5 * x[0] + 3e5 * x[1]).sin()]);
    };
    for start in [[0.0, 0.0], [1.0, 1.0], [3.0, -2.0]] {
        let report = minimize(residuals(fine)).start(&start).method(LeastSquares::default()).run().unwrap();
        assert!(report.termination == Termination::Noise && report.is_success(), "{report}");
        assert!(report.n_evaluations < 1000 && report.fun < 0.25, "{report}");
    }
}

/// A valley with a condition number of 1e12 of the normal matrix. Rounds reach the minimum of the serial path.
#[test]
fn rounds_reach_the_minimum_when_parameters_are_correlated() {
    let turn = |x: &[f64]| [0.6 * x[0] + 0.8 * x[1], 0.8 * x[0] - 0.6 * x[1]];
    let valley = |x: &[f64], out: &mut Vec<f64>| {
        let [long, short] = turn(&[x[0] - 1.3, x[1] - 0.7]);
        let lines = (0..6).map(|k| long + 1e-6 * short * f64::from(k * k - 9) + 1e-4 * f64::from(k % 2));
        out.extend(lines.map(|a| a + 0.05 * a * a));
    };
    let run = |method| minimize(residuals(valley)).start(&[0.8, 1.2]).method(method).run().unwrap();
    let serial = run(LeastSquares::default().serial());
    for method in
        [LeastSquares::default().rounds(), LeastSquares::default().batch(3), LeastSquares::default().batch(8)]
    {
        let rounds = run(method);
        assert!(rounds.fun <= serial.fun * (1.0 + 1e-6) && rounds.n_evaluations < 300, "{serial}\n{rounds}");
    }
}

/// The plan follows from n and the number of workers. It can be given back, and then any number of workers
/// follows the same path.
#[test]
fn automatic_plan_depends_on_stated_workers_and_can_be_given_back() {
    let folder = tempfile::tempdir().unwrap();
    let run = |workers: usize, method: LeastSquares| {
        let run = minimize(residuals(chained)).start(&[-1.2, 1.0]).workers(workers).method(method);
        run.run().unwrap()
    };
    for (workers, plan) in [(1, "serial"), (2, "serial"), (3, "3"), (5, "5"), (6, "6"), (40, "6")] {
        let report = run(workers, LeastSquares::default());
        assert_eq!(report.batch, plan);
        let given = match plan.parse() {
            Ok(points) => LeastSquares::default().batch(points),
            Err(_) => LeastSquares::default().serial(),
        };
        for other in [1, 2, 8] {
            assert_eq!(reported(&report), reported(&run(other, given.clone())), "{workers} {other}");
        }
        // The checkpoint contains the plan, so a run continues on it with any number of workers.
        let at = || Checkpoint::new(folder.path().join(workers.to_string())).interval(Duration::ZERO);
        let start = |workers: usize| {
            let run = minimize(residuals(chained)).start(&[-1.2, 1.0]).workers(workers);
            run.method(LeastSquares::default()).checkpoint(at())
        };
        start(workers).max_evaluations(10).run().unwrap();
        let resumed = start(9 - workers.min(8)).run().unwrap();
        assert_eq!((reported(&resumed), &*resumed.batch), (reported(&report), plan), "{workers}");
    }
}

/// The residuals of a cubic with the minimum 0 at (1, 3, 2). At the start, the cost does not change by more than
/// rounding within the first resolution.
#[test]
fn tolerance_of_zero_searches_as_far_as_a_small_one() {
    let cubic = |x: &[f64], out: &mut Vec<f64>| {
        let (a, r, h) = (x[0], x[1], x[2]);
        let curved = a * (a + 1.0) * r * h * h;
        out.extend([
            -0.5 * curved + a * r * h - r * (1.0 - (1.0 + h).powf(-a)) + 8.0,
            -curved + a * r * h * (1.0 - (1.0 + h).powf(-a - 1.0)) + 56.0 / 3.0,
            -curved * (1.0 - (1.0 + h).powf(-a - 2.0)) + 208.0 / 9.0,
        ]);
    };
    for x_tol in [0.0, 1e-12] {
        let run = minimize(residuals(cubic)).start(&[1.0, 0.0, 1.0]).x_tol(x_tol).max_evaluations(2000);
        let run = run.bounds(&[f64::NEG_INFINITY, f64::NEG_INFINITY, -0.5], &[f64::INFINITY; 3]).unwrap();
        let report = run.method(LeastSquares::default()).run().unwrap();
        assert!(report.fun < 1e-15, "{x_tol}: {report}");
        assert!(report.x.iter().zip([1.0, 3.0, 2.0]).all(|(x, root)| (x - root).abs() < 1e-4), "{report}");
    }
}

/// A cost that is the logarithm of the sum of squares.
struct LogarithmOfSquares<F>(F);

impl<F: Fn(&[f64], &mut Vec<f64>) + Sync> Objective for LogarithmOfSquares<F> {
    fn evaluate(&self, x: &[f64], _: &Query<'_>, answer: &mut Answer) {
        (self.0)(x, &mut answer.residuals);
        answer.outcome = Outcome::Value(answer.residuals.iter().fold(0.0, |sum, r| sum + r * r).ln());
    }

    fn has_residuals(&self) -> bool {
        true
    }
}

/// The search minimises the sum of squares, also in the simplex search next to a failing region. The run reports
/// the cost.
#[test]
fn increasing_function_of_the_sum_of_squares_has_the_same_path() {
    let smooth: fn(&[f64], &mut Vec<f64>) = |x, out| {
        out.extend([10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0], 0.1]);
    };
    let wall: fn(&[f64], &mut Vec<f64>) = |x, out| {
        out.extend([10.0 * (x[1] - x[0] * x[0]), if x[0] > 0.9 { f64::NAN } else { 1.0 - x[0] }, 0.1]);
    };
    for (f, batch) in [(smooth, 1), (smooth, 6), (wall, 1)] {
        let method = || LeastSquares::default().batch(batch);
        let squares = minimize(residuals(f)).start(&[-1.2, 1.0]).method(method()).run().unwrap();
        let report = minimize(LogarithmOfSquares(f)).start(&[-1.2, 1.0]).method(method()).run().unwrap();
        assert_eq!((&report.x, report.n_evaluations), (&squares.x, squares.n_evaluations));
        assert_eq!((report.fun, &report.termination), (squares.fun.ln(), &squares.termination));
        let tests = [&report, &squares].map(|report| report.tests.unwrap());
        assert_eq!((tests[0].f_best, tests[0].f_spread), (tests[1].f_best, tests[1].f_spread));
        assert!(tests[0].is_of_squares && !tests[1].is_of_squares);
        assert!(report.message.contains("of the sum of squares"), "{report}");
        // A target is a value of the cost.
        let run = minimize(LogarithmOfSquares(f)).start(&[-1.2, 1.0]).method(method()).target(-2.0).run();
        let report = run.unwrap();
        assert!(report.termination == Termination::Target && report.fun <= -2.0, "{report}");
    }
}
