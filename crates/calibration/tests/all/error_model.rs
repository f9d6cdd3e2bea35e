//! Noise that depends on the simulated values: `sigma = a + b*abs(y)`.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support::normal;
use calibration::RunContext;
use calibration::{
    BandOptions, BootstrapOptions, Calibration, CostKind, Data, Experiment, Fit, FitNoise, FitOptions,
    ModelledNoise, NamedCost, NoiseRule, Parameter, ProfileOptions, SavedFit, Sigma, ValidationSet, Weight,
};
use dfo::{LeastSquares, Loss, NelderMead, RobustLoss, RunOptions, Tolerances, Value};
use example_models::example_fmu;
use fmi::Fmu;

fn times() -> Vec<f64> {
    (0..51).map(|i| 0.05 * f64::from(i)).collect()
}

/// Measurements of a decay from `x0` with this rate, whose noise has the standard deviation `a + b y`.
fn decay(seed: u64, [x0, k]: [f64; 2], [a, b]: [f64; 2]) -> Vec<f64> {
    let mut normal = normal(seed);
    let simulated = times().into_iter().map(|t| x0 * (-k * t).exp());
    simulated.map(|y| y + (a + b * y) * normal()).collect()
}

fn experiment(x: Vec<f64>, sigma: &str) -> Experiment {
    let data = Data::from_columns(times(), [("x".to_owned(), x)]).unwrap();
    Experiment::new(data).weighted_output("x", "x", Weight::of_sigma(sigma, "x").unwrap())
}

/// Calibration of the start value alone, which is a linear parameter, or also of the rate.
fn calibration(x: Vec<f64>, sigma: &str, has_rate: bool) -> Calibration {
    let fmu = Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let experiment = experiment(x, sigma);
    let x = Parameter::new("x", 1.0).bounds(0.1, 50.0);
    let builder = match has_rate {
        true => Calibration::builder(fmu)
            .experiment(experiment)
            .parameter(Parameter::new("k", 0.8).bounds(0.01, 50.0)),
        false => Calibration::builder(fmu).experiment(experiment.start_value("k", 1.0)),
    };
    builder.parameter(x).build().unwrap()
}

fn accurate() -> FitOptions<'static> {
    let tolerances = Tolerances { x_tol: 1e-9, f_tol: 1e-13, ..Tolerances::default() };
    let method = LeastSquares::default().into();
    RunOptions { method, tolerances, workers: Some(1), seed: Some(3), ..FitOptions::default_run() }.into()
}

fn modelled(fit: &Fit) -> &ModelledNoise {
    &fit.noise.as_ref().unwrap().models()[0]
}

/// The start of a decay is a linear parameter, so each round is a weighted linear regression.
#[test]
fn stated_error_model_reaches_the_fixed_point_of_weighted_regression() {
    let [a, b] = [0.02, 0.2];
    let y = decay(3, [3.0, 1.0], [a, b]);
    let basis: Vec<f64> = times().iter().map(|t| (-t).exp()).collect();
    let regression = |x: f64| {
        let weights = basis.iter().map(|basis| (a + b * x * basis).powi(-2));
        let sums = weights.zip(&basis).zip(&y).map(|((w, basis), y)| (w * basis * basis, w * basis * y));
        sums.fold((0.0, 0.0), |(bb, by), (term, and)| (bb + term, by + and))
    };
    let mut x = 1.0;
    for _ in 0..200 {
        let (bb, by) = regression(x);
        x = by / bb;
    }
    let calibration = calibration(y.clone(), "0.02 + 0.2*abs(y)", false);
    let fit = calibration.fit(accurate()).unwrap();
    let noise = fit.noise.as_ref().unwrap().estimated().unwrap();
    assert!(noise.is_settled && noise.n_rounds <= 6 && noise.is_known, "{fit}");
    assert!((fit.x[0] / x - 1.0).abs() < 3e-6, "{} {x}", fit.x[0]);
    // Standard errors are absolute.
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    let error = regression(x).0.powf(-0.5);
    assert!(uncertainty.is_noise_known(), "{fit}");
    assert!((uncertainty.standard_errors[0] / error - 1.0).abs() < 1e-3, "{error}");
    assert!(
        fit.to_string().contains("known (sigma) in ") && fit.to_string().contains("0.02 + 0.2*abs(y)"),
        "{fit}"
    );
    // Chi-square and criteria have the weights of the fit.
    let sigma: Vec<f64> = basis.iter().map(|basis| a + b * x * basis).collect();
    let chisqr: f64 = basis.iter().zip(&y).zip(&sigma).map(|((b, y), s)| ((x * b - y) / s).powi(2)).sum();
    let goodness = fit.goodness();
    assert!((goodness.chisqr / chisqr - 1.0).abs() < 1e-4 && (fit.cost / chisqr - 1.0).abs() < 1e-4, "{fit}");
    let aic = chisqr + 2.0 * sigma.iter().map(|s| s.ln()).sum::<f64>() + 2.0;
    assert!((goodness.aic - aic).abs() < 1e-2 && goodness.p_value.is_some(), "{} {aic}", goodness.aic);
    // A different method has the same result.
    let simplex = FitOptions {
        run: RunOptions { method: NelderMead::default().into(), ..accurate().run },
        ..accurate()
    };
    assert!((calibration.fit(simplex).unwrap().x[0] / x - 1.0).abs() < 1e-5);
}

