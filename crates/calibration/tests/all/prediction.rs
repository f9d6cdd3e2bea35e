//! Prediction bands compared with their closed form, and cross-validation by recording.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    BandOptions, Calibration, CrossValidationOptions, Data, Experiment, FitOptions, Parameter, Scale,
};
use dfo::{Loss, RobustLoss};
use example_models::example_fmu;

/// Alternating noise, which is nearly independent of the parameters.
fn noise(i: usize) -> f64 {
    [3e-3, -4e-3, -2e-3, 3e-3][i % 4]
}

/// x' = -k x from x0, every 0.1 s, with noise.
fn recording(k: f64, x0: f64) -> Experiment {
    let t: Vec<f64> = (0..40).map(|i| i as f64 / 10.0).collect();
    let x = t.iter().enumerate().map(|(i, t)| x0 * (-k * t).exp() + noise(i)).collect();
    Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x")
}

fn calibration(experiments: Vec<Experiment>, is_local: bool) -> Calibration {
    let fmu = fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let builder = Calibration::builder(fmu)
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .parameter(Parameter::new("x", 1.5).bounds(0.1, 10.0).local(is_local));
    experiments.into_iter().fold(builder, |builder, e| builder.experiment(e)).build().unwrap()
}

#[test]
fn band_matches_delta_method() {
    let calibration = calibration(vec![recording(2.0, 1.0)], false);
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    let times = vec![0.0, 0.3, 1.0, 2.5];
    let options = BandOptions { times: Some(times.clone()), ..BandOptions::default() };
    let [band] = &calibration.prediction_bands(&fit, &options, &RunContext::new()).unwrap()[..] else {
        panic!()
    };
    let (k, x0) = (fit.x[0], fit.x[1]);
    for (i, t) in times.iter().enumerate() {
        let decay = (-k * t).exp();
        let gradient = [-t * x0 * decay, decay];
        let variance: f64 =
            (0..4).map(|e| gradient[e / 2] * uncertainty.covariance[e] * gradient[e % 2]).sum();
        assert!((band.values[i] - x0 * decay).abs() < 1e-5);
        assert!((band.standard_errors[i] / variance.sqrt() - 1.0).abs() < 2e-2, "{band:?} {variance}");
        // Student's t with 38 degrees of freedom.
        let (half, of_measured) = (band.upper[i] - band.values[i], band.measured_upper[i] - band.values[i]);
        assert!((half / (2.02439 * band.standard_errors[i]) - 1.0).abs() < 1e-4, "{half}");
        let whole = 2.02439 * (band.standard_errors[i].powi(2) + band.noise[i].powi(2)).sqrt();
        assert!((of_measured / whole - 1.0).abs() < 1e-4);
        assert!((band.lower[i] + band.upper[i] - 2.0 * band.values[i]).abs() < 1e-12);
    }
    assert!(band.noise.iter().all(|sd| (sd - fit.rms * (40.0_f64 / 38.0).sqrt()).abs() < 1e-9));
    // The result is the same for any number of workers, and narrower for a lower level.
    let one = BandOptions { workers: Some(1), ..options.clone() };
    assert_eq!(&calibration.prediction_bands(&fit, &one, &RunContext::new()).unwrap()[0], band);
    let half = BandOptions { level: 0.5, ..options };
    assert!(
        calibration.prediction_bands(&fit, &half, &RunContext::new()).unwrap()[0].upper[2] < band.upper[2]
    );
}

