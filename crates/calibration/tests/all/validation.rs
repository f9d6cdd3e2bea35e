//! Validation on other parts of a recording and on other recordings.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::dfo::Limits;
use calibration::{
    Calibration, CrossValidationOptions, Data, Experiment, Fit, FitOptions, Parameter, Severity,
    ValidationSet,
};
use example_models::example_fmu;
use std::time::Duration;

/// x' = -k x from x0, every 0.1 s.
fn decay(k: f64, x0: f64) -> Data {
    let t: Vec<f64> = (0..31).map(|i| f64::from(i) / 10.0).collect();
    let x = t.iter().map(|t| x0 * (-k * t).exp()).collect();
    Data::from_columns(t, [("x".to_owned(), x)]).unwrap()
}

fn experiment(k: f64, x0: f64) -> Experiment {
    Experiment::new(decay(k, x0)).output("x", "x")
}

fn fitted(experiments: Vec<Experiment>, local: bool) -> (Calibration, Fit) {
    let fmu = fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let mut builder =
        Calibration::builder(fmu).parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0).fixed(!local));
    builder = builder.parameter(Parameter::new("x", 1.0).bounds(0.1, 10.0).local(local));
    builder = experiments.into_iter().fold(builder, |builder, e| builder.experiment(e));
    let calibration = builder.build().unwrap();
    let fit = calibration.fit(FitOptions::default()).unwrap();
    (calibration, fit)
}

/// Root of the mean squared difference of two decays at these steps of 0.1 s.
fn rms(steps: std::ops::RangeInclusive<u32>, (k, x0): (f64, f64), (other, y0): (f64, f64)) -> f64 {
    let n = f64::from(steps.end() - steps.start() + 1);
    let at = |t: f64| x0 * (-k * t).exp() - y0 * (-other * t).exp();
    (steps.map(|i| at(f64::from(i) / 10.0).powi(2)).sum::<f64>() / n).sqrt()
}

#[test]
fn validation_window_keeps_its_history() {
    let (calibration, fit) = fitted(vec![experiment(2.0, 1.0).window(0.0, 1.0)], false);
    let x0 = fit.x[1];
    let validation =
        calibration.validate(&fit, &ValidationSet::Windows(vec![(2.0, 3.0)]), &RunContext::new()).unwrap();
    assert_eq!((validation.n, validation.x == fit.x), (11, true));
    assert!((validation.rms / rms(20..=30, (1.0, x0), (2.0, 1.0)) - 1.0).abs() < 1e-4, "{validation:?}");
    let at_start = rms(20..=30, (1.0, 1.0), (2.0, 1.0));
    assert!((validation.start_rms.unwrap() / at_start - 1.0).abs() < 1e-4);
    let [output] = &validation.outputs[..] else { panic!("{validation}") };
    assert_eq!((output.fit.rms, output.fit.start_rms), (validation.rms, validation.start_rms));
    assert_eq!((output.times[0], output.times[10], output.residuals.len()), (2.0, 3.0, 11));
    assert!((output.simulated()[0] - x0 * f64::exp(-2.0)).abs() < 1e-6);
    assert_eq!((validation.n_simulations, validation.stats.accepted_steps > 0), (2, true));
    // Validation in the window of the fit reproduces the statistics of the fit.
    let again =
        calibration.validate(&fit, &ValidationSet::Windows(vec![(0.0, 1.0)]), &RunContext::new()).unwrap();
    assert_eq!((again.rms, again.scaled_rms()), (fit.rms, fit.scaled_rms()));
    assert_eq!(again.outputs[0].fit, fit.outputs[0]);
    // A warning reports this, also for a part of the window and for the same recording given again. There is
    // no warning for another window.
    assert!(validation.findings.is_empty() && again.findings[0].severity == Severity::Warning, "{again}");
    assert!(
        again.to_string().contains("\nwarning  run1: x: the fit has used 11 of these 11 measurements"),
        "{again}"
    );
    let part =
        calibration.validate(&fit, &ValidationSet::Windows(vec![(0.8, 1.2)]), &RunContext::new()).unwrap();
    assert!(part.findings[0].sentence.contains("3 of these 5 measurements"), "{part}");
    let on = |e: Experiment| {
        calibration
            .validate(&fit, &ValidationSet::Experiments(vec![e]), &RunContext::new())
            .unwrap()
            .findings
            .len()
    };
    assert_eq!((on(experiment(2.0, 1.0).window(0.0, 1.0)), on(experiment(2.0, 1.5))), (1, 0));
    let text = validation.to_string();
    assert!(text.contains("run1: x") && text.contains("scaled RMS") && text.lines().count() == 3, "{text}");
}