#[test]
fn later_analyses_use_the_standard_deviations_of_the_fit() {
    let [a, b] = [0.02, 0.1];
    for (text, is_known) in [("0.02 + 0.1*abs(y)", true), ("a + b*abs(y)", false)] {
        let calibration = calibration(decay(4, [3.0, 1.0], [a, b]), text, true);
        let fit = calibration.fit(accurate()).unwrap();
        let uncertainty = fit.uncertainty.as_ref().unwrap();
        assert_eq!(uncertainty.is_noise_known(), is_known);
        let context = RunContext::new();
        let intervals = uncertainty.confidence_intervals(0.95).unwrap();
        let profile = calibration.profile(&fit, &ProfileOptions::default(), &context).unwrap();
        for (parameter, (low, high)) in profile.parameters.iter().zip(&intervals) {
            let asymptotic = parameter.interval();
            assert!(
                ((asymptotic.1 - asymptotic.0) / (high - low)).ln().abs() < 0.05,
                "{asymptotic:?} {low} {high}"
            );
        }
        let sigma = |y: f64| modelled(&fit).a + modelled(&fit).b * y;
        let band = &calibration.prediction_bands(&fit, &BandOptions::default(), &context).unwrap()[0];
        for (noise, y) in band.noise.iter().zip(&band.values) {
            assert!((noise / sigma(*y) - 1.0).abs() < 0.03, "{noise} {}", sigma(*y));
        }
        let options =
            BootstrapOptions { n: 60, seed: Some(2), workers: Some(1), ..BootstrapOptions::default() };
        let bootstrap = calibration.bootstrap(&fit, &options, &context).unwrap();
        for (standard_error, error) in bootstrap.standard_errors().iter().zip(&uncertainty.standard_errors) {
            assert!((standard_error / error).ln().abs() < 0.4, "{standard_error} {error}");
        }
        let layout = fit.residual_layout(&calibration);
        let weights = layout.outputs[0].weights.iter().zip(&band.values);
        assert!(weights.into_iter().all(|(w, y)| (w * sigma(*y) - 1.0).abs() < 1e-3));
        let other = ValidationSet::Experiments(vec![experiment(decay(5, [3.0, 1.0], [a, b]), text)]);
        let validation = calibration.validate(&fit, &other, &context).unwrap();
        assert!((validation.rms).ln().abs() < 0.5, "{validation}");
        let saved = SavedFit::from_bytes(&fit.to_bytes(&calibration).unwrap(), "fit").unwrap();
        assert_eq!(saved.fit, fit);
    }
}

#[test]
fn fits_with_error_models_are_compared_by_their_criteria() {
    let y = || decay(4, [3.0, 1.0], [0.0, 0.2]);
    let fit = |text| calibration(y(), text, true).fit(accurate()).unwrap();
    let [constant, relative, weighted] = ["a + 0.0001*abs(y)", "b*abs(y)", "0.1"].map(fit);
    let comparison = constant.compare(&relative).unwrap();
    assert!(comparison.f.is_none() && comparison.fits[0].aic > comparison.fits[1].aic + 20.0, "{comparison}");
    assert!(relative.compare(&weighted).unwrap_err().contains("error model"));
}

