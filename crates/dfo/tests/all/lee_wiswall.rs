//! The one plan of Nelder-Mead that takes another path: reproducible, fewer rounds, down to one vertex in the end.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{cutting, plan, rosenbrock, timeless};
use dfo::{
    Answers, Batch, BatchPlan, Bounds, Method, MethodOptions, Minimize, NelderMead, Outcome, Report, Setup,
    Space, Status, minimize,
};

/// A bowl of ten parameters.
fn bowl(x: &[f64]) -> f64 {
    x.iter().enumerate().map(|(i, x)| (1 + i) as f64 * (x - 1.0).powi(2)).sum()
}

fn gappy(x: &[f64]) -> f64 {
    if x.iter().sum::<f64>() < 0.4 && x[0] > 0.05 { f64::NAN } else { bowl(x) }
}

fn run(m: Minimize<'_, NelderMead>, p: BatchPlan) -> Report {
    m.start(&[0.0; 10]).bounds(&[-1.0; 10], &[3.0; 10]).unwrap().method(plan(p)).run().unwrap()
}

#[test]
fn it_converges_and_says_what_it_was() {
    for cost in [bowl as fn(&[f64]) -> f64, gappy] {
        let report = run(minimize(cost), BatchPlan::LeeWiswall);
        println!("{report}");
        assert!(report.is_success() && report.fun < 0.02, "{report}");
        assert!(report.batch.starts_with("lee-wiswall"), "{report}");
        assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
    }
    let serial = minimize(rosenbrock).start(&[-1.2; 3]).method(plan(BatchPlan::LeeWiswall)).run().unwrap();
    assert_eq!(serial.batch, "lee-wiswall, then serial");
}

#[test]
fn early_it_needs_fewer_rounds() {
    let rounds = |p| run(minimize(bowl).target(0.1 * bowl(&[0.0; 10])), p).n_batches;
    let (serial, parallel) = (rounds(BatchPlan::Serial), rounds(BatchPlan::LeeWiswall));
    println!("{serial} rounds alone, {parallel} with n/2 vertices at once");
    assert!(2 * parallel < serial, "{serial} {parallel}");
}

#[test]
fn workers_cutoffs_and_copies_change_nothing() {
    for cost in [bowl as fn(&[f64]) -> f64, gappy] {
        let one = run(minimize(cost), BatchPlan::LeeWiswall);
        for workers in [2, 7] {
            let many = run(minimize(cost).workers(workers), BatchPlan::LeeWiswall);
            assert_eq!(timeless(&many.trace), timeless(&one.trace));
        }
        let cut = run(minimize(cutting(cost)), BatchPlan::LeeWiswall);
        assert_eq!(
            (&cut.x, cut.fun, cut.n_iterations, &cut.final_simplex),
            (&one.x, one.fun, one.n_iterations, &one.final_simplex)
        );
    }
}

#[test]
fn saved_states_and_answers_in_pieces_keep_the_path() {
    let bounds = || Bounds::new(&[-1.0; 10], &[3.0; 10]).unwrap();
    let setup = Setup::new(Space::new(&[0.0; 10], bounds(), &[], &[]).unwrap());
    let options = plan(BatchPlan::LeeWiswall);
    let mut search = options.begin(&setup).unwrap();
    let (mut batch, mut counter) = (Batch::new(), 0u32);
    loop {
        search.ask(&mut batch);
        if batch.is_empty() {
            break;
        }
        // Now and then the state goes through bytes in the middle of a round.
        if counter.is_multiple_of(5) {
            search = options.restore(&setup, &search.save().unwrap()).unwrap();
            let mut again = Batch::new();
            search.ask(&mut again);
            assert_eq!(batch, again);
        }
        let outcomes: Vec<_> = batch
            .points()
            .map(|x| {
                counter = counter.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if counter >> 30 == 0 { Outcome::Skipped } else { Outcome::Value(bowl(x)) }
            })
            .collect();
        search.tell(&Answers::from(&outcomes[..])).unwrap();
    }
    let whole = run(minimize(bowl), BatchPlan::LeeWiswall);
    assert_eq!(search.best(), Some((&whole.x[..], whole.fun)));
    assert_eq!(
        (search.details().n_iterations, search.status()),
        (whole.n_iterations, Status::Ended(whole.termination))
    );
}

#[test]
fn budgets_are_exact() {
    for budget in 1..=200 {
        let report = run(minimize(gappy).max_evaluations(budget), BatchPlan::LeeWiswall);
        assert_eq!(report.n_evaluations, budget);
        assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
        let iterations = run(minimize(bowl).max_iterations(budget), BatchPlan::LeeWiswall);
        assert!(iterations.n_iterations == budget || iterations.is_success());
    }
}
