//! Misleading setups: late recordings, unused or held inputs, parameters at a bound or without effect.

#![allow(clippy::unwrap_used)]

use calibration::{
    BoundSide, Calibration, CalibrationBuilder, Data, Experiment, FitOptions, Parameter, SetupWarning,
    Severity,
};
use dfo::{DifferentialEvolution, Limits, NelderMead, RunOptions};
use example_models::example_fmu;
use fmi::Fmu;

fn times(n: u32) -> Vec<f64> {
    (0..n).map(|k| 0.1 * f64::from(k)).collect()
}

fn decay(from: f64, parameter: Parameter) -> CalibrationBuilder {
    let x = times(21).iter().map(|t| (-2.0 * t).exp()).collect();
    let time = times(21).iter().map(|t| from + t).collect();
    let data = Data::from_columns(time, [("x".to_owned(), x)]).unwrap();
    Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(Experiment::new(data).output("x", "x"))
        .parameter(parameter)
}

/// Two outlets of the tank. The second one has no effect on the compared level.
fn tank(u1_until: f64, inputs: &[&str]) -> Calibration {
    tank_builder(u1_until, inputs, false).build().unwrap()
}

fn tank_builder(u1_until: f64, inputs: &[&str], hold: bool) -> CalibrationBuilder {
    let time: Vec<f64> = (0..31).map(f64::from).collect();
    let u1 = time.iter().map(|t| if *t <= u1_until { 5.0 + t % 2.0 } else { f64::NAN }).collect();
    let level = time.iter().map(|t| 0.06 - 1e-4 * t).collect();
    let columns = [("u1", u1), ("u2", vec![5.0; 31]), ("x", level)].map(|(name, v)| (name.to_owned(), v));
    let data = Data::from_columns(time, columns).unwrap();
    let mut experiment = Experiment::new(data).output("qt.x1", "x").hold_inputs(hold);
    for input in inputs {
        experiment = experiment.input(*input, *input);
    }
    Calibration::builder(Fmu::open(example_fmu("quad_tank").unwrap()).unwrap())
        .experiment(experiment)
        .parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6))
        .parameter(Parameter::new("qt.a2", 3e-6).bounds(2e-6, 4e-6))
}

#[test]
fn late_recording_requires_start_time() {
    let parameter = || Parameter::new("k", 1.0).bounds(0.1, 10.0);
    let message = decay(100.0, parameter()).build().unwrap_err().to_string();
    assert!(
        message.contains("begins at 100 s, but the simulation begins at 0 s. Set start_time = 100"),
        "{message}"
    );
    assert!(decay(1.0, parameter()).build().is_ok());
    assert!(decay(1.2, parameter()).build().is_err());
}

#[test]
fn unused_input_columns_cause_warnings() {
    assert!(tank(30.0, &["u1", "u2"]).warnings().is_empty());
    match tank(30.0, &["u1"]).warnings() {
        [SetupWarning::UnusedColumn { column, input, .. }] => assert_eq!((&**column, &**input), ("u2", "u2")),
        other => panic!("{other:?}"),
    }
}

#[test]
fn inputs_are_held_beyond_recording_only_with_hold_inputs() {
    let message = tank_builder(20.0, &["u1", "u2"], false).build().unwrap_err().to_string();
    let expected = "input 'u1' is recorded from 0 s to 20 s, but the simulation needs it from 0 s to 30 s. Set hold_inputs";
    assert!(message.contains(expected), "{message}");
    assert!(tank_builder(20.0, &["u1", "u2"], true).build().unwrap().warnings().is_empty());
    // One sampling interval is not a gap.
    assert!(tank_builder(29.0, &["u1", "u2"], false).build().is_ok());
}

#[test]
fn parameter_at_bound_is_reported() {
    for (lower, upper, expected) in
        [(0.1, 1.5, Some(BoundSide::Upper)), (2.5, 10.0, Some(BoundSide::Lower)), (0.1, 10.0, None)]
    {
        let parameter = Parameter::new("k", 0.5 * (lower + upper)).bounds(lower, upper);
        let fit = decay(0.0, parameter).build().unwrap().fit(FitOptions::default()).unwrap();
        assert_eq!(fit.at_bound.first().map(|(_, side)| *side), expected);
        let is_reported =
            fit.findings().iter().any(|f| f.severity == Severity::Warning && f.sentence.contains("bound"));
        assert_eq!(is_reported, expected.is_some(), "{fit}");
        assert!(fit.without_effect.is_empty());
    }
}