#[test]
fn fitted_error_model_is_the_maximum_of_its_likelihood() {
    let calibration = calibration(decay(6, [3.0, 1.0], [0.05, 0.1]), "a + b*abs(y)", true);
    let fit = calibration.fit(accurate()).unwrap();
    let noise = modelled(&fit);
    let found: Vec<(&str, f64)> = noise.coefficients().collect();
    assert!(found == [("a", noise.a), ("b", noise.b)] && noise.is_of_residuals, "{fit}");
    assert!(fit.to_string().contains("sigma of x a + b*abs(y), a = "), "{fit}");
    // The two are correlated; the noise at y = 1 is determined better.
    assert!(((noise.a + noise.b) / 0.15).ln().abs() < 0.25, "{found:?}");
    // The weighted squares and the free rows agree: sum r^2 = N - p.
    assert!((fit.cost / 49.0 - 1.0).abs() < 1e-3, "{}", fit.cost);
    assert!(!fit.noise.as_ref().is_some_and(FitNoise::is_known));
}

/// The noise of another recording of the variable is estimated separately. Parameters are local, so the fit
/// of the first recording is independent of the second.
#[test]
fn estimated_noise_of_another_recording_does_not_change_an_error_model() {
    let y = || decay(4, [3.0, 1.0], [0.02, 0.05]);
    let fit = |others: &[&str], rule: NoiseRule| {
        let mut builder = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap());
        for sigma in ["a + b*abs(y)"].iter().chain(others) {
            builder = builder.experiment(experiment(y(), sigma).start_value("k", 1.0));
        }
        let x = Parameter::new("x", 1.0).bounds(0.1, 50.0).local(true);
        let calibration = builder.parameter(x).build().unwrap();
        calibration.fit(FitOptions { noise: rule, ..accurate() }).unwrap()
    };
    let alone = fit(&[], NoiseRule::Auto);
    let beside = fit(&["log"], NoiseRule::Estimated);
    assert!((beside.x[0] / alone.x[0] - 1.0).abs() < 1e-3, "{alone}\n{beside}");
    let (alone_model, other) = (modelled(&alone), modelled(&beside));
    assert!((other.b / alone_model.b).ln().abs() < 0.05, "{alone}\n{beside}");
    assert!(beside.noise.as_ref().unwrap().estimated().unwrap().outputs.len() == 1, "{beside}");
}

#[test]
fn error_models_report_unsupported_combinations() {
    let y = || decay(6, [3.0, 1.0], [0.05, 0.1]);
    let of = |text: &str| calibration(y(), text, true);
    let robust = RobustLoss::new(Loss::Huber, 1.0).unwrap();
    let likelihood = CostKind::Named(NamedCost::Likelihood);
    for options in
        [FitOptions { loss: robust, ..accurate() }, FitOptions { objective: likelihood, ..accurate() }]
    {
        let error = of("a + b*abs(y)").fit(options).unwrap_err().to_string();
        assert!(error.contains("sigma 'a + b*abs(y)' depends on simulated values"), "{error}");
    }
    let error = Weight::of_sigma("0.1 + abs(y", "x").unwrap_err().to_string();
    assert!(error.contains("sigma of column 'x': '0.1 + abs(y' is not an error model"), "{error}");
    assert_eq!(Weight::of_sigma("sd", "x").unwrap(), Sigma::Column("sd".to_owned()).into());
    // Problem files accept the same strings.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.csv"), "time,x\n0,1\n1,0.5\n2,0.2\n").unwrap();
    let read = |sigma: &str| {
        let text = |text: &str| Value::Text(text.to_owned());
        let outputs = Value::Record([("x".to_owned(), text("x"))].into());
        let sigma = Value::Record([("x".to_owned(), text(sigma))].into());
        let record = [("data", text("a.csv")), ("outputs", outputs), ("sigma", sigma)];
        let record = record.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        Experiment::from_record(&record, folder.path(), &RunContext::new())
    };
    for sigma in ["0.1", "a + b*abs(y)", "log"] {
        assert!(read(sigma).is_ok(), "{sigma}");
    }
    assert!(read("2*abs(z)").unwrap_err().to_string().contains("sigma of column 'x'"));
    let fmu = Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
    let resampled = experiment(y(), "0.1 + 0.1*y").resample(0.5);
    let built = Calibration::builder(fmu).experiment(resampled).parameter(Parameter::new("k", 1.0)).build();
    assert!(built.unwrap_err().to_string().contains("resample changes the noise"));
}

