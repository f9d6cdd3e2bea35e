//! Initial states from the recording: `x' = -k x` with k = 2 and x(0) = 1. The fit must find k.

#![allow(clippy::unwrap_used)]

use crate::support::faulty;
use calibration::{
    BandOptions, Calibration, CalibrationError, CostKind, Data, Experiment, FitOptions, InitialState,
    NamedCost, Parameter, RunContext, Weight,
};
use dfo::{Loss, RobustLoss};
use example_models::example_fmu;
use fmi::Fmu;
use fmi::RunSettings;

const K: f64 = 2.0;

fn times() -> Vec<f64> {
    (0..51).map(|k| 0.1 * f64::from(k)).collect()
}

fn recording(x: impl Fn(f64) -> f64) -> Data {
    let x: Vec<f64> = times().into_iter().map(x).collect();
    Data::from_columns(times(), [("x".to_owned(), x)]).unwrap()
}

fn fitted(experiment: Experiment, parameters: &[Parameter]) -> Result<Vec<f64>, CalibrationError> {
    let experiment = experiment.initial_state("x", InitialState::Measured);
    let mut builder = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(experiment)
        .settings(RunSettings { relative_tolerance: Some(1e-9), ..RunSettings::default() });
    for parameter in parameters {
        builder = builder.parameter(parameter.clone());
    }
    Ok(builder.build()?.fit(FitOptions::default())?.x)
}

fn k() -> Parameter {
    Parameter::new("k", 1.0).bounds(0.1, 10.0)
}

#[test]
fn measured_state_is_read_at_the_start_of_the_simulation() {
    let decay = || recording(|t| (-K * t).exp());
    let experiment = || Experiment::new(decay()).output("x", "x");
    let weights = |k: usize| if k < 20 { 0.0 } else { 1.0 };
    for (what, experiment) in [
        ("all", experiment()),
        ("a window", experiment().window(1.0, 3.0)),
        ("a warm-up", experiment().warm_up(0.5)),
        ("a window and a warm-up", experiment().window(1.0, 3.0).warm_up(0.5)),
        (
            "weights of 0",
            Experiment::new(decay()).weighted_output("x", "x", Weight::Rows((0..51).map(weights).collect())),
        ),
        ("another start", experiment().start_time(0.7).window(0.7, 5.0)),
    ] {
        let x = fitted(experiment, &[k()]).unwrap();
        assert!((x[0] - K).abs() < 1e-5, "{what}: {x:?}");
    }
}

#[test]
fn measured_state_is_corrected_for_offset_and_delay() {
    let offset = recording(|t| (-K * t).exp() + 0.3);
    let experiment = Experiment::new(offset).output("x", "x");
    let x = fitted(experiment, &[k(), Parameter::new("bias", 0.0).offset_of("x").bounds(-1.0, 1.0)]).unwrap();
    assert!((x[0] - K).abs() < 1e-4 && (x[1] - 0.3).abs() < 1e-4, "{x:?}");
    // The measurement at t is the model value at t - 0.2.
    let late = recording(|t| (-K * (t - 0.2)).exp());
    let experiment = Experiment::new(late).output("x", "x").delay("x", 0.2).window(0.2, 5.0);
    let x = fitted(experiment, &[k()]).unwrap();
    assert!((x[0] - K).abs() < 1e-5, "{x:?}");
}

#[test]
fn measured_state_is_rejected_when_no_measurement_exists() {
    let keep: Vec<bool> = (0..51).map(|k| k >= 10).collect();
    let masked = recording(|t| (-K * t).exp()).masked(&["x"], &keep).unwrap();
    let message = fitted(Experiment::new(masked).output("x", "x"), &[k()]).unwrap_err().to_string();
    assert!(
        message.contains("column 'x' has no value at 0 s. The first value is at 1 s. Start at")
            && message.contains("start_time"),
        "{message}"
    );
    let gap: Vec<bool> = (0..51).map(|k| !(5..40).contains(&k)).collect();
    let gap = recording(|t| (-K * t).exp()).masked(&["x"], &gap).unwrap();
    let experiment = Experiment::new(gap).output("x", "x").start_time(2.0).window(4.0, 5.0);
    let message = fitted(experiment, &[k()]).unwrap_err().to_string();
    assert!(message.contains("Values are missing from 0.4 s to 4 s"), "{message}");
    let decay = recording(|t| (-K * t).exp());
    let late = Parameter::new("late", 0.1).delay_of("x").bounds(0.0, 0.5);
    let message = fitted(Experiment::new(decay).output("x", "x"), &[k(), late]).unwrap_err().to_string();
    assert!(message.contains("the delay of its output is fitted"), "{message}");
}

