//! Black-box test of the main use: the friction of the Furuta pendulum from noisy measurements.

#![allow(clippy::unwrap_used)]

use crate::common;

use calibration::RunContext;
use common::*;
use fmufit::calibration::{Calibration, CalibrationError, Data, Experiment, Fit, FitOptions, Parameter};
use fmufit::dfo::{
    AnyMethod, Checkpoint, Error, Limits, Lookahead, NelderMead, Objective, Outcome, Query, RunOptions,
};

fn calibration(data: Data) -> Calibration {
    Calibration::builder(example("furuta"))
        .experiment(Experiment::new(data).output("armJoint.phi", "phi").output("pendulumJoint.phi", "theta"))
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012))
        .build()
        .unwrap()
}

fn fit(calibration: &Calibration, workers: usize, plan: Lookahead) -> Fit {
    let method = NelderMead::default().batch(plan).into();
    calibration.fit(RunOptions { workers: Some(workers), method, ..FitOptions::default_run() }).unwrap()
}

#[test]
fn fit_finds_friction_for_any_number_of_workers_and_plan() {
    let calibration = calibration(furuta_measurements());
    let first = fit(&calibration, 1, Lookahead::None);
    // The measurements were generated with (0.010, 0.001). The standard deviations are 1.4e-5 and 1.1e-6.
    assert!((first.x[0] - 0.010).abs() < 6e-5, "{first}");
    assert!((first.x[1] - 0.001).abs() < 6e-6, "{first}");
    assert!(first.start_cost.unwrap() > 100.0 * first.cost);
    for (workers, plan) in [
        (1, Lookahead::Points(4)),
        (2, Lookahead::Measured),
        (4, Lookahead::Measured),
        (3, Lookahead::Points(2)),
    ] {
        let other = fit(&calibration, workers, plan);
        assert_eq!(first.x, other.x);
        assert_eq!(first.cost.to_bits(), other.cost.to_bits());
        assert_eq!(first.report.n_iterations, other.report.n_iterations);
        assert_eq!(first.report.final_simplex, other.report.final_simplex);
    }
}

#[test]
fn cost_is_the_sum_of_squared_residuals_in_documented_order() {
    let calibration = calibration(furuta_measurements());
    let x = [0.011, 0.0015];
    let cost = calibration.cost(&x, &RunContext::new()).unwrap();
    let residuals = calibration.residuals(&x, &RunContext::new()).unwrap();
    assert_eq!(residuals.len(), 2 * 801);
    let sum: f64 = residuals.iter().map(|r| r * r).sum();
    assert_eq!(sum.to_bits(), cost.to_bits());
    // Output by output: the second half belongs to theta.
    let data = furuta_measurements();
    let simulated = &calibration.simulate(&x, None, &RunContext::new()).unwrap()[0];
    let theta = simulated.get("pendulumJoint.phi").unwrap();
    let measured = data.column("theta").unwrap();
    for k in 0..801 {
        assert_eq!(residuals[801 + k].to_bits(), (theta[k] - measured[k]).to_bits());
    }
    assert_eq!(cost.to_bits(), calibration.cost(&x, &RunContext::new()).unwrap().to_bits());
}

#[test]
fn cutoff_stops_simulations_without_changing_results() {
    let calibration = calibration(furuta_measurements());
    let x = [0.011, 0.0015];
    let cost = calibration.cost(&x, &RunContext::new()).unwrap();
    let at = |cutoff: f64| calibration.answer(&x, &Query::new(0, 0, cutoff)).outcome;
    assert_eq!(at(cost), Outcome::Value(cost));
    assert_eq!(at(0.5 * cost), Outcome::Above(0.5 * cost));
    assert_eq!(at(cost * (1.0 - 1e-15)), Outcome::Above(cost * (1.0 - 1e-15)));
}