/// Measurements of a decay with log-normal noise of this size.
fn log_decay(seed: u64, [x0, k]: [f64; 2], sd: f64) -> Vec<f64> {
    let mut normal = normal(seed);
    times().into_iter().map(|t| x0 * (sd * normal() - k * t).exp()).collect()
}

/// The logarithm of a decay is a line, so the fit is a linear regression of logarithms.
#[test]
fn log_normal_noise_is_fitted_as_a_regression_of_logarithms() {
    let y = log_decay(2, [3.0, 1.0], 0.2);
    let (t, n) = (times(), 51.0);
    let logarithms: Vec<f64> = y.iter().map(|y| y.ln()).collect();
    let mean = |of: &[f64]| of.iter().sum::<f64>() / n;
    let (middle, height) = (mean(&t), mean(&logarithms));
    let spread: f64 = t.iter().map(|t| (t - middle).powi(2)).sum();
    let slope = t.iter().zip(&logarithms).map(|(t, l)| (t - middle) * (l - height)).sum::<f64>() / spread;
    let squares: f64 =
        t.iter().zip(&logarithms).map(|(t, l)| (l - height - slope * (t - middle)).powi(2)).sum();
    let calibration = calibration(y.clone(), "log", true);
    let fit = calibration.fit(accurate()).unwrap();
    assert!((fit.x[0] / -slope - 1.0).abs() < 1e-4, "{} {slope}", fit.x[0]);
    assert!((fit.x[1].ln() - (height - slope * middle)).abs() < 1e-4, "{fit}");
    assert!((fit.cost / squares - 1.0).abs() < 1e-4, "{} {squares}", fit.cost);
    let error = (squares / 49.0 / spread).sqrt();
    let errors = &fit.uncertainty.as_ref().unwrap().standard_errors;
    assert!((errors[0] / error - 1.0).abs() < 1e-3, "{} {error}", errors[0]);
    // Quality, curves and bands are in the unit of the variable.
    let context = RunContext::new();
    let simulated: Vec<f64> = t.iter().map(|t| fit.x[1] * (-fit.x[0] * t).exp()).collect();
    let rms = (simulated.iter().zip(&y).map(|(s, y)| (s - y).powi(2)).sum::<f64>() / n).sqrt();
    assert!((fit.outputs[0].rms / rms - 1.0).abs() < 1e-4 && fit.outputs[0].is_log, "{fit}");
    let curve = &calibration.curves(&fit, &context).unwrap()[0].outputs[0];
    assert!(curve.measured.values.iter().zip(&y).all(|(a, b)| (a / b - 1.0).abs() < 1e-12));
    assert!(curve.residuals.iter().zip(&y).zip(&simulated).all(|((r, y), s)| (r - (s - y)).abs() < 1e-3));
    let band = &calibration.prediction_bands(&fit, &BandOptions::default(), &context).unwrap()[0];
    let relative = (squares / 49.0).sqrt();
    assert!(band.noise.iter().zip(&band.values).all(|(noise, y)| (noise / y / relative - 1.0).abs() < 0.05));
    let options = BootstrapOptions { n: 60, seed: Some(2), workers: Some(1), ..BootstrapOptions::default() };
    let bootstrap = calibration.bootstrap(&fit, &options, &context).unwrap();
    assert!((bootstrap.standard_errors()[0] / error).ln().abs() < 0.35, "{bootstrap}");
    let profile = calibration.profile(&fit, &ProfileOptions::default(), &context).unwrap();
    let (low, high) = profile.parameters[0].interval();
    assert!(((high - low) / error / 4.02).ln().abs() < 0.03, "{low} {high} {error}");
    // With the likelihood, the deviation of the logarithms is estimated.
    let likelihood = FitOptions {
        objective: CostKind::Named(NamedCost::Likelihood),
        run: RunOptions {
            tolerances: accurate().run.tolerances,
            workers: Some(1),
            ..FitOptions::default_run()
        },
        ..FitOptions::default()
    };
    assert!((calibration.fit(likelihood).unwrap().x[0] / fit.x[0] - 1.0).abs() < 1e-4);
}

