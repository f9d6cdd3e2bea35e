//! Setups with one mistake are reported, and sound setups cause no findings.

#![allow(clippy::unwrap_used)]

mod recordings;
mod residuals;
mod settings;

use calibration::{
    Calibration, Data, Experiment, Finding, Fit, FitOptions, Parameter, Severity, SimulationSettings,
};
use example_models::example_fmu;
use fmi::Fmu;
use std::path::Path;

fn open(model: &str) -> Fmu {
    Fmu::open(example_fmu(model).unwrap()).unwrap()
}

/// Returns a pseudo-random number from -1 to 1.
fn noise(k: usize) -> f64 {
    2.0 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract().abs() - 1.0
}

fn times(n: usize, interval: f64) -> Vec<f64> {
    (0..n).map(|k| interval * k as f64).collect()
}

/// `exp(-rate t)` with noise of this size.
fn decay(t: &[f64], rate: f64, size: f64) -> Vec<f64> {
    t.iter().enumerate().map(|(k, t)| (-rate * t).exp() + size * noise(k)).collect()
}

fn recording(t: &[f64], x: Vec<f64>) -> Experiment {
    Experiment::new(Data::from_columns(t.to_vec(), [("x".to_owned(), x)]).unwrap()).output("x", "x")
}

fn k() -> Parameter {
    Parameter::new("k", 1.5).bounds(0.1, 10.0)
}

/// x' = -k x with x(0) = 1.
fn calibration(
    experiments: Vec<Experiment>,
    parameter: Parameter,
    settings: impl Into<SimulationSettings>,
) -> Calibration {
    let builder = Calibration::builder(open("dahlquist")).parameter(parameter).settings(settings);
    experiments.into_iter().fold(builder, calibration::CalibrationBuilder::experiment).build().unwrap()
}

/// A decay with k = 2 in 61 rows over 3 s.
fn sound(size: f64) -> Experiment {
    let t = times(61, 0.05);
    recording(&t, decay(&t, 2.0, size))
}

fn fitted(experiment: Experiment, parameter: Parameter) -> Fit {
    let fit = calibration(vec![experiment], parameter, SimulationSettings::default());
    fit.fit(FitOptions::default()).unwrap()
}

fn warns(findings: &[Finding], text: &str) -> bool {
    findings.iter().any(|f| f.severity != Severity::Note && f.to_string().contains(text))
}

fn warnings(findings: &[Finding]) -> Vec<String> {
    findings.iter().filter(|f| f.severity != Severity::Note).map(ToString::to_string).collect()
}

#[test]
fn sound_fit_has_no_warnings() {
    let fit = fitted(sound(1e-3), k());
    assert!((fit.x[0] - 2.0).abs() < 0.01 && warnings(&fit.findings()).is_empty(), "{fit}");
}

#[test]
fn example_fits_have_only_expected_findings() {
    let data = |name: &str| {
        Data::from_csv(Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../examples/data/{name}.csv")))
            .unwrap()
    };
    let furuta = Calibration::builder(open("furuta"))
        .experiment(
            Experiment::new(data("furuta"))
                .output("armJoint.phi", "phi")
                .output("pendulumJoint.phi", "theta"),
        )
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012));
    let tank = |n: usize| {
        let driven = Experiment::new(data("quad_tank")).input("u1", "u1").input("u2", "u2");
        let measured = (1..=n).fold(driven, |e, i| e.output(format!("qt.x{i}"), format!("x{i}")));
        let builder = Calibration::builder(open("quad_tank")).experiment(measured);
        (1..=n).fold(builder, |b, i| b.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6)))
    };
    let inputs = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"];
    let exhaust = inputs.into_iter().fold(
        Experiment::new(data("exhaust")).output("T_out", "T_out").window(0.0, 500.0),
        |experiment, name| experiment.input(name, name),
    );
    let exhaust = Calibration::builder(open("exhaust"))
        .experiment(exhaust)
        .parameter(Parameter::new("C1", 2500.0).bounds(0.25, 50e3))
        .parameter(Parameter::new("G1", 120.0).bounds(0.012, 1e3));
    let expected =
        ["autocorrelated", "offset", "is at its", "standard error of", "keep their sign", "outliers"];
    for (name, builder) in [("furuta", furuta), ("tank2", tank(2)), ("tank4", tank(4)), ("exhaust", exhaust)]
    {
        let fit = builder.build().unwrap().fit(FitOptions::default()).unwrap();
        let new: Vec<String> = warnings(&fit.findings())
            .into_iter()
            .filter(|text| !expected.iter().any(|k| text.contains(k)))
            .collect();
        assert!(new.is_empty(), "{name}: {new:#?}");
    }
}
