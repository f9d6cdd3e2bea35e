//! Point, cost, counts and iterations are the same for any number of workers and every stop except time
//! limits. Points evaluated speculatively have no effect until the path reaches them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{methods_for_costs, probe_fails, quiet_panics_on_purpose, rosenbrock};
use dfo::{
    AnyMethod, BatchView, Error, Lookahead, Minimize, NelderMead, Objective, Outcome, PatternSearch, Query,
    Report, Termination, minimize, minimize_batches, with_query,
};

const PLANS: [Lookahead; 6] = [
    Lookahead::Measured,
    Lookahead::None,
    Lookahead::Points(2),
    Lookahead::Points(4),
    Lookahead::Points(20),
    Lookahead::Workers,
];

/// Cost that fails in some regions, aborts in others and panics in others, depending on `how`, and that uses
/// its cutoff.
fn cost(how: u64) -> impl Fn(&[f64], &Query<'_>) -> Outcome + Sync {
    move |x, e| {
        let cell = (x[0] * 37.0).floor() + 3.0 * (x[1] * 41.0).floor();
        let value = rosenbrock(x);
        match how {
            1 if probe_fails(x) => Outcome::Value(f64::NAN),
            2 if cell.rem_euclid(11.0) == 0.0 => Outcome::failed("no"),
            3 if cell.rem_euclid(29.0) == 0.0 => Outcome::Abort(format!("at {x:?}")),
            4 if cell.rem_euclid(13.0) == 0.0 => panic!("on purpose"),
            _ if how.is_multiple_of(2) && value > e.cutoff => Outcome::Above(e.cutoff),
            _ => Outcome::Value(value),
        }
    }
}

type Summary = Result<(Vec<u64>, u64, usize, usize, usize, Termination, Vec<Vec<u64>>), String>;

fn reported(run: Result<Report, Error>) -> Summary {
    let bits = |x: &[f64]| x.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    match run {
        Ok(r) => {
            let path = r.trace.iter().map(|e| bits(e.x)).collect();
            assert_eq!(r.trace.len(), r.n_evaluations);
            assert_eq!(r.trace.speculative().len(), r.n_speculative);
            let counts = (r.n_evaluations, r.n_iterations, r.n_failed);
            Ok((bits(&r.x), r.fun.to_bits(), counts.0, counts.1, counts.2, r.termination, path))
        }
        Err(e) => Err(e.to_string()),
    }
}

fn described<'a>(run: Minimize<'a, NelderMead>, method: &AnyMethod, dice: u64) -> Minimize<'a, AnyMethod> {
    let run = run.start(&[-0.5, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap().method(method.clone()).seed(3);
    let budget = 1 + (dice / 7 % 150) as usize;
    match dice % 4 {
        0 => run.max_iterations(budget / 2).max_evaluations(400),
        1 => run.target(0.5).max_evaluations(budget),
        _ => run.max_evaluations(budget),
    }
}

#[test]
fn result_is_independent_of_number_of_workers() {
    quiet_panics_on_purpose();
    let mut methods: Vec<AnyMethod> = methods_for_costs();
    methods.extend(PLANS.map(|plan| NelderMead::default().batch(plan).into()));
    methods.push(dfo::Barrier::default().batch(Lookahead::Workers).into());
    methods.push(PatternSearch::default().batch(Lookahead::Points(6)).into());
    methods.push(PatternSearch::default().batch(Lookahead::Workers).into());
    let mut dice = 1u64;
    for round in 0..20 {
        for method in &methods {
            dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (dice, how) = (dice >> 33, round % 5);
            let objective = with_query(cost(how));
            let pinned = match method {
                AnyMethod::NelderMead(_) => NelderMead::default().batch(Lookahead::None).into(),
                AnyMethod::Barrier(_) => dfo::Barrier::default().batch(Lookahead::None).into(),
                AnyMethod::PatternSearch(_) => PatternSearch::default().batch(Lookahead::None).into(),
                other => other.clone(),
            };
            let serial = reported(described(minimize(dfo::ByRef(&objective)), &pinned, dice).run());
            for workers in [1, 2, 3, 7, 16] {
                let run = described(minimize(dfo::ByRef(&objective)), method, dice).workers(workers);
                assert_eq!(reported(run.run()), serial, "{method:?}, {workers} workers, {how} {dice}");
            }
            let in_batches = |batch: &BatchView<'_>| {
                let one = |k| objective.answer(batch.point(k), &batch.query(k)).outcome;
                (0..batch.len()).map(one).collect()
            };
            let run = described(minimize_batches(in_batches), method, dice).workers(7);
            assert_eq!(reported(run.run()), serial, "{method:?} in batches, {how} {dice}");
        }
    }
}

