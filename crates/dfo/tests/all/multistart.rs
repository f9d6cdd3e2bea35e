//! Multistart: minima found and counted with costs and residuals, path, budget and checkpoints.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{probe, timeless};
use dfo::{
    AnyMethod, Checkpoint, Error, Multistart, Outcome, Polish, Query, Report, Sampling, Termination,
    Transform, fallible, minimize, minimize_batches, residuals, with_query,
};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Himmelblau (1972): four minima of cost 0 in [-5, 5]^2.
const HIMMELBLAU: [[f64; 2]; 4] =
    [[3.0, 2.0], [-2.805_118, 3.131_312], [-3.779_310, -3.283_186], [3.584_428, -1.848_126]];

fn himmelblau(x: &[f64], out: &mut Vec<f64>) {
    out.extend([x[0] * x[0] + x[1] - 11.0, x[0] + x[1] * x[1] - 7.0]);
}

fn cost(x: &[f64]) -> f64 {
    (x[0] * x[0] + x[1] - 11.0).powi(2) + (x[0] + x[1] * x[1] - 7.0).powi(2)
}

fn rastrigin(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x - 10.0 * (std::f64::consts::TAU * x).cos() + 10.0).sum()
}

/// Counts the minima found, out of four.
fn found(report: &Report) -> usize {
    let near = |m: &[f64; 2], x: &[f64]| (m[0] - x[0]).abs() < 1e-3 && (m[1] - x[1]).abs() < 1e-3;
    HIMMELBLAU.iter().filter(|m| report.optima.iter().any(|o| near(m, &o.x) && o.cost < 1e-6)).count()
}

#[test]
fn multistart_finds_all_minima_and_counts_each_once() {
    let (mut by_cost, mut by_residuals, mut evaluations) = (0, 0, 0);
    for seed in 0..20 {
        let report = minimize(cost).bounds(&[-5.0; 2], &[5.0; 2]).unwrap();
        let report = report.method(Multistart::default().exploration(0.0)).seed(seed).run().unwrap();
        assert!(report.is_success() && report.optima[0].cost == report.fun, "{report}");
        assert!(report.optima.windows(2).all(|w| w[0].cost <= w[1].cost));
        by_cost += found(&report);
        let report = minimize(residuals(himmelblau)).bounds(&[-5.0; 2], &[5.0; 2]).unwrap();
        let report =
            report.method(Multistart::default().polish(Polish::LeastSquares)).seed(seed).run().unwrap();
        assert!(report.is_success() && report.optima.iter().all(|o| o.n_starts > 0), "{report}");
        by_residuals += found(&report);
        evaluations += report.n_evaluations;
    }
    println!(
        "minima of 80: {by_cost} by cost, {by_residuals} by residuals, {evaluations} evaluations in 20 runs"
    );
    assert!(by_cost >= 76 && by_residuals >= 76);
}

/// Local searches end at residuals of exactly zero before their radius passes the x test.
#[test]
fn multistart_succeeds_at_zero_cost() {
    for start in [1.5, 3.0, 4.5] {
        let line = |x: &[f64], out: &mut Vec<f64>| out.push(1.0 - x[0]);
        let run = minimize(residuals(line)).start(&[start]).bounds(&[0.0], &[5.0]).unwrap();
        let report = run.method(Multistart::default().polish(Polish::LeastSquares)).seed(5).run().unwrap();
        assert!(report.termination == Termination::Converged && report.fun == 0.0, "{report}");
    }
}

/// The given start is searched from first, so multistart solves every problem that a local search solves.
#[test]
fn multistart_searches_from_given_start_first() {
    let run = minimize(cost).start(&[3.5, -1.8]).bounds(&[-5.0; 2], &[5.0; 2]).unwrap();
    let report = run.method(Multistart::default().exploration(0.0).max_starts(1)).seed(1).run().unwrap();
    assert_eq!((report.trace.get(0).unwrap().x, report.optima.len()), (&[3.5, -1.8][..], 1));
    assert!((report.x[0] - HIMMELBLAU[3][0]).abs() < 1e-3, "{report}");
}

#[test]
fn exploration_finds_lowest_of_many_minima() {
    let solved = (0..20).filter(|&seed| {
        let run = minimize(rastrigin).bounds(&[-5.12, -5.12, -5.12], &[4.9; 3]).unwrap();
        let method = Multistart::default();
        let report = run.method(method).seed(seed).max_evaluations(6000).run().unwrap();
        report.fun < 1e-8
    });
    let solved = solved.count();
    assert!(solved >= 18, "{solved} of 20");
}

fn variants() -> [Multistart; 5] {
    let default = Multistart::default;
    [
        default(),
        default().exploration(0.0),
        default().exploration(0.4).side_by_side(3).polish(Polish::CmaEs),
        default().exploration(0.0).side_by_side(1).sample(7),
        default().exploration(0.0).sampling(Sampling::LatinHypercube).side_by_side(9),
    ]
}