#[test]
fn parameter_without_effect_is_reported_with_every_budget() {
    let calibration = tank(30.0, &["u1", "u2"]);
    let options = |evaluations| RunOptions {
        method: NelderMead::default().into(),
        limits: Limits { max_evaluations: Some(evaluations), ..Limits::default() },
        ..FitOptions::default_run()
    };
    let fit = calibration.fit(options(500)).unwrap();
    assert_eq!(fit.without_effect, [1], "{}", fit.report.message);
    assert!(fit.to_string().contains("the data do not determine qt.a2"), "{fit}");
    assert!(fit.n_checks >= 1 && fit.report.trace.len() == fit.report.n_evaluations);
    // The first simplex shows it, and the budget is used up.
    let fit = calibration.fit(options(10)).unwrap();
    assert_eq!((fit.report.n_evaluations, fit.n_checks, &fit.without_effect[..]), (10, 0, &[1][..]));
    let fit = calibration
        .fit(RunOptions { method: DifferentialEvolution::default().into(), seed: Some(1), ..options(60) })
        .unwrap();
    // Generations show nothing about single parameters, but the standard errors do.
    assert_eq!((fit.report.n_evaluations, fit.n_checks, &fit.without_effect[..]), (60, 0, &[1][..]));
}

/// This also holds for a model without a variable called `time`.
#[test]
#[cfg(target_os = "linux")]
fn outputs_that_are_not_single_results_are_rejected() {
    let folder = crate::support::faulty(&[]);
    let description = folder.path().join("modelDescription.xml");
    let text = std::fs::read_to_string(&description).unwrap();
    std::fs::write(&description, text.replace("name=\"time\"", "name=\"clock\"")).unwrap();
    let fmu = fmi::Fmu::open(folder.path()).unwrap();
    for (output, expected) in [("time", "it is the time, not a result"), ("y*", "is a pattern")] {
        let data = Data::from_columns(vec![0.0, 0.5], [("y".to_owned(), vec![1.0, 0.5])]).unwrap();
        let built = Calibration::builder(fmu.clone())
            .experiment(Experiment::new(data).output(output, "y"))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 5.0))
            .build();
        let message = built.unwrap_err().to_string();
        assert!(message.contains(expected), "expected '{expected}' in: {message}");
    }
}

#[test]
fn shared_column_and_tie_of_different_units_are_rejected() {
    let t: Vec<f64> = (0..20).map(|k| 0.1 * f64::from(k)).collect();
    let data =
        Data::from_columns(t.clone(), [("h".to_owned(), t.iter().map(|t| 1.0 - 4.9 * t * t).collect())])
            .unwrap();
    let ball = |experiment: Experiment, tied: Option<Parameter>| {
        let builder = Calibration::builder(Fmu::open(example_fmu("bouncing_ball").unwrap()).unwrap())
            .experiment(experiment)
            .parameter(Parameter::new("g", -9.0).bounds(-20.0, -1.0));
        tied.into_iter().fold(builder, CalibrationBuilder::parameter).build()
    };
    let error = ball(Experiment::new(data.clone()).output("hight", "h"), None).unwrap_err().to_string();
    assert!(!error.contains("is reversed"), "{error}");
    let recorded = Data::from_columns(t, [("height".to_owned(), vec![1.0; 20])]).unwrap();
    let error = ball(Experiment::new(recorded).output("height", "h"), None).unwrap_err().to_string();
    assert!(error.contains("is reversed") && error.contains("{\"h\": \"height\"}"), "{error}");
    let one = || Experiment::new(data.clone()).output("h", "h");
    let error = ball(one().output("v", "h"), None).unwrap_err().to_string();
    assert!(error.contains("column 'h' is compared with two outputs, 'h' and 'v'"), "{error}");
    // h is in m, g in m/s2.
    let tied = |across| Parameter::tied("h", "g", -0.1, 0.0).across_units(across);
    let error = ball(one(), Some(tied(false))).unwrap_err().to_string();
    assert!(
        error.contains("is in 'm', but 'g', to which it is tied, is in 'm/s2'. Set across_units"),
        "{error}"
    );
    ball(one(), Some(tied(true))).unwrap();
}