#[test]
fn local_parameters_are_fitted_to_other_recordings() {
    let (calibration, fit) = fitted(vec![experiment(2.0, 1.0), experiment(2.0, 3.0)], true);
    assert_eq!(fit.names, ["k", "x[run1]", "x[run2]"]);
    // The first other recording has the same name as one in the fit, but it has a separate start.
    let others = vec![experiment(2.0, 5.0).start_value("x", 4.0), experiment(2.2, 2.0).named("colder")];
    let validation =
        calibration.validate(&fit, &ValidationSet::Experiments(others), &RunContext::new()).unwrap();
    assert_eq!(validation.names, ["k", "x[run1]", "x[colder]"]);
    assert_eq!(validation.x[0], fit.x[0]);
    assert!((validation.x[1] - 5.0).abs() < 1e-3, "{validation}");
    let [first, second] = &validation.outputs[..] else { panic!("{validation}") };
    assert!(first.fit.rms < 1e-3 && second.fit.rms > 0.01, "{validation}");
    assert!((first.fit.start_rms.unwrap() / rms(0..=30, (1.0, 4.0), (2.0, 5.0)) - 1.0).abs() < 1e-4);
    assert!(validation.n_simulations > 2);
}

#[test]
fn validation_rejects_invalid_sets() {
    let (calibration, fit) = fitted(vec![experiment(2.0, 1.0)], false);
    let experiments = |one: Experiment| ValidationSet::Experiments(vec![one]);
    for (set, expected) in [
        (ValidationSet::Windows(vec![(5.0, 6.0)]), "5"),
        (ValidationSet::Windows(vec![(1.0, 0.0)]), "window from 1 to 0"),
        (ValidationSet::Windows(vec![]), "windows is empty"),
        (ValidationSet::Experiments(vec![]), "experiments is empty"),
        (experiments(experiment(1.0, 1.0).output("y", "x")), "\"y\""),
        (experiments(Experiment::new(decay(1.0, 1.0)).output("x", "z")), "z"),
    ] {
        let error = calibration.validate(&fit, &set, &RunContext::new()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let error = calibration.validate(
        &fit,
        &ValidationSet::Windows(vec![(0.0, 1.0)]),
        &RunContext::new().polling(&|| true),
    );
    assert!(matches!(error, Err(calibration::CalibrationError::Cancelled)));
}

#[test]
fn cross_validation_ends_at_time_limit() {
    let (calibration, _) = fitted(vec![experiment(2.0, 1.0), experiment(2.1, 1.5)], true);
    let mut options = CrossValidationOptions::default();
    options.run.limits = Limits { max_time: Some(Duration::from_nanos(1)), ..Limits::default() };
    let error = calibration.cross_validate(&options, &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("before one of 2 folds was complete"), "{error}");
    options.run.limits.max_time = Some(Duration::from_secs(600));
    let found = calibration.cross_validate(&options, &RunContext::new()).unwrap();
    assert!(found.folds.len() == 2 && found.unfinished.is_empty());
}

/// Recordings a and b with the rate 2, and c with the rate 0.5, all with the same start value.
fn conditions(parameters: Vec<Parameter>) -> Calibration {
    let fmu = fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let runs = [("a", 2.0), ("b", 2.0), ("c", 0.5)].map(|(name, k)| experiment(k, 1.5).named(name));
    let builder = runs.into_iter().fold(Calibration::builder(fmu), |builder, run| builder.experiment(run));
    parameters.into_iter().fold(builder, |builder, p| builder.parameter(p)).build().unwrap()
}

fn rate(name: &str, experiments: &[&str]) -> Parameter {
    let experiments = experiments.iter().map(|name| (*name).to_owned());
    Parameter::new(name, 1.0).bounds(0.1, 10.0).variables(["k"]).experiments(experiments)
}

#[test]
fn cross_validation_reports_parameters_without_another_recording() {
    let x0 = Parameter::new("x", 1.0).bounds(0.1, 10.0);
    let calibration = conditions(vec![rate("fast", &["a", "b"]), rate("slow", &["c"]), x0]);
    let found = calibration.cross_validate(&CrossValidationOptions::default(), &RunContext::new()).unwrap();
    let fitted: Vec<Vec<String>> = found.folds.iter().map(|fold| fold.validation.fitted.clone()).collect();
    assert_eq!(fitted, [vec![], vec![], vec!["slow".to_owned()]]);
    for (fold, names) in
        found.folds.iter().zip([&["fast", "slow", "x"][..], &["fast", "slow", "x"], &["fast", "x"]])
    {
        assert_eq!(fold.fit.names, names);
        assert!(fold.validation.rms < 1e-3, "{found}");
    }
    let slow = &found.folds[2].validation;
    let at = slow.names.iter().position(|name| name == "slow").unwrap();
    assert!((slow.x[at] - 0.5).abs() < 1e-3, "{slow:?}");
    assert!(
        (found.parameters[0].1 - 2.0).abs() < 1e-3 && (found.parameters[1].1 - 0.5).abs() < 1e-3,
        "{found}"
    );
    assert!(
        found.to_string().ends_with(
            "not predicted but fitted to the omitted recording, which alone determines them: slow"
        ),
        "{found}"
    );
    // A wrong rate of the omitted recording is not hidden by a parameter that acts there.
    let shared = conditions(vec![rate("fast", &["a", "b", "c"]), Parameter::new("x", 1.0).bounds(0.1, 10.0)]);
    let found = shared.cross_validate(&CrossValidationOptions::default(), &RunContext::new()).unwrap();
    let expected = rms(0..=30, (2.0, 1.5), (0.5, 1.5));
    assert!((found.folds[2].validation.rms / expected - 1.0).abs() < 1e-2, "{found}");
    let only = conditions(vec![rate("slow", &["c"])]);
    let error =
        only.cross_validate(&CrossValidationOptions::default(), &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("no parameter acts in a, so a fit of the others does not predict it"), "{error}");
}

#[test]
fn validation_uses_the_parameters_of_the_experiment_with_the_same_name() {
    let calibration = conditions(vec![rate("fast", &["a", "b"]), rate("slow", &["c"])]);
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let validate = |runs: Vec<Experiment>| {
        calibration.validate(&fit, &ValidationSet::Experiments(runs), &RunContext::new())
    };
    let both = vec![experiment(2.0, 1.0).named("b"), experiment(0.5, 1.0).named("c")];
    let validation = validate(both).unwrap();
    assert_eq!((validation.x.as_slice(), validation.fitted.len()), (fit.x.as_slice(), 0));
    let slow = validate(vec![experiment(0.5, 1.0).named("c")]).unwrap();
    assert_eq!((slow.names.as_slice(), slow.x.as_slice()), (&["slow".to_owned()][..], &fit.x[1..]));
    let expected = rms(0..=30, (slow.x[0], 1.0), (0.5, 1.0));
    assert!((slow.rms / expected - 1.0).abs() < 1e-3, "{} {expected}", slow.rms);
    let error = validate(vec![experiment(2.0, 1.0)]).unwrap_err().to_string();
    assert!(
        error.contains("parameter 'fast': acts in a, b only, so it is unknown whether it acts in the recordings run1. Name"),
        "{error}"
    );
}

#[test]
fn recordings_of_tied_parameter_are_validated_without_those_of_its_master() {
    let tied = |name: &str, factor: f64, experiment: &str| {
        Parameter::tied(name, "fast", factor, 0.0).variables(["k"]).experiments([experiment])
    };
    let x0 = || Parameter::new("x", 1.0).bounds(0.1, 10.0);
    let parameters = vec![rate("fast", &["a"]), tied("same", 1.0, "b"), tied("slow", 0.25, "c"), x0()];
    let calibration = conditions(parameters);
    let found = calibration.cross_validate(&CrossValidationOptions::default(), &RunContext::new()).unwrap();
    for fold in &found.folds {
        assert_eq!((fold.fit.names.len(), fold.validation.fitted.len()), (2, 0), "{found}");
        assert!(fold.validation.rms < 1e-3 && (fold.fit.x[0] - 2.0).abs() < 1e-3, "{found}");
    }
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let set = ValidationSet::Experiments(vec![experiment(0.5, 1.5).named("c")]);
    let slow = calibration.validate(&fit, &set, &RunContext::new()).unwrap();
    assert!(slow.rms < 1e-3 && slow.x == fit.x, "{slow}");
    // A parameter may act only through a tied one.
    let only = Parameter::new("rate", 1.0).bounds(0.1, 10.0).variables(Vec::<String>::new());
    let half = Parameter::tied("k", "rate", 0.5, 0.0).experiments(["a", "b"]);
    let fit = conditions(vec![only, half, x0().experiments(["a", "b"])]).fit(FitOptions::default()).unwrap();
    assert!((fit.x[0] - 4.0).abs() < 1e-3, "{fit}");
    let fmu = fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let nowhere = Parameter::new("k", 1.0).experiments(Vec::<String>::new());
    let alone = Calibration::builder(fmu).experiment(experiment(2.0, 1.0)).parameter(nowhere).build();
    assert!(alone.unwrap_err().to_string().contains("experiments is empty. Omit it"));
}