/// Ends, counts and paths are the same for any number of workers, and for a run stopped after any evaluation.
#[test]
fn result_is_independent_of_workers_and_interruptions() {
    let folder = tempfile::tempdir().unwrap();
    for (number, method) in variants().into_iter().enumerate() {
        let run = |f: &(dyn Fn(&[f64]) -> Outcome + Sync), workers: usize, path: Option<&std::path::Path>| {
            let run = minimize(with_query(|x: &[f64], _: &Query<'_>| f(x)));
            let run = run.start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap().method(method.clone());
            let run = run.seed(5).workers(workers).max_evaluations(180);
            match path {
                Some(path) => run.checkpoint(Checkpoint::new(path).interval(Duration::ZERO)).run(),
                None => run.run(),
            }
        };
        let whole = run(&|x| Outcome::Value(probe(x)), 1, None).unwrap();
        let parallel = run(&|x| Outcome::Value(probe(x)), 3, None).unwrap();
        assert_eq!(timeless(&whole.trace), timeless(&parallel.trace), "{method:?}");
        assert_eq!((&whole.optima, &whole.message), (&parallel.optima, &parallel.message));
        for stop in (1..180).step_by(7) {
            let path = folder.path().join(format!("{number}-{stop}"));
            let calls = AtomicUsize::new(0);
            let stopping = |x: &[f64]| match calls.fetch_add(1, Ordering::Relaxed) {
                k if k >= stop => Outcome::Abort("stopped".to_owned()),
                _ => Outcome::Value(probe(x)),
            };
            let _ = run(&stopping, 1, Some(&path));
            let resumed = run(&|x| Outcome::Value(probe(x)), 1, Some(&path)).unwrap();
            assert_eq!(timeless(&whole.trace), timeless(&resumed.trace), "{method:?} {stop}");
            assert_eq!((&whole.optima, &whole.message), (&resumed.optima, &resumed.message));
        }
    }
}

#[test]
fn failed_points_start_no_search() {
    let nothing = fallible(|_: &[f64]| Err::<f64, _>("no"));
    let run = minimize(nothing).bounds(&[0.0; 2], &[1.0; 2]).unwrap().method(Multistart::default());
    assert!(matches!(run.run(), Err(Error::AllStartsFailed(_))));
    let half = |x: &[f64]| if x[0] > 0.5 { f64::NAN } else { (x[0] - 0.4).powi(2) + x[1].powi(2) };
    let report = minimize(half).bounds(&[0.0; 2], &[1.0; 2]).unwrap().method(Multistart::default());
    let report = report.seed(2).run().unwrap();
    assert!(report.is_success() && report.fun < 1e-8 && report.n_failed > 0, "{report}");
    // One parameter, no free parameter, and a logarithmic parameter over twelve powers of ten.
    let one = minimize(|x: &[f64]| (x[0] - 0.3).abs()).bounds(&[0.0], &[1.0]).unwrap();
    assert!(one.method(Multistart::default()).seed(2).run().unwrap().fun < 1e-5);
    let fixed = minimize(|x: &[f64]| x[0]).bounds(&[2.0], &[2.0]).unwrap().method(Multistart::default());
    let fixed = fixed.run().unwrap();
    assert_eq!((fixed.termination, fixed.n_evaluations), (Termination::AllFixed, 1));
    let wide = minimize(|x: &[f64]| (x[0] / 3e-4).ln().powi(2)).bounds(&[1e-6], &[1e6]).unwrap();
    let wide = wide.transforms(&[Transform::Log]).method(Multistart::default()).seed(2).run().unwrap();
    assert!((wide.x[0] / 3e-4 - 1.0).abs() < 1e-3, "{wide}");
}

#[test]
fn bad_options_are_rejected() {
    let run = |method: Multistart| {
        minimize(cost).start(&[0.0; 2]).bounds(&[-5.0; 2], &[5.0; 2]).unwrap().method(method).run()
    };
    let default = Multistart::default;
    for method in [
        default().sample(0),
        default().sample(10_000_000),
        default().side_by_side(0),
        default().max_starts(0),
        default().exploration(1.0),
        default().exploration(f64::NAN),
    ] {
        assert!(matches!(run(method.clone()), Err(Error::Option { .. })), "{method:?}");
    }
    let open = minimize(cost).start(&[0.0; 2]).method(AnyMethod::from(default())).run();
    assert!(matches!(open, Err(Error::NeedsBox { index: 0, .. })));
    let costs = minimize(cost).bounds(&[-5.0; 2], &[5.0; 2]).unwrap();
    let without = costs.method(default().polish(Polish::LeastSquares)).run();
    assert!(matches!(without, Err(Error::NeedsResiduals { .. })));
}

/// Until the first search has ended, all other points use at most half of the budget.
#[test]
fn first_search_gets_half_of_the_budget() {
    let start = [-1.2, 1.0, -1.2, 1.0];
    let chain = |x: &[f64]| -> f64 {
        x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
    };
    let run = |method: Multistart, budget: usize| {
        let run = minimize(chain).start(&start).bounds(&[-5.0; 4], &[5.0; 4]).unwrap();
        run.method(method.polish(Polish::NelderMead).exploration(0.0))
            .seed(1)
            .max_evaluations(budget)
            .run()
            .unwrap()
    };
    let alone = run(Multistart::default().max_starts(1), 10_000);
    let sample = 40;
    let first = alone.n_evaluations - sample;
    // Enough points for the first search, and the same number for the rest.
    let report = run(Multistart::default(), 2 * first + 2);
    assert_eq!(report.optima.iter().map(|optimum| optimum.n_starts).sum::<usize>(), 1, "{report}");
    assert!(report.fun <= alone.fun, "{report}");
}

/// With equal evaluation times, batches of more than one point keep two workers busy for 93 % of the time.
/// The rest of the time, and next to a search that runs alone, workers evaluate points that a search may need
/// next.
#[test]
fn multistart_keeps_two_workers_busy() {
    for (n, f) in [(2, cost as fn(&[f64]) -> f64), (3, rastrigin), (5, rastrigin), (8, rastrigin)] {
        let (mut rounds, mut points) = (0, 0);
        let count = |batch: &dfo::BatchView<'_>| {
            if batch.len() > 1 {
                rounds += batch.len().div_ceil(2);
                points += batch.len();
            }
            (0..batch.len()).map(|k| Outcome::Value(f(batch.point(k)))).collect()
        };
        let run = minimize_batches(count).bounds(&vec![-5.12; n], &vec![4.9; n]).unwrap();
        run.method(Multistart::default()).seed(1).max_evaluations(1000 * (n + 1)).run().unwrap();
        let busy = 0.5 * points as f64 / rounds as f64;
        println!("n = {n}: {points} points together, two workers busy for {:.1} %", 100.0 * busy);
        assert!(busy >= 0.93, "n = {n}: {busy}");
    }
    let run = || minimize(cost).bounds(&[-5.0; 2], &[5.0; 2]).unwrap().method(Multistart::default()).seed(1);
    let slow = |x: &[f64]| {
        std::thread::sleep(Duration::from_millis(1));
        cost(x)
    };
    let beside = minimize(slow).bounds(&[-5.0; 2], &[5.0; 2]).unwrap().method(Multistart::default()).seed(1);
    let (alone, beside) = (run().run().unwrap(), beside.workers(2).run().unwrap());
    assert!(timeless(&alone.trace) == timeless(&beside.trace), "{beside}");
}

/// Valleys within a bowl: the points around the best one form one cluster but lead to many minima.
#[test]
fn cluster_with_several_minima_is_searched_repeatedly() {
    let bowl = |x: &[f64], out: &mut Vec<f64>| {
        let r = |x: f64, at: f64| [x - at, 2.0 * (9.0 * (x - at)).sin()];
        out.extend(r(x[0], 0.37));
        out.extend(r(x[1], -0.81));
    };
    let run = |seed: u64| {
        let method = Multistart::default().polish(Polish::LeastSquares);
        minimize(residuals(bowl))
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(method)
            .seed(seed)
            .run()
            .unwrap()
    };
    // Success is claimed only for the lowest minimum.
    let reports: Vec<Report> = (0..20).map(run).collect();
    let wrong = reports.iter().filter(|r| r.is_success() && r.fun > 1e-6).count();
    let right = reports.iter().filter(|r| r.fun <= 1e-6).count();
    assert!(wrong == 0 && right >= 15, "{right} found, {wrong} wrong");
}

/// Steps of the local searches from their starts. With one seed, the steps would be the same for all
/// searches.
#[test]
fn local_searches_use_separate_random_numbers() {
    let cost = |x: &[f64]| x.iter().map(|x| (x * x - 1.0).powi(2) + 0.1 * x).sum::<f64>();
    let method = Multistart::default().polish(Polish::CmaEs).exploration(0.0).side_by_side(4);
    let run = minimize(cost).bounds(&[-2.0; 6], &[2.0; 6]).unwrap().method(method).seed(1);
    let report = run.max_evaluations(140).run().unwrap();
    let points: Vec<&[f64]> = report.trace.iter().skip(60).map(|entry| entry.x).collect();
    let steps: Vec<Vec<f64>> =
        points.windows(2).map(|pair| pair[0].iter().zip(pair[1]).map(|(a, b)| b - a).collect()).collect();
    let is_same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    let n_same: usize = (0..steps.len())
        .map(|k| steps[k + 1..].iter().filter(|other| is_same(&steps[k], other)).count())
        .sum();
    assert_eq!(n_same, 0);
}