#[test]
fn band_is_the_same_on_log_and_linear_scale() {
    let band = |scale, has_bounds| {
        let bounded = |p: Parameter| if has_bounds { p.bounds(1e-3, 1e3) } else { p };
        let calibration = Calibration::builder(fmi::Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
            .parameter(bounded(Parameter::new("k", 1.0).scale(scale)))
            .parameter(bounded(Parameter::new("x", 1.5).scale(scale)))
            .experiment(recording(2.0, 1.0))
            .build()
            .unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        calibration
            .prediction_bands(&fit, &BandOptions::default(), &RunContext::new())
            .unwrap()
            .swap_remove(0)
    };
    let expected = band(Scale::Linear, true);
    for has_bounds in [true, false] {
        let found = band(Scale::Log, has_bounds);
        for (got, expected) in found.standard_errors.iter().zip(&expected.standard_errors) {
            assert!((got / expected - 1.0).abs() < 0.03, "{got} instead of {expected}");
        }
        assert!(found.lower.iter().zip(&found.upper).all(|(low, high)| low < high));
    }
}

#[test]
fn band_is_rejected_without_degrees_of_freedom() {
    let calibration = calibration(vec![recording(2.0, 1.0).window(0.0, 0.1)], false);
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert_eq!(fit.uncertainty.as_ref().unwrap().degrees_of_freedom, 0.0);
    let error = calibration.prediction_bands(&fit, &BandOptions::default(), &RunContext::new()).unwrap_err();
    assert!(error.to_string().contains("2 residuals are not more than the fitted parameters"), "{error}");
}

#[test]
fn held_out_local_parameters_are_fitted_with_the_loss_of_the_fit() {
    let with_outliers = |k: f64, x0: f64| {
        let t: Vec<f64> = (0..40).map(|i| i as f64 / 10.0).collect();
        let off = |i: usize| if i % 8 == 1 { 3.0 } else { noise(i) };
        let x = t.iter().enumerate().map(|(i, t)| x0 * (-k * t).exp() + off(i)).collect();
        Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x")
    };
    let recordings = vec![recording(2.0, 1.0), recording(2.0, 2.0), with_outliers(2.0, 2.5)];
    let calibration = calibration(recordings, true);
    let loss = RobustLoss::new(Loss::Cauchy, 0.02).unwrap();
    let found = calibration
        .cross_validate(
            &CrossValidationOptions { loss, ..CrossValidationOptions::default() },
            &RunContext::new(),
        )
        .unwrap();
    let of_third = &found.folds[2].validation;
    assert!((of_third.x[1] - 2.5).abs() < 0.02, "{found}");
    // Both columns use plain residuals, because the first fold was fitted to the recording with the outliers.
    let outliers = (5.0 * 9.0 / 80.0_f64).sqrt();
    assert!((found.folds[0].fit_rms / outliers - 1.0).abs() < 0.05, "{found}");
    assert!((of_third.rms / (5.0 * 9.0 / 40.0_f64).sqrt() - 1.0).abs() < 0.05, "{found}");
}

#[test]
fn band_error_reports_the_reason() {
    let calibration = calibration(vec![recording(2.0, 1.0)], false);
    let fit = calibration.fit(FitOptions::default()).unwrap();
    let without = calibration.fit(FitOptions { uncertainty: None, ..FitOptions::default() }).unwrap();
    let options = BandOptions::default();
    for (fit, options, expected) in [
        (&fit, BandOptions { level: 95.0, ..options.clone() }, "between 0 and 1"),
        (
            &fit,
            BandOptions { outputs: Some(vec!["y".to_owned()]), ..options.clone() },
            "output 'y' not found; available: x",
        ),
        (&without, options.clone(), "requires the covariance"),
    ] {
        let error = calibration.prediction_bands(fit, &options, &RunContext::new()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(calibration.prediction_bands(&fit, &options, &RunContext::new().polling(&|| true)).is_err());
}

#[test]
fn cross_validation_leaves_each_recording_out_once() {
    let recordings = vec![recording(2.0, 1.0), recording(2.05, 2.0), recording(2.0, 3.0).named("third")];
    let calibration = calibration(recordings, true);
    let found = calibration.cross_validate(&CrossValidationOptions::default(), &RunContext::new()).unwrap();
    let names: Vec<_> = found.folds.iter().map(|fold| fold.held_out.join(" ")).collect();
    assert_eq!(names, ["run1", "run2", "third"]);
    assert_eq!(found.folds[0].fit.names, ["k", "x[run2]", "x[third]"]);
    // The initial state of the omitted recording is fitted to it.
    assert_eq!(found.folds[2].validation.names, ["k", "x[third]"]);
    assert!((found.folds[2].validation.x[1] - 3.0).abs() < 0.05, "{found}");
    assert!(found.folds[1].validation.rms > found.folds[0].validation.rms, "{found}");
    let [(name, mean, spread)] = &found.parameters[..] else { panic!("{found}") };
    assert!(name == "k" && (mean - 2.02).abs() < 0.02 && *spread > 1e-3 && *spread < 0.05, "{found}");
    let sum: f64 = found.folds.iter().map(|f| f.validation.rms.powi(2) / 3.0).sum();
    assert!((found.rms / sum.sqrt() - 1.0).abs() < 1e-9);
    assert_eq!(found.to_string().lines().count(), 7, "{found}");
    assert!(found.to_string().ends_with("determines them: x[run1], x[run2], x[third]"), "{found}");
    // With two folds, each fold holds out every second recording. The result is independent of the workers.
    let mut options = CrossValidationOptions { folds: Some(2), ..CrossValidationOptions::default() };
    options.run.workers = Some(1);
    let two = calibration.cross_validate(&options, &RunContext::new()).unwrap();
    assert_eq!(two.folds[0].held_out, ["run1", "third"]);
    options.run.workers = Some(4);
    let again = calibration.cross_validate(&options, &RunContext::new()).unwrap();
    assert_eq!(again.rms.to_bits(), two.rms.to_bits());
}

#[test]
fn cross_validation_rejects_invalid_folds() {
    let one = calibration(vec![recording(2.0, 1.0)], false);
    let error =
        one.cross_validate(&CrossValidationOptions::default(), &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("at least two experiments, but there is one"), "{error}");
    let two = calibration(vec![recording(2.0, 1.0), recording(2.0, 2.0)], true);
    for folds in [0, 1, 3] {
        let options = CrossValidationOptions { folds: Some(folds), ..CrossValidationOptions::default() };
        let error = two.cross_validate(&options, &RunContext::new()).unwrap_err().to_string();
        assert!(
            error.contains(&format!("folds = {folds} must be from 2 to the number of recordings, 2")),
            "{error}"
        );
    }
    let error = two
        .cross_validate(&CrossValidationOptions::default(), &RunContext::new().polling(&|| true))
        .unwrap_err();
    assert!(matches!(error, calibration::CalibrationError::Cancelled));
}

/// A new measurement has the noise that the weight of its row declares.
#[test]
fn band_of_new_measurements_includes_noise_of_each_row() {
    let sd = |i: usize| if i < 20 { 0.001 } else { 0.1 };
    let t: Vec<f64> = (0..40).map(|i| i as f64 / 10.0).collect();
    let x: Vec<f64> = t.iter().enumerate().map(|(i, t)| (-2.0 * t).exp() + sd(i) / 0.1 * noise(i)).collect();
    let data = Data::from_columns(t.clone(), [("x".to_owned(), x)]).unwrap();
    let weights = calibration::Weight::Rows((0..40).map(|i| 1.0 / sd(i)).collect());
    let one = calibration(vec![Experiment::new(data).weighted_output("x", "x", weights)], false);
    let fit = one.fit(FitOptions::default()).unwrap();
    let options = BandOptions { times: Some(vec![0.5, 1.95, 3.0]), ..BandOptions::default() };
    let band = one.prediction_bands(&fit, &options, &RunContext::new()).unwrap().swap_remove(0);
    let found = fit.rms * (40.0_f64 / 38.0).sqrt();
    for (got, sd) in band.noise.iter().zip([0.001, 0.0505, 0.1]) {
        assert!((got / (found * sd) - 1.0).abs() < 1e-9, "{got}");
    }
    // Two recordings with different weights have separate noise.
    let recorded = |k: f64, sd: f64| {
        let x = t.iter().enumerate().map(|(i, t)| (-k * t).exp() + sd / 0.01 * noise(i)).collect();
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x)]).unwrap();
        Experiment::new(data).weighted_output("x", "x", calibration::Weight::Constant(1.0 / sd))
    };
    let two = calibration(vec![recorded(2.0, 0.001), recorded(2.0, 0.1)], false);
    let fit = two.fit(FitOptions::default()).unwrap();
    let bands = two.prediction_bands(&fit, &options, &RunContext::new()).unwrap();
    let ratio = bands[1].noise[0] / bands[0].noise[0];
    assert!((50.0..200.0).contains(&ratio), "{ratio}");
}