#[test]
fn missing_values_and_window_only_shorten_the_residuals() {
    let data = furuta_measurements();
    let mut phi = data.column("phi").unwrap().to_vec();
    phi[3] = f64::NAN;
    phi[700] = f64::NAN;
    let columns = [("phi".to_owned(), phi), ("theta".to_owned(), data.column("theta").unwrap().to_vec())];
    let holed = Data::from_columns(data.time().to_vec(), columns).unwrap();
    let full = calibration(data);
    let holed = calibration(holed);
    let x = [0.011, 0.0015];
    let (a, mut b) =
        (full.residuals(&x, &RunContext::new()).unwrap(), holed.residuals(&x, &RunContext::new()).unwrap());
    assert_eq!(b.len(), a.len() - 2);
    b.insert(3, a[3]);
    b.insert(700, a[700]);
    assert_eq!(a, b);
    let windowed = Calibration::builder(example("furuta"))
        .experiment(Experiment::new(furuta_measurements()).output("armJoint.phi", "phi").window(1.0, 2.0))
        .parameter(Parameter::new("armFriction", 0.012))
        .parameter(Parameter::new("pendulumFriction", 0.002))
        .build()
        .unwrap();
    // The last steps differ, because they are shortened to end with the window.
    let windowed = windowed.residuals(&x, &RunContext::new()).unwrap();
    assert_eq!(windowed.len(), 21);
    assert!(windowed.iter().zip(&a[20..=40]).all(|(w, a)| (w - a).abs() < 1e-6), "{windowed:?}");
}

/// Fits from ten seeds with default settings. Returns the number of fits within 1 % of the cost found by
/// Nelder-Mead.
fn seeds_that_solve_it(name: &str) -> usize {
    let calibration = calibration(furuta_measurements());
    let nearby = fit(&calibration, 2, Lookahead::Measured);
    let solved = |seed: &u64| {
        let method: AnyMethod = name.parse().unwrap();
        let found =
            calibration.fit(RunOptions { method, seed: Some(*seed), ..FitOptions::default_run() }).unwrap();
        found.cost <= 1.01 * nearby.cost
    };
    (0..10).filter(solved).count()
}

#[test]
fn every_method_finds_the_friction() {
    let calibration = calibration(furuta_measurements());
    let nearby = fit(&calibration, 2, Lookahead::Measured);
    for name in AnyMethod::NAMES {
        let limits = Limits { max_evaluations: Some(1000), ..Limits::default() };
        let method = match name {
            // A single population may end in a nearby minimum.
            "cma-es" => fmufit::dfo::CmaEs::default().restarts(fmufit::dfo::Restarts::Bipop).into(),
            name => name.parse().unwrap(),
        };
        let options = RunOptions { method, seed: Some(1), limits, ..FitOptions::default_run() };
        let found = calibration.fit(options).unwrap();
        assert!(found.cost <= 1.02 * nearby.cost, "{name}: {found} {}", found.report);
        assert!((found.x[0] - 0.010).abs() < 3e-4 && (found.x[1] - 0.001).abs() < 3e-5, "{found}");
    }
}

#[test]
#[ignore = "takes a minute"]
fn differential_evolution_finds_friction_with_default_settings() {
    for name in ["de-classic", "de"] {
        let solved = seeds_that_solve_it(name);
        assert!(solved >= 9, "{name}: {solved} of 10");
    }
}

#[test]
#[ignore = "takes a minute"]
fn genetic_algorithm_finds_friction_with_default_settings() {
    let solved = seeds_that_solve_it("ga");
    assert!(solved >= 9, "{solved} of 10");
}

