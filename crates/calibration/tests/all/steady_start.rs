//! Simulations that start from steady state, compared with closed forms.

#![allow(clippy::unwrap_used)]

use calibration::{
    Calibration, CalibrationError, Data, Experiment, FitOptions, Parameter, RunContext, SimulationSettings,
};
use example_models::{ExampleKind, example_fmu, example_fmu_as};
use fmi::{Fmu, RunSettings, SteadyStart};

fn open(model: &str) -> Fmu {
    Fmu::open(example_fmu(model).unwrap()).unwrap()
}

/// The quadruple tank at rest with the voltages 5 and 6: its levels by Torricelli's law.
fn levels(a1: f64) -> [f64; 4] {
    let (g, a, share, flow) = (9.81, 3e-6, 0.3, 0.56e-6);
    let (q1, q2) = (5.0 * flow, 6.0 * flow);
    let level = |outflow: f64, a: f64| (outflow / a).powi(2) / (2.0 * g);
    let (from3, from4) = ((1.0 - share) * q2, (1.0 - share) * q1);
    [level(from3 + share * q1, a1), level(from4 + share * q2, a), level(from3, a), level(from4, a)]
}

fn tank(change: impl FnOnce(Experiment) -> Experiment) -> Calibration {
    let time: Vec<f64> = (0..31).map(f64::from).collect();
    let columns = (0..4).map(|i| (format!("x{}", i + 1), vec![levels(3e-6)[i]; 31]));
    let measured = Experiment::new(Data::from_columns(time, columns).unwrap());
    let measured = (1..=4).fold(measured, |e, i| e.output(format!("qt.x{i}"), format!("x{i}")));
    let driven = measured.constant_input("u1", 5.0).constant_input("u2", 6.0);
    Calibration::builder(open("quad_tank"))
        .experiment(change(driven.steady_start(SteadyStart::default())))
        .parameter(Parameter::new("qt.a1", 2.5e-6).bounds(2e-6, 4e-6))
        .build()
        .unwrap()
}

#[test]
fn tanks_start_at_the_levels_of_torricelli() {
    let calibration = tank(|e| e);
    for a1 in [2.2e-6, 3e-6, 3.7e-6] {
        let found = calibration.simulate(&[a1], None, &RunContext::new()).unwrap();
        for (column, level) in found[0].columns.iter().zip(levels(a1)) {
            for value in [column[0], column[30]] {
                assert!((value / level - 1.0).abs() < 1e-5, "{a1}: {value} {level}");
            }
        }
    }
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert!((fit.x[0] / 3e-6 - 1.0).abs() < 1e-5, "{fit}");
    // A state with an initial value keeps it, and the others come to rest.
    let held = tank(|e| e.initial_state("qt.x1", 0.03));
    let found = held.simulate(&[3e-6], None, &RunContext::new()).unwrap();
    let first: Vec<f64> = found[0].columns.iter().map(|column| column[0]).collect();
    assert!((first[0] - 0.03).abs() < 1e-12 && found[0].columns[0][30] > 0.04, "{first:?}");
    for i in 1..4 {
        assert!((first[i] / levels(3e-6)[i] - 1.0).abs() < 1e-5, "{first:?}");
    }
}

/// A lag with the gain 2 and the time constant T whose input steps from 1 to 2 at t = 1. It starts at 2 and passes a limit switch on
/// its way there from 0.
fn lag(steady: bool) -> Calibration {
    let time: Vec<f64> = (0..41).map(|k| 0.1 * f64::from(k)).collect();
    let y = time.iter().map(|t| if *t < 1.0 { 2.0 } else { 4.0 - 2.0 * (-(t - 1.0) / 0.8).exp() }).collect();
    let u = time.iter().map(|t| if *t < 0.95 { 1.0 } else { 2.0 }).collect();
    let data = Data::from_columns(time, [("y".to_owned(), y), ("u".to_owned(), u)]).unwrap();
    let experiment = Experiment::new(data).output("y", "y").held_input("u", "u");
    let experiment = if steady { experiment.steady_start(SteadyStart::default()) } else { experiment };
    Calibration::builder(open("switched_input"))
        .experiment(experiment)
        .parameter(Parameter::new("T", 0.3).bounds(0.05, 5.0))
        .build()
        .unwrap()
}

#[test]
fn lag_starts_at_its_gain_times_the_first_input() {
    let (steady, plain) = (lag(true), lag(false));
    let bits = |x: f64| steady.cost(&[x], &RunContext::new()).unwrap().to_bits();
    let before = bits(0.5);
    let fit = steady.fit(FitOptions::default()).unwrap();
    assert!((fit.x[0] - 0.8).abs() < 1e-4, "{fit}");
    assert_eq!(bits(0.5), before);
    assert!((plain.fit(FitOptions::default()).unwrap().x[0] - 0.8).abs() > 0.01);
}

fn single(
    model: &str,
    output: &str,
    limit: Option<f64>,
    settings: RunSettings,
) -> Result<Calibration, CalibrationError> {
    let time: Vec<f64> = (0..11).map(|k| 0.1 * f64::from(k)).collect();
    let data = Data::from_columns(time, [("y".to_owned(), vec![1.0; 11])]).unwrap();
    let name = if model == "dahlquist" { "k" } else { "mu" };
    Calibration::builder(open(model))
        .experiment(Experiment::new(data).output(output, "y").steady_start(SteadyStart { limit }))
        .parameter(Parameter::new(name, 1.0).bounds(1e-6, 10.0))
        .settings(SimulationSettings::from(settings))
        .build()
}

#[test]
fn model_without_rest_is_a_failed_evaluation_with_a_reason() {
    let oscillator = single("van_der_pol", "x0", None, RunSettings::default()).unwrap();
    let message = oscillator.cost(&[1.0], &RunContext::new()).unwrap_err().to_string();
    assert!(
        message.contains("the model does not come to rest at the inputs of the start: it still moves after")
            && message.contains("where the derivative of 'x")
            && message.contains("Set a larger steady_limit"),
        "{message}"
    );
    let check = oscillator.check();
    assert!(check.to_string().contains("does not come to rest"), "{check}");
    // x' = -k x takes 13.8 / k to fall to 1e-6.
    let slow = single("dahlquist", "x", Some(5.0), RunSettings::default()).unwrap();
    let message = slow.cost(&[0.1], &RunContext::new()).unwrap_err().to_string();
    assert!(
        message.contains("it still moves after 5 units of time, where the derivative of 'x' is -0.06"),
        "{message}"
    );
    let enough = single("dahlquist", "x", Some(500.0), RunSettings::default()).unwrap();
    assert!((enough.cost(&[0.1], &RunContext::new()).unwrap() - 11.0).abs() < 1e-3);
    let wrong = single("dahlquist", "x", Some(-1.0), RunSettings::default()).unwrap_err().to_string();
    assert!(wrong.contains("steady_limit = -1 must be positive"), "{wrong}");
    let stepping = Fmu::open(example_fmu_as("dahlquist", ExampleKind::Fmi2CoSimulation).unwrap()).unwrap();
    let data = Data::from_columns(vec![0.0, 1.0], [("x".to_owned(), vec![1.0; 2])]).unwrap();
    let wrong = Calibration::builder(stepping)
        .experiment(Experiment::new(data).output("x", "x").steady_start(SteadyStart::default()))
        .parameter(Parameter::new("k", 1.0))
        .build()
        .unwrap_err()
        .to_string();
    assert!(wrong.contains("a start from steady state requires model exchange"), "{wrong}");
}
