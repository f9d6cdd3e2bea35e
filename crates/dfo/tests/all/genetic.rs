//! Genetic algorithm: solved problems and reproducibility.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common;

use common::{probe, rosenbrock, timeless};
use dfo::{Error, Genetic, ParameterKind, Report, Selection, Termination, minimize};

fn run(options: &Genetic, seed: u64, workers: usize) -> Report {
    minimize(probe)
        .start(&[-0.5, 1.0])
        .bounds(&[-2.0; 2], &[2.0; 2])
        .unwrap()
        .method(options.clone())
        .seed(seed)
        .workers(workers)
        .max_evaluations(2000)
        .run()
        .unwrap()
}

#[test]
fn genetic_survives_failing_regions() {
    for options in [
        Genetic::default(),
        Genetic::default().selection(Selection::Tournament(2)),
        Genetic::default().gray(false).elite(0),
        Genetic::default().population(21).elite(4).crossover_rate(1.0),
    ] {
        for seed in 0..5 {
            let report = run(&options, seed, 1);
            // The result is never worse than the start, and it is the best point seen.
            assert!(report.fun <= rosenbrock(&[-0.5, 1.0]) && report.n_failed > 0, "{report}");
            assert_eq!(report.trace.best(), Some((&report.x[..], report.fun)));
            assert_eq!(report.trace.get(0).unwrap().x, [-0.5, 1.0]);
        }
    }
}

#[test]
fn genetic_solves_smooth_bowl_with_defaults() {
    let mut solved = 0;
    for seed in 0..10 {
        let report = minimize(|x: &[f64]| (x[0] - 0.3).powi(2) + 2.0 * (x[1] - 1.1).powi(2))
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(Genetic::default())
            .seed(seed)
            .max_evaluations(4000)
            .run()
            .unwrap();
        println!("{seed}: {:.2e} in {}", report.fun, report.n_evaluations);
        solved += usize::from(report.fun < 1e-4);
    }
    assert!(solved >= 9, "{solved} of 10");
}

#[test]
fn result_is_independent_of_number_of_workers() {
    let one = run(&Genetic::default(), 3, 1);
    for workers in [2, 7] {
        let many = run(&Genetic::default(), 3, workers);
        assert_eq!(timeless(&many.trace), timeless(&one.trace));
        assert_eq!((many.x, many.fun, many.message), (one.x.clone(), one.fun, one.message.clone()));
    }
    assert_ne!(timeless(&run(&Genetic::default(), 4, 1).trace), timeless(&one.trace));
}

#[test]
fn genetic_searches_integer_and_categorical_parameters() {
    let cost =
        |x: &[f64]| (x[0] - 3.3).powi(2) + [2.0, 0.0, 3.0, 1.0, 4.0][x[1] as usize] + (x[2] - 0.7).abs();
    let mut solved = 0;
    for seed in 0..10 {
        let report = minimize(cost)
            .bounds(&[-10.0, 0.0, 0.0], &[9.0, 4.0, 1.0])
            .unwrap()
            .kinds(&[ParameterKind::Integer, ParameterKind::Categorical, ParameterKind::Continuous])
            .method(Genetic::default().resolution(&[1.0, 1.0, 0.01]))
            .seed(seed)
            .max_evaluations(2000)
            .run()
            .unwrap();
        assert!(report.trace.iter().all(|e| e.x[0] == e.x[0].round() && (0.0..=4.0).contains(&e.x[1])));
        solved += usize::from(report.x[0] == 3.0 && report.x[1] == 1.0 && (report.x[2] - 0.7).abs() < 0.02);
    }
    assert!(solved >= 9, "{solved} of 10");
}

#[test]
fn best_points_seen_pass_the_tests_on_quadratic() {
    for seed in 0..5 {
        let report = minimize(|x: &[f64]| (x[0] - 1.2).powi(2) + 3.0 * (x[1] + 0.4).powi(2))
            .bounds(&[-5.0; 2], &[5.0; 2])
            .unwrap()
            .method(Genetic::default())
            .measure(dfo::ToleranceMeasure::Absolute)
            .stop(dfo::StopRule::Any)
            .seed(seed)
            .max_evaluations(10_000)
            .run()
            .unwrap();
        assert!(report.is_success() && report.n_evaluations < 10_000 && report.fun < 1e-5, "{report}");
        assert!(report.message.contains("best points seen"), "{report}");
    }
}

/// Copies of one point do not pass the tests far from the minimum, and mutation does not prevent the tests
/// from passing near it.
#[test]
fn tests_pass_near_minimum_with_many_parameters() {
    for (n, budget) in [(4, 5_000), (8, 20_000), (12, 50_000), (15, 80_000)] {
        let cost = |x: &[f64]| -> f64 {
            x.iter().enumerate().map(|(k, x)| (1.0 + k as f64) * (x - 0.7 + 0.1 * k as f64).powi(2)).sum()
        };
        for seed in 0..3 {
            let report = minimize(cost)
                .bounds(&vec![-1.0; n], &vec![1.0; n])
                .unwrap()
                .method(Genetic::default())
                .measure(dfo::ToleranceMeasure::Absolute)
                .stop(dfo::StopRule::Any)
                .seed(seed)
                .max_evaluations(budget)
                .run()
                .unwrap();
            println!("n = {n}: {:.1e} in {}", report.fun, report.n_evaluations);
            assert!(report.is_success() && report.fun < 5e-5, "{report}");
        }
    }
}

/// A small population is not sufficient evidence of convergence.
#[test]
fn small_population_does_not_converge_immediately() {
    for members in [2, 5, 8] {
        let report = minimize(rosenbrock)
            .bounds(&[-2.0; 2], &[2.0; 2])
            .unwrap()
            .method(Genetic::default().population(members))
            .seed(1)
            .max_evaluations(2000)
            .run()
            .unwrap();
        assert!(!report.is_success() || report.fun < 1e-6, "{report}");
    }
}

#[test]
fn genetic_stalls_without_new_points() {
    let report = minimize(|x: &[f64]| x[0])
        .bounds(&[0.0], &[3.0])
        .unwrap()
        .kinds(&[ParameterKind::Integer])
        .method(Genetic::default().stall(Some(10)))
        .seed(1)
        .max_evaluations(100_000)
        .run()
        .unwrap();
    assert!(report.x == [0.0], "{report}");
    let fixed =
        minimize(|x: &[f64]| x[0]).bounds(&[2.0], &[2.0]).unwrap().method(Genetic::default()).run().unwrap();
    assert_eq!((fixed.x, fixed.termination, fixed.n_evaluations), (vec![2.0], Termination::AllFixed, 1));
}

#[test]
fn bad_options_return_typed_errors() {
    for bad in [
        Genetic::default().population(1),
        Genetic::default().population(4).elite(4),
        Genetic::default().crossover_rate(1.1),
        Genetic::default().mutation_rate(f64::NAN),
        Genetic::default().selection(Selection::Tournament(0)),
        Genetic::default().stall(Some(0)),
    ] {
        let run = minimize(rosenbrock).bounds(&[-1.0; 2], &[1.0; 2]).unwrap().method(bad.clone()).run();
        assert!(matches!(run, Err(Error::Option { .. })), "{bad:?}");
    }
    let endless = minimize(rosenbrock).start(&[0.0; 2]).method(Genetic::default()).run();
    assert!(matches!(endless, Err(Error::NeedsBox { method: "ga", index: 0, .. })));
}