/// A parameter of the model gets the first value of a column: k = x(0) = 2. The search for the start of the state begins at 1, and the
/// fit finds its start value, 2.
#[test]
fn measured_output_sets_a_parameter_of_the_model() {
    let experiment = |by: &str| {
        let experiment = Experiment::new(recording(|t| 2.0 * (-K * t).exp())).output("x", "x");
        experiment.initial_state("k", InitialState::named("k", by).unwrap())
    };
    let fit = |experiment: Experiment| {
        let fmu = Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
        let start = Parameter::new("x", 1.0).bounds(0.1, 10.0);
        let builder = Calibration::builder(fmu).experiment(experiment).parameter(start);
        builder.build()?.fit(FitOptions::default())
    };
    let found = fit(experiment("Measured: x")).unwrap();
    assert!((found.x[0] - 2.0).abs() < 1e-4, "{:?}", found.x);
    let message = fit(experiment("measured:y")).unwrap_err().to_string();
    assert!(message.contains("no column is compared with 'y'"), "{message}");
    for word in ["first", "measured:", "measures:x"] {
        let message = InitialState::named("k", word).unwrap_err().to_string();
        assert!(message.contains(&format!("initial_states: 'k' = '{word}' must be")), "{message}");
    }
    // A name without a column is a state.
    let decay = Experiment::new(recording(|t| (-K * t).exp())).output("x", "x");
    let message = fit(decay.initial_state("k", InitialState::Measured)).unwrap_err().to_string();
    assert!(message.contains("initial state 'k' is not a state"), "{message}");
}

/// The noise of the measurement at the start changes the whole simulation. The standard errors must include
/// it.
#[test]
fn standard_errors_include_the_noise_of_a_measured_start() {
    let mut state = 3_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let fmu = Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let (mut squares, mut offsets) = (0.0, 0);
    let n = 60;
    for _ in 0..n {
        let mut noise = || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        let mut calibration = Calibration::builder(fmu.clone()).parameter(k());
        for _ in 0..2 {
            let x: Vec<f64> = times().iter().map(|t| (-K * t).exp() + 0.02 * noise()).collect();
            let data = Data::from_columns(times(), [("x".to_owned(), x)]).unwrap();
            let experiment = Experiment::new(data).output("x", "x");
            calibration = calibration.experiment(experiment.initial_state("x", InitialState::Measured));
        }
        let fit = calibration.build().unwrap().fit(FitOptions::default()).unwrap();
        let uncertainty = fit.uncertainty.unwrap();
        offsets += u32::from(uncertainty.verdict().iter().any(|text| text.contains("an offset")));
        squares += ((fit.x[0] - K) / uncertainty.standard_errors[0]).powi(2);
    }
    // For 60 fits, the mean square is 1 +- 0.18. Without the noise of the start, it would be 1.9.
    let mean = squares / f64::from(n);
    assert!((0.55..1.5).contains(&mean), "{mean}");
    // The effect of the noise is not reported as an offset.
    assert!(offsets == 0, "{offsets}");
}

/// Returns x' = -k x whose state is 3 after the initialization, independent of the given value.
fn computing(is_co_simulation: bool) -> tempfile::TempDir {
    let folder = faulty(&["COMPUTES_X=3"]);
    let path = folder.path().join("modelDescription.xml");
    let xml = std::fs::read_to_string(&path)
        .unwrap()
        .replace("initial=\"exact\"><Real start=\"1\"", "initial=\"approx\"><Real start=\"1\"");
    let interface =
        "<CoSimulation modelIdentifier=\"evil\" canHandleVariableCommunicationStepSize=\"true\"/>";
    let xml = match is_co_simulation {
        true => xml.replace("<ModelExchange modelIdentifier=\"evil\"/>", interface),
        false => xml,
    };
    std::fs::write(&path, xml).unwrap();
    folder
}

/// Returns the calibration of `k` to a decay from 2 with k = 0.7.
fn calibration_of(
    folder: &tempfile::TempDir,
    complete: impl FnOnce(Experiment) -> Experiment,
) -> Result<Calibration, CalibrationError> {
    let experiment = Experiment::new(recording(|t| 2.0 * (-0.7 * t).exp())).output("x", "x");
    Calibration::builder(Fmu::open(folder.path()).unwrap())
        .experiment(complete(experiment))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 3.0))
        .settings(RunSettings { relative_tolerance: Some(1e-9), ..RunSettings::default() })
        .build()
}

#[test]
fn state_that_the_model_computes_is_set_after_the_initialization() {
    let folder = computing(false);
    let start = Parameter::new("x0", 1.0).bounds(0.5, 5.0);
    for initial in [InitialState::Value(2.0), InitialState::Measured, start.into()] {
        let calibration =
            calibration_of(&folder, |experiment| experiment.initial_state("x", initial.clone())).unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        assert!((fit.x[0] - 0.7).abs() < 1e-4, "{initial:?}: {:?}", fit.x);
        assert!(fit.x.get(1).is_none_or(|x0| (x0 - 2.0).abs() < 1e-4), "{:?}", fit.x);
    }
}

