//! Sequential barrier method: interior points, bounds and early ends.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{cutting, probe, rosenbrock, timeless};
use dfo::{Barrier, Error, Lookahead, Minimize, NelderMead, Report, minimize};

fn run(m: Minimize<'_, NelderMead>, plan: Lookahead) -> Report {
    m.start(&[-1.2, 1.0])
        .bounds(&[-2.0, -2.0], &[0.5, f64::INFINITY])
        .unwrap()
        .method(Barrier::default().batch(plan))
        .run()
        .unwrap()
}

#[test]
fn barrier_approaches_active_bounds_from_inside() {
    let report = run(minimize(rosenbrock), Lookahead::None);
    println!("{report}");
    for stage in &report.schedule {
        println!(
            "mu {:.1e}, B {:.3e}, {:?}, {:.6e}, {}",
            stage.mu, stage.barrier, stage.x, stage.value, stage.n_evaluations
        );
    }
    assert!((report.fun - 0.25).abs() < 1e-4 && report.is_success(), "{report}");
    assert!(report.trace.iter().all(|e| e.x[0] < 0.5 && e.x[0] > -2.0 && e.x[1] > -2.0));
    assert!(report.schedule.len() > 3 && report.schedule.windows(2).all(|w| w[1].mu < 0.2 * w[0].mu));
    let total: usize = report.schedule.iter().map(|s| s.n_evaluations).sum();
    assert_eq!(total, report.n_evaluations);
    // An interior minimum is also found.
    let inside = minimize(rosenbrock).start(&[-1.2, 1.0]).bounds(&[-2.0; 2], &[2.0; 2]).unwrap();
    let inside = inside.method(Barrier::default()).run().unwrap();
    assert!(inside.fun < 1e-8 && inside.is_success(), "{inside}");
}

#[test]
fn result_is_independent_of_plans_workers_and_cutoffs() {
    for cost in [rosenbrock as fn(&[f64]) -> f64, probe] {
        let one = run(minimize(cost), Lookahead::None);
        for plan in [Lookahead::Points(2), Lookahead::Points(4)] {
            let other = run(minimize(cost), plan);
            assert_eq!((&other.x, other.fun, other.n_iterations), (&one.x, one.fun, one.n_iterations));
            let many = run(minimize(cost).workers(4), plan);
            assert_eq!(timeless(&many.trace), timeless(&other.trace));
            let cut = run(minimize(cutting(cost)), plan);
            assert_eq!((&cut.x, cut.fun, cut.n_iterations), (&one.x, one.fun, one.n_iterations));
            let stages = |r: &Report| {
                r.schedule.iter().map(|s| (s.mu, s.barrier, s.x.clone(), s.value)).collect::<Vec<_>>()
            };
            assert_eq!(stages(&cut), stages(&one));
        }
    }
}

#[test]
fn barrier_keeps_invariants_on_probe_problem() {
    let report = minimize(probe)
        .start(&[-0.5, 1.0])
        .bounds(&[-2.0; 2], &[2.0; 2])
        .unwrap()
        .method(Barrier::default())
        .max_evaluations(2000)
        .run()
        .unwrap();
    println!("{report}");
    assert!(report.fun.is_finite() && report.fun <= rosenbrock(&[-0.5, 1.0]) && report.n_failed > 0);
    assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
}

#[test]
fn barrier_rejects_starts_on_bounds() {
    let run = |x0: f64, lower: f64, options| {
        minimize(rosenbrock)
            .start(&[x0, 0.0])
            .bounds(&[lower, -1.0], &[1.0, 1.0])
            .unwrap()
            .method(options)
            .run()
    };
    for x0 in [-1.0, 1.0] {
        let refused = run(x0, -1.0, Barrier::default());
        assert!(matches!(refused, Err(Error::StartNotInterior { index: 0, .. })), "{refused:?}");
    }
    for bad in
        [Barrier::default().mu(0.0), Barrier::default().factor(1.0), Barrier::default().factor(f64::NAN)]
    {
        assert!(matches!(run(0.0, -1.0, bad), Err(Error::Option { .. })));
    }
    let unbounded = minimize(rosenbrock).start(&[0.0, 0.0]).method(Barrier::default()).run();
    assert!(matches!(unbounded, Err(Error::NoBounds { .. })));
    // A fixed parameter has no interior and does not need one.
    assert!(run(1.0, 1.0, Barrier::default()).unwrap().is_success());
    let budget = minimize(rosenbrock).start(&[0.0; 2]).bounds(&[-1.0; 2], &[1.0; 2]).unwrap();
    assert_eq!(
        budget.method(Barrier::default().mu(0.3)).max_evaluations(17).run().unwrap().n_evaluations,
        17
    );
}