#[test]
fn cutoffs_save_right_hand_sides_without_changing_decisions() {
    let calibration = calibration(furuta_measurements());
    for name in AnyMethod::NAMES {
        let run = |cutoffs: bool| {
            let method = name.parse().unwrap();
            let limits = Limits { max_evaluations: Some(200), ..Limits::default() };
            // One worker is used. With several workers, the number of speculative points depends on the load
            // of the machine, and each of them counts as a whole simulation.
            let workers = Some(1);
            let options = RunOptions { method, seed: Some(3), limits, workers, ..FitOptions::default_run() };
            let options = FitOptions { cutoffs, ..FitOptions::from(options) };
            calibration.fit(options).unwrap()
        };
        let (with, without) = (run(true), run(false));
        assert_eq!(
            (&with.x, with.cost, &with.report.message),
            (&without.x, without.cost, &without.report.message)
        );
        assert_eq!(with.report.final_population, without.report.final_population);
        assert_eq!(with.report.final_simplex, without.report.final_simplex);
        let mut above = 0;
        assert_eq!(with.report.trace.len(), without.report.trace.len());
        for (a, b) in with.report.trace.iter().zip(without.report.trace.iter()) {
            assert_eq!((a.x, a.id, a.batch, a.cutoff, a.used), (b.x, b.id, b.batch, b.cutoff, b.used));
            match (a.outcome, b.outcome) {
                (Outcome::Above(cutoff), Outcome::Value(cost)) => {
                    assert!(cost > cutoff);
                    above += 1;
                }
                (a, b) => assert_eq!(a, b),
            }
        }
        let (less, all) = (with.stats.right_hand_sides, without.stats.right_hand_sides);
        match name {
            // Selection by fitness, means and models require every cost.
            "ga" | "cma-es" | "least-squares" | "quadratic-model" => {
                assert_eq!((above, less), (0, all), "{name}");
            }
            "de" | "de-classic" => assert!(above > 40 && less < all),
            _ => assert!(above > 0 && less < all, "{name}"),
        }
    }
}

#[test]
fn checkpoint_identifies_model_data_and_settings() {
    let folder = std::env::temp_dir().join(format!("fit-furuta-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("fit");
    let run = |calibration: &Calibration, evaluations| {
        let limits = Limits { max_evaluations: Some(evaluations), ..Limits::default() };
        let checkpoint = Some(Checkpoint::new(&path));
        calibration.fit(RunOptions { limits, checkpoint, ..FitOptions::default_run() })
    };
    let calibration = calibration(furuta_measurements());
    let whole = calibration.fit(FitOptions::default_run()).unwrap();
    let mut evaluations = 10;
    let resumed = loop {
        let fit = run(&calibration, evaluations).unwrap();
        if fit.report.is_success() {
            break fit;
        }
        evaluations += 17;
    };
    assert_eq!((&resumed.x, resumed.cost), (&whole.x, whole.cost));
    assert_eq!(
        (resumed.report.n_iterations, resumed.report.n_evaluations),
        (whole.report.n_iterations, whole.report.n_evaluations)
    );
    let mut phi = furuta_measurements().column("phi").unwrap().to_vec();
    phi[5] += 1e-9;
    let theta = furuta_measurements().column("theta").unwrap().to_vec();
    let time = furuta_measurements().time().to_vec();
    let other = Data::from_columns(time, [("phi".to_owned(), phi), ("theta".to_owned(), theta)]).unwrap();
    let refused = run(&self::calibration(other), 50);
    assert!(
        matches!(&refused, Err(CalibrationError::Optimiser(Error::CheckpointMismatch { what, .. })) if what == "data of experiment 0"),
        "{refused:?}"
    );
    let windowed = Calibration::builder(example("furuta"))
        .experiment(
            Experiment::new(furuta_measurements())
                .output("armJoint.phi", "phi")
                .output("pendulumJoint.phi", "theta")
                .window(0.0, 2.0),
        )
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012))
        .build()
        .unwrap();
    let refused = run(&windowed, 50);
    assert!(
        matches!(&refused, Err(CalibrationError::Optimiser(Error::CheckpointMismatch { what, .. })) if what == "windows of experiment 0"),
        "{refused:?}"
    );
    std::fs::remove_dir_all(folder).unwrap();
}