#[test]
fn state_without_effect_is_an_error_or_a_finding() {
    let is_reported = |calibration: &Calibration| {
        let sentence = "x was set to the start value 2, but is 3 after the initialization";
        let fit = calibration.fit(FitOptions::default()).unwrap();
        let in_check = calibration.check().findings.iter().any(|f| f.sentence.starts_with(sentence));
        in_check && fit.findings().iter().any(|f| f.sentence.starts_with(sentence))
    };
    let co_simulation = computing(true);
    let given = |folder: &tempfile::TempDir, initial: Option<InitialState>| {
        calibration_of(folder, |experiment| match initial {
            Some(initial) => experiment.initial_state("x", initial),
            None => experiment.start_value("x", 2.0),
        })
        .unwrap()
    };
    assert!(is_reported(&given(&computing(false), None)));
    assert!(is_reported(&given(&co_simulation, None)));
    assert!(is_reported(&given(&co_simulation, Some(InitialState::Value(2.0)))));
    let start = Parameter::new("x0", 1.0).bounds(0.5, 5.0);
    for initial in [InitialState::Measured, start.into()] {
        let calibration = given(&co_simulation, Some(initial));
        let error = calibration.fit(FitOptions::default()).unwrap_err().to_string();
        assert!(error.contains("x starts at 3 instead of"), "{error}");
    }
}

/// `x' = -k x` from a measured start. The errors of k and of the curve must equal the errors of the delta
/// method. The test covers every cost that is equivalent to least squares.
#[test]
fn measured_start_has_delta_method_errors_with_every_objective() {
    let n = 21;
    let t: Vec<f64> = (0..n).map(|i| 0.1 * f64::from(i)).collect();
    // The noise appears random because it samples distant phases of a sine.
    let noise = |i: usize| 0.02 * (((i as f64 * 12.9898).sin() * 43758.5453).abs().fract() - 0.5);
    let x: Vec<f64> = t.iter().enumerate().map(|(i, t)| (-K * t).exp() + noise(i)).collect();
    let wide = RobustLoss::new(Loss::Huber, 1e6).unwrap();
    let likelihood = CostKind::Named(NamedCost::Likelihood);
    for (objective, loss, weight) in [
        (CostKind::SumOfSquares, RobustLoss::default(), 1.0),
        (CostKind::SumOfSquares, RobustLoss::default(), 100.0),
        (likelihood.clone(), RobustLoss::default(), 1.0),
        (likelihood, RobustLoss::default(), 100.0),
        (CostKind::SumOfSquares, wide, 100.0),
    ] {
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x.clone())]).unwrap();
        let experiment = Experiment::new(data).weighted_output("x", "x", Weight::Constant(weight));
        let calibration = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
            .experiment(experiment.initial_state("x", InitialState::Measured))
            .parameter(k())
            .settings(RunSettings { relative_tolerance: Some(1e-10), ..RunSettings::default() })
            .build()
            .unwrap();
        let fit = calibration.fit(FitOptions { objective, loss, ..FitOptions::default() }).unwrap();
        let uncertainty = fit.uncertainty.as_ref().unwrap();
        assert_eq!(uncertainty.autocorrelations, [0.0]);
        assert_eq!(uncertainty.degrees_of_freedom, f64::from(n) - 2.0);
        // Let j be the derivative with respect to k, c with respect to the start, and e the residuals. The
        // step is -j'(e + c e_0) / j'j.
        let (k, x0) = (fit.x[0], x[0]);
        let curve: Vec<[f64; 3]> =
            t.iter().map(|t| (-k * t).exp()).zip(&t).map(|(c, t)| [-t * x0 * c, c, x0 * c]).collect();
        let dot = |a: usize, b: usize| curve[1..].iter().map(|row| row[a] * row[b]).sum::<f64>();
        let (jj, jc, cc) = (dot(0, 0), dot(0, 1), dot(1, 1));
        // The variance equals the variance of a fit of k and the start to all n measurements.
        let r: Vec<f64> = curve[1..].iter().zip(&x[1..]).map(|(row, x)| row[2] - x).collect();
        let with = |a: usize| curve[1..].iter().zip(&r).map(|(row, r)| row[a] * r).sum::<f64>();
        let (jr, cr, of_start) = (with(0), with(1), cc + 1.0);
        let taken = (jr * jr * of_start - 2.0 * jr * cr * jc + cr * cr * jj) / (jj * of_start - jc * jc);
        let variance = (r.iter().map(|r| r * r).sum::<f64>() - taken) / (f64::from(n) - 2.0);
        let of_rate = variance * (1.0 / jj + (jc / jj).powi(2));
        let ratio = uncertainty.standard_errors[0] / of_rate.sqrt();
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
        let options = BandOptions { times: Some(vec![0.0, 0.3, 2.0]), ..BandOptions::default() };
        let band = calibration.prediction_bands(&fit, &options, &RunContext::new()).unwrap().swap_remove(0);
        for (t, got) in [0.0, 0.3, 2.0_f64].iter().zip(&band.standard_errors) {
            let c = (-k * t).exp();
            let j = -t * x0 * c;
            let expected = (variance * (j * j / jj + (c - j * jc / jj).powi(2))).sqrt();
            assert!((got / expected - 1.0).abs() < 0.02, "{t}: {got} {expected}");
        }
    }
}
