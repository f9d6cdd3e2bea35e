//! Calibration of co-simulation models.

#![allow(clippy::unwrap_used)]

use crate::support::faulty;
use calibration::{Calibration, Data, Experiment, FitOptions, Parameter, RunContext};
use dfo::{NelderMead, RunOptions};
use example_models::{ExampleKind, example_fmu_as};
use fmi::Fmu;
use fmi::RunSettings;

#[test]
fn co_simulation_is_fitted_in_every_fmi_version() {
    // x' = -k x, recorded at four times of a decay with k = 2.
    let t = vec![0.0, 0.513, 1.0, 1.5];
    let x: Vec<f64> = t.iter().map(|t: &f64| (-2.0 * t).exp()).collect();
    for kind in ExampleKind::ALL {
        let fmu = Fmu::open(example_fmu_as("dahlquist", kind).unwrap()).unwrap();
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x.clone())]).unwrap();
        let calibration = Calibration::builder(fmu)
            .experiment(Experiment::new(data).output("x", "x"))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
            .build()
            .unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        assert!((fit.x[0] - 2.0).abs() < 1e-3, "{kind:?}: {:?}", fit.x);
    }
}

/// Returns the test model as a co-simulation.
fn stepping(defines: &[&str]) -> tempfile::TempDir {
    let folder = faulty(defines);
    let description = folder.path().join("modelDescription.xml");
    let xml = std::fs::read_to_string(&description).unwrap();
    let interface =
        "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>";
    std::fs::write(&description, xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", interface))
        .unwrap();
    folder
}

/// The model makes one step of Euler's method per communication step, so another step would change the curve.
#[test]
fn curves_match_measurements_when_results_depend_on_the_communication_step() {
    for step in [None, Some(0.25)] {
        let folder = stepping(&["ONE_EULER_STEP"]);
        let t: Vec<f64> = vec![0.3, 0.5, 1.1, 2.0];
        let y: Vec<f64> = t.iter().map(|t| (-2.0 * t).exp()).collect();
        let data = Data::from_columns(t.clone(), [("y".to_owned(), y)]).unwrap();
        let calibration = Calibration::builder(Fmu::open(folder.path()).unwrap())
            .experiment(Experiment::new(data).output("y", "y"))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
            .settings(RunSettings { step_size: step, ..RunSettings::default() })
            .build()
            .unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        let curves = calibration.curves(&fit, &RunContext::new()).unwrap();
        let output = &curves[0].outputs[0];
        let fitted = output.fitted.as_ref().unwrap();
        for ((t, measured), residual) in t.iter().zip(&output.measured.values).zip(&output.residuals) {
            let place = fitted.times.iter().position(|time| (time - t).abs() < 1e-12).unwrap();
            assert!((fitted.values[place] - measured - residual).abs() < 1e-12, "{step:?} at {t}");
        }
        let n = if step.is_some() { 11 } else { 4 };
        assert_eq!(fitted.times.len(), n, "{:?}", fitted.times);
    }
}

/// The results depend on the communication step because the model makes one step of Euler's method per step.
#[test]
fn communication_step_is_reported_when_it_changes_the_results() {
    // A search that is long enough to allow two more simulations.
    let long = || RunOptions { method: NelderMead::default().into(), ..FitOptions::default_run() };
    let reported = |defines: &[&str], step: f64, noise: f64| {
        let folder = stepping(defines);
        let t: Vec<f64> = (0..=20).map(|k| 0.1 * f64::from(k)).collect();
        let y = t
            .iter()
            .enumerate()
            .map(|(k, t)| (-2.0 * t).exp() + noise * f64::from(u8::from(k % 2 == 0)))
            .collect();
        let data = Data::from_columns(t, [("y".to_owned(), y)]).unwrap();
        let settings = RunSettings { step_size: Some(step), ..RunSettings::default() };
        let calibration = Calibration::builder(Fmu::open(folder.path()).unwrap())
            .experiment(Experiment::new(data).output("y", "y"))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
            .settings(settings)
            .build()
            .unwrap();
        let findings = (calibration.check().findings, calibration.fit(long()).unwrap().findings());
        let is_reported = |text: String| text.contains("half the communication step changes 'y'");
        (
            findings.0.iter().any(|f| is_reported(f.to_string())),
            findings.1.iter().any(|f| is_reported(f.to_string())),
        )
    };
    assert_eq!(reported(&["ONE_EULER_STEP"], 0.1, 0.0), (true, true));
    assert_eq!(reported(&["ONE_EULER_STEP"], 0.1, 0.2), (true, false));
    assert_eq!(reported(&[], 0.1, 0.0), (false, false));
    assert_eq!(reported(&["ONE_EULER_STEP"], 1e-4, 1e-3), (false, false));
}