/// The noise of logarithms is unknown. They have no weight relative to values with a known sigma.
#[test]
fn logarithms_and_values_of_one_variable_are_rejected_together() {
    let y = log_decay(2, [3.0, 1.0], 0.2);
    let build = |sigmas: [&str; 2]| {
        let builder = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap());
        let both =
            sigmas.iter().fold(builder, |builder, sigma| builder.experiment(experiment(y.clone(), sigma)));
        both.parameter(Parameter::new("k", 0.8).bounds(0.01, 50.0)).build()
    };
    for sigmas in [["log", "0.1"], ["0.1", "log"], ["log", "0.1 + 0.1*abs(y)"]] {
        let error = build(sigmas).unwrap_err().to_string();
        let expected = "sigma of 'x' is 'log' for column 'x' of experiment 'run";
        assert!(error.contains(expected) && error.contains("Use 'log' for both"), "{error}");
    }
    assert!(build(["log", "log"]).unwrap().fit(accurate()).is_ok());
    // A fitted error model is weighed against logarithms only if the noise of both is estimated.
    let fitted = build(["log", "a + b*abs(y)"]).unwrap();
    let error = fitted.fit(accurate()).unwrap_err().to_string();
    assert!(error.contains("with noise 'estimated'"), "{error}");
    fitted.fit(FitOptions { noise: NoiseRule::Estimated, ..accurate() }).unwrap();
}

#[test]
fn log_normal_noise_rejects_values_that_are_not_positive() {
    let build = |y: Vec<f64>, k: Parameter| {
        let fmu = Fmu::open(example_fmu("dahlquist").unwrap()).unwrap();
        Calibration::builder(fmu).experiment(experiment(y, "log")).parameter(k).build()
    };
    let mut y = log_decay(2, [3.0, 1.0], 0.2);
    let offset = Parameter::new("off", -2.0).offset_of("x").bounds(-5.0, 5.0);
    let calibration = build(y.clone(), offset).unwrap();
    let error = calibration.cost(&[-2.0], &RunContext::new()).unwrap_err().to_string();
    assert!(error.contains("the simulated 'x' is not positive, but sigma is 'log': -1 at t = 0"), "{error}");
    // Other points of the search succeed.
    assert!(calibration.fit(accurate()).is_err() || calibration.cost(&[0.5], &RunContext::new()).is_ok());
    y[2] = -0.5;
    let error = build(y, Parameter::new("k", 1.0)).unwrap_err().to_string();
    assert!(
        error.contains("the measurement -0.5 of 'x' (column 'x') at time 0.1 must be positive"),
        "{error}"
    );
}

/// Run with `cargo test -p fmufit-calibration --test all error_model -- --ignored --nocapture`.
#[test]
#[ignore = "takes a minute"]
fn intervals_with_error_models_contain_the_true_values() {
    for text in ["0.05 + 0.1*abs(y)", "a + b*abs(y)", "log"] {
        let (mut covered, mut sums, mut rounds) = ([0; 2], [0.0; 2], 0);
        for seed in 0..300 {
            let y = match text {
                "log" => log_decay(seed + 1, [3.0, 1.0], 0.2),
                _ => decay(seed + 1, [3.0, 1.0], [0.05, 0.1]),
            };
            let fit = calibration(y, text, true)
                .fit(FitOptions {
                    run: RunOptions { workers: Some(1), ..FitOptions::default_run() },
                    ..FitOptions::default()
                })
                .unwrap();
            let intervals = fit.uncertainty.as_ref().unwrap().confidence_intervals(0.95).unwrap();
            for ((count, truth), (low, high)) in covered.iter_mut().zip([1.0, 3.0]).zip(&intervals) {
                *count += u32::from((*low..=*high).contains(&truth));
            }
            if let Some(noise) = fit.noise.as_ref().and_then(FitNoise::estimated) {
                let ModelledNoise { a, b, .. } = &noise.models[0];
                sums = [sums[0] + a / 300.0, sums[1] + b / 300.0];
                rounds += noise.n_rounds;
            }
        }
        println!("{text}: {covered:?} of 300, mean coefficients {sums:?}, {rounds} rounds");
        assert!(covered.iter().all(|count| (276..=291).contains(count)), "{covered:?}");
    }
}