/// An abort at a point that is only evaluated speculatively does not end the run.
#[test]
fn abort_counts_only_when_path_reaches_it() {
    let path = minimize(rosenbrock).start(&[-1.2, 1.0]).max_evaluations(60).run().unwrap();
    let on_path = |x: &[f64]| path.trace.iter().any(|e| e.x == x);
    let trap = with_query(|x: &[f64], _: &Query<'_>| match on_path(x) {
        true => Outcome::Value(rosenbrock(x)),
        false => Outcome::Abort("off the path".to_owned()),
    });
    for plan in PLANS {
        let run = minimize(dfo::ByRef(&trap)).start(&[-1.2, 1.0]).method(NelderMead::default().batch(plan));
        let report = run.workers(4).max_evaluations(60).run().unwrap();
        assert_eq!((&report.x, report.fun, report.n_evaluations), (&path.x, path.fun, 60), "{plan:?}");
        assert_eq!(report.termination, Termination::MaxEvaluations);
    }
}

#[test]
fn more_workers_need_fewer_rounds() {
    let rounds = |n: usize, workers: usize| {
        let method = NelderMead::default().batch(Lookahead::Workers);
        let costs =
            |b: &BatchView<'_>| (0..b.len()).map(|k| Outcome::Value(rosenbrock(b.point(k)))).collect();
        let run = minimize_batches(costs).start(&vec![-1.2; n]).method(method).workers(workers);
        let report = run.max_iterations(60).run().unwrap();
        report.n_batches
    };
    for n in [2, 4, 8] {
        let all: Vec<usize> = [1, 2, 3, 4, 6, 8, 12, 20].iter().map(|w| rounds(n, *w)).collect();
        println!("{n} parameters, rounds with 1, 2, 3, 4, 6, 8, 12, 20 workers: {all:?}");
        assert!(all[1] * 5 < all[0] * 4, "{all:?}");
        // The number of unneeded evaluations is limited, so more than eight workers change little.
        assert!(all[3] * 5 < all[0] * 3 && all[5] < all[3] && 10 * all[7] <= 11 * all[5], "{all:?}");
    }
}

/// A point of an earlier run on a bound is not a valid start for a barrier.
#[test]
fn barrier_accepts_warm_start_with_point_on_bound() {
    let slope = |x: &[f64]| x[0] + (x[1] - 0.5).powi(2);
    let run = |method: AnyMethod| {
        let run = minimize(slope).start(&[0.7, 0.2]).bounds(&[0.0; 2], &[1.0; 2]).unwrap();
        run.method(method).problem("slope")
    };
    let first = run(NelderMead::default().bounds_handling(dfo::BoundsHandling::Clamp).into()).run().unwrap();
    assert_eq!(first.x[0], 0.0);
    let warm = run(dfo::Barrier::default().into()).warm_start(&first.trace).run().unwrap();
    assert!(warm.fun < 1e-4, "{warm}");
}

#[test]
fn sizes_beyond_memory_are_errors() {
    let n = 3_000_000;
    let run = minimize(|x: &[f64]| x[0]).start(&vec![0.5; n]).run();
    assert!(matches!(run, Err(Error::Memory { .. })), "{:?}", run.map(|r| r.fun));
    let wide = minimize(|x: &[f64]| x[0]).bounds(&vec![0.0; n], &vec![1.0; n]).unwrap();
    let run = wide.method(dfo::DifferentialEvolution::classic().population(1_000_000)).run();
    assert!(matches!(run, Err(Error::Memory { .. })), "{:?}", run.map(|r| r.fun));
}

#[test]
fn methods_that_plan_with_budget_run_without_limit() {
    let rastrigin = |x: &[f64]| -> f64 {
        x.iter().map(|x| x * x + 10.0 - 10.0 * (std::f64::consts::TAU * x).cos()).sum()
    };
    let run = minimize(rastrigin).bounds(&[-5.0; 5], &[4.0; 5]).unwrap();
    let run = run.method("de".parse::<AnyMethod>().unwrap()).seed(1).unlimited().max_iterations(300);
    let report = run.x_tol(0.0).f_tol(0.0).run().unwrap();
    assert!(report.final_population.unwrap().costs.len() < 45 && report.fun < 1e-2, "{}", report.fun);
}

#[test]
fn batch_function_fails_only_at_the_point_where_it_panics() {
    quiet_panics_on_purpose();
    let batches = |batch: &BatchView<'_>| {
        let one = |k: usize| {
            assert!(batch.point(k)[0] <= 0.5, "on purpose");
            Outcome::Value(batch.point(k).iter().map(|x| x * x).sum())
        };
        (0..batch.len()).map(one).collect()
    };
    let run = minimize_batches(batches).bounds(&[-1.0; 2], &[1.0; 2]).unwrap();
    let report = run.method("de".parse::<AnyMethod>().unwrap()).seed(1).max_evaluations(200).run().unwrap();
    assert!(report.n_failed > 0 && report.n_failed < 60 && report.fun < 0.1, "{report}");
}
