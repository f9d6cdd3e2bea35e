//! Noise that is estimated together with the parameters, so that priors are weighted correctly.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support::normal;
use base::Number;
use calibration::RunContext;
use calibration::{
    BandOptions, BootstrapKind, BootstrapOptions, Calibration, CalibrationBuilder, CalibrationError,
    CostKind, Data, EstimatedNoise, Experiment, FindingId, Fit, FitNoise, FitOptions, NamedCost, NoiseRule,
    Parameter, Prior, ProfileOptions, SavedFit, Severity, Sigma, Stage, ValidationSet, Weight,
};
use dfo::{
    AnyMethod, Checkpoint, LeastSquares, Limits, Loss, NelderMead, Resume, RobustLoss, RunOptions, Search,
    Termination, Tolerances,
};
use example_models::example_fmu;
use fmi::Fmu;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

fn open(model: &str) -> Fmu {
    Fmu::open(example_fmu(model).unwrap()).unwrap()
}

fn times() -> Vec<f64> {
    (0..51).map(|i| 0.1 * f64::from(i)).collect()
}

/// A decay from 1 with rate 2 and this noise.
fn decay(seed: u64, noise: f64) -> Data {
    let mut normal = normal(seed);
    let x = times().iter().map(|t| (-2.0 * t).exp() + noise * normal()).collect();
    Data::from_columns(times(), [("x".to_owned(), x)]).unwrap()
}

fn rate(start: f64, mean: f64, sd: f64) -> Parameter {
    Parameter::new("k", start).bounds(0.01, 50.0).prior(Prior::Normal { mean, sd })
}

fn dahlquist(data: Data, weight: impl Into<Weight>) -> CalibrationBuilder {
    Calibration::builder(open("dahlquist"))
        .experiment(Experiment::new(data).weighted_output("x", "x", weight))
}

fn run(method: impl Into<AnyMethod>) -> RunOptions<AnyMethod> {
    RunOptions { method: method.into(), workers: Some(1), seed: Some(3), ..FitOptions::default_run() }
}

fn estimated(fit: &Fit) -> &EstimatedNoise {
    fit.noise.as_ref().and_then(FitNoise::estimated).unwrap()
}

fn warnings(fit: &Fit) -> Vec<String> {
    let findings = fit.findings();
    findings.iter().filter(|f| f.severity != Severity::Note).map(ToString::to_string).collect()
}

#[test]
fn prior_does_not_dominate_when_noise_is_small() {
    for start in [0.02, 0.3, 1.0, 2.0, 8.0, 40.0] {
        for (seed, noise) in [(1, 1e-3), (2, 1e-3), (3, 1e-5), (4, 0.05)] {
            for method in [AnyMethod::auto(Search::Local), NelderMead::default().into()] {
                let calibration = dahlquist(decay(seed, noise), 1.0).parameter(rate(start, 1.0, 0.3));
                let calibration = calibration.build().unwrap();
                let fit = calibration.fit(run(method)).unwrap();
                let found = estimated(&fit);
                let uncertainty = fit.uncertainty.as_ref().unwrap();
                assert!(fit.report.is_success() && found.is_settled && found.n_rounds <= 4, "{start}: {fit}");
                // The standard deviation has 50 degrees of freedom, so it is accurate to about 10 %.
                assert!((found.outputs[0].sd / noise).ln().abs() < 0.35, "{start} {noise}: {fit}");
                let pull = if noise > 0.01 { 1.0 } else { 0.0 };
                let off = (fit.x[0] - 2.0).abs() / uncertainty.standard_errors[0];
                assert!(off < 3.5 + pull, "{start} {noise}: {off} standard errors, {fit}");
                assert!(fit.rms < fit.start_rms.unwrap() || start == 2.0, "{fit}");
                assert!((fit.rms / noise).ln().abs() < 0.35, "{}", fit.rms);
                assert!(
                    warnings(&fit).iter().all(|reported| !reported.contains("prior")),
                    "{:?}",
                    warnings(&fit)
                );
                assert!(fit.to_string().contains("estimated with the parameters"), "{fit}");
            }
        }
    }
}

/// The start of a decay is a linear parameter. For each noise level, the posterior mode is the result of a
/// linear regression. The noise solves `s^2 (N - h) = r'r`, where h is the fraction of the measurements in
/// the parameter.
#[test]
fn linear_parameter_reaches_its_posterior_mode() {
    let (mean, sd, k) = (1.2, 0.05, 1.0);
    for (seed, noise, weight) in [(1, 0.1, 1.0), (2, 0.3, 1.0), (3, 0.02, 1.0), (4, 0.3, 1e-3)] {
        let mut normal = normal(seed);
        let basis: Vec<f64> = times().iter().map(|t| (-k * t).exp()).collect();
        let y: Vec<f64> = basis.iter().map(|b| 1.1 * b + noise * normal()).collect();
        let (bb, by): (f64, f64) =
            basis.iter().zip(&y).fold((0.0, 0.0), |(bb, by), (b, y)| (bb + b * b, by + b * y));
        let mode = |s: f64| {
            let (data, prior) = (bb / (s * s), 1.0 / (sd * sd));
            ((by / (s * s) + mean * prior) / (data + prior), data / (data + prior))
        };
        let mut s = noise;
        for _ in 0..500 {
            let (x, h) = mode(s);
            let squares: f64 = basis.iter().zip(&y).map(|(b, y)| (x * b - y).powi(2)).sum();
            s = (squares / (y.len() as f64 - h)).sqrt();
        }
        let rule = if weight == 1.0 { NoiseRule::Auto } else { NoiseRule::Estimated };
        for start in [0.2, 1.1, 9.0] {
            let data = Data::from_columns(times(), [("x".to_owned(), y.clone())]).unwrap();
            let experiment = Experiment::new(data).weighted_output("x", "x", weight).start_value("k", k);
            let x = Parameter::new("x", start).bounds(0.1, 10.0).prior(Prior::Normal { mean, sd });
            let calibration =
                Calibration::builder(open("dahlquist")).experiment(experiment).parameter(x).build().unwrap();
            let fit =
                calibration.fit(FitOptions { noise: rule, ..run(LeastSquares::default()).into() }).unwrap();
            let found = &estimated(&fit).outputs[0];
            assert!((found.sd / weight / s).ln().abs() < 0.011, "{} for {s}: {fit}", found.sd);
            let (expected, h) = mode(found.sd / weight);
            assert!((fit.x[0] - expected).abs() < 3e-4 * expected, "{} for {expected}", fit.x[0]);
            // The pull of the prior is large enough to be tested.
            assert!((fit.x[0] - by / bb).abs() > 5.0 * (fit.x[0] - expected).abs() || noise < 0.1, "{h}");
            let error = fit.uncertainty.as_ref().unwrap().standard_errors[0];
            let of_posterior = (h / bb).sqrt() * found.sd / weight;
            assert!((error / of_posterior).ln().abs() < 0.05, "{error} for {of_posterior}");
            // The print shows the part of the inverse variance that comes from the prior, 1 - h.
            let text = fit.to_string();
            let shown = text.split(&format!("prior {} +- {}, ", Number(mean), Number(sd))).nth(1);
            let share: f64 = shown.and_then(|rest| rest.split(' ').next()?.parse().ok()).unwrap();
            assert!((share / (100.0 * (1.0 - h))).ln().abs() < 0.12, "{share} for {h}: {text}");
        }
    }
}

/// Positions and velocities of a throw without gravity, with errors of different size.
fn throw(seed: u64, weights: [Weight; 2]) -> CalibrationBuilder {
    let mut normal = normal(seed);
    let time: Vec<f64> = (0..80).map(|k| 0.02 * f64::from(k)).collect();
    let h = time.iter().map(|t| 1.5 + t + 0.02 * normal()).collect();
    let v = time.iter().map(|_| 1.0 + 0.4 * normal()).collect();
    let data = Data::from_columns(time, [("h".to_owned(), h), ("v".to_owned(), v)]).unwrap();
    let [of_h, of_v] = weights;
    let experiment = Experiment::new(data).weighted_output("h", "h", of_h).weighted_output("v", "v", of_v);
    Calibration::builder(open("bouncing_ball"))
        .experiment(experiment.start_value("g", 0.0))
        .parameter(Parameter::new("h", 1.2).prior(Prior::Normal { mean: 1.45, sd: 0.01 }))
        .parameter(Parameter::new("v", 0.8))
}

#[test]
fn noise_is_estimated_per_output_and_stated_noise_is_kept() {
    let one = || Weight::Constant(1.0);
    let fit = throw(1, [one(), one()]).build().unwrap().fit(run(LeastSquares::default())).unwrap();
    let sds: Vec<f64> = estimated(&fit).outputs.iter().map(|noise| noise.sd).collect();
    assert!((sds[0] / 0.02).ln().abs() < 0.25 && (sds[1] / 0.4).ln().abs() < 0.25, "{sds:?}");
    // A second fit declares the estimated noise by its weights.
    let stated = throw(1, [(1.0 / sds[0]).into(), (1.0 / sds[1]).into()]).build().unwrap();
    let again = stated.fit(run(LeastSquares::default())).unwrap();
    assert_eq!(again.noise, Some(FitNoise::Stated));
    let errors = &again.uncertainty.as_ref().unwrap().standard_errors;
    for ((a, b), error) in fit.x.iter().zip(&again.x).zip(errors) {
        assert!((a - b).abs() < 0.01 * error, "{a} {b} +- {error}");
    }
    assert!(
        (fit.cost - stated.cost(&fit.x, &RunContext::new()).unwrap()).abs() < 1e-9 * fit.cost,
        "{}",
        fit.cost
    );
    // Only noise that is not declared is estimated. The scale of a column declares no noise.
    let scaled = [Weight::Inverse(calibration::OutputScale::Sd), (1.0 / 0.4).into()];
    let fit = throw(1, scaled).build().unwrap().fit(run(LeastSquares::default())).unwrap();
    let found = estimated(&fit);
    assert!(found.outputs.len() == 1 && (found.outputs[0].sd / sds[0]).ln().abs() < 0.01, "{fit}");
    // If weights of one are taken as declared noise of 1 instead of 0.02, the prior determines h.
    let options = FitOptions { noise: NoiseRule::Stated, ..run(LeastSquares::default()).into() };
    let fit = throw(1, [one(), one()]).build().unwrap().fit(options).unwrap();
    assert!(fit.noise == Some(FitNoise::Known) && (fit.x[0] - 1.45).abs() < 1e-3, "{fit}");
}

/// Recording of the start of a decay, which is a linear parameter: its standard error is `sigma / |basis|` for
/// known noise, and the same times `|r| / sqrt(N - 1) / sigma` for estimated noise.
fn linear_decay(noise: f64, weight: impl Into<Weight>) -> (Calibration, f64) {
    let mut normal = normal(5);
    let basis: Vec<f64> = times().iter().map(|t| (-t).exp()).collect();
    let y = basis.iter().map(|b| 1.1 * b + noise * normal()).collect();
    let data = Data::from_columns(times(), [("x".to_owned(), y)]).unwrap();
    let experiment = Experiment::new(data).weighted_output("x", "x", weight).start_value("k", 1.0);
    let x = Parameter::new("x", 0.5).bounds(0.1, 10.0);
    let calibration = Calibration::builder(open("dahlquist")).experiment(experiment).parameter(x).build();
    (calibration.unwrap(), basis.iter().map(|b| b * b).sum::<f64>().sqrt())
}

#[test]
fn known_noise_gives_absolute_errors_intervals_profiles_and_bands() {
    let sigma = 0.05;
    let (by_weight, length) = linear_decay(sigma, 1.0 / sigma);
    let relative = by_weight.fit(run(LeastSquares::default())).unwrap();
    assert!(relative.noise.is_none());
    for (fit, calibration) in [
        (linear_decay(sigma, Sigma::Constant(sigma)).0, true),
        (linear_decay(sigma, Sigma::Rows(vec![sigma; 51].into())).0, true),
        (by_weight, false),
    ]
    .map(|(calibration, is_sigma)| {
        let noise = if is_sigma { NoiseRule::Auto } else { NoiseRule::Stated };
        let options = FitOptions { noise, ..run(LeastSquares::default()).into() };
        (calibration.fit(options).unwrap(), calibration)
    }) {
        let uncertainty = fit.uncertainty.as_ref().unwrap();
        assert!(fit.noise == Some(FitNoise::Known) && uncertainty.is_noise_known(), "{fit}");
        let error = uncertainty.standard_errors[0];
        assert!((error * length / sigma - 1.0).abs() < 1e-4, "{error}");
        // The residuals scale the errors of the fit with weights.
        let scaled = relative.uncertainty.as_ref().unwrap().standard_errors[0];
        let reduced = (relative.cost / 50.0).sqrt();
        assert!((scaled / error / reduced - 1.0).abs() < 1e-4 && (reduced - 1.0).abs() > 1e-3, "{scaled}");
        let (low, high) = uncertainty.confidence_intervals(0.95).unwrap()[0];
        assert!(((high - low) / (2.0 * 1.959_963_985 * error) - 1.0).abs() < 1e-6, "{low} {high}");
        let profile = calibration.profile(&fit, &ProfileOptions::default(), &RunContext::new()).unwrap();
        let interval = profile.parameters[0].interval();
        assert!((interval.0 - low).abs() < 1e-3 * error && (interval.1 - high).abs() < 1e-3 * error);
        let bands = calibration.prediction_bands(&fit, &BandOptions::default(), &RunContext::new()).unwrap();
        let noise = bands[0].noise.clone();
        assert!(noise.iter().all(|sd| (sd / sigma - 1.0).abs() < 1e-9), "{noise:?}");
        assert!(fit.to_string().contains("known (sigma)"), "{fit}");
    }
}

/// Run with `cargo test -p fmufit-calibration --test all noise -- --ignored --nocapture`.
#[test]
#[ignore = "takes a minute"]
fn intervals_of_known_noise_contain_the_true_values() {
    // The noise differs between the rows, and there are only 8 of them: with so few residuals, an estimated
    // variance would make the intervals 20 % wider.
    let time: Vec<f64> = (0..8).map(|k| 0.25 * f64::from(k)).collect();
    let sigma: Vec<f64> = time.iter().map(|t| 0.02 * (1.0 + t)).collect();
    let (mut covered, mut length) = ([0; 2], 0.0);
    for seed in 0..300 {
        let mut normal = normal(seed + 1);
        let x = time.iter().zip(&sigma).map(|(t, s)| 1.5 * (-2.0 * t).exp() + s * normal()).collect();
        let data = Data::from_columns(time.clone(), [("x".to_owned(), x)]).unwrap();
        let calibration = dahlquist(data, Sigma::Rows(sigma.clone().into()))
            .parameter(Parameter::new("k", 1.5).bounds(0.01, 50.0))
            .parameter(Parameter::new("x", 1.0).bounds(0.1, 9.0))
            .build()
            .unwrap();
        let fit = calibration.fit(run(LeastSquares::default())).unwrap();
        let intervals = fit.uncertainty.unwrap().confidence_intervals(0.95).unwrap();
        for ((count, truth), (low, high)) in covered.iter_mut().zip([2.0, 1.5]).zip(&intervals) {
            *count += u32::from((*low..=*high).contains(&truth));
        }
        length += (intervals[0].1 - intervals[0].0) / 300.0;
    }
    println!("known noise: {covered:?} of 300, mean length of the interval of k {length}");
    assert!(covered.iter().all(|count| (276..=291).contains(count)), "{covered:?}");
}

#[test]
fn residuals_that_contradict_known_noise_are_reported_by_chi_square() {
    let found = |sigma: f64| {
        let fit = linear_decay(0.05, Sigma::Constant(sigma)).0.fit(run(LeastSquares::default())).unwrap();
        let finding = fit.findings().into_iter().find(|f| f.id == FindingId::ContradictedNoise);
        finding.map(|finding| (finding.severity, finding.to_string()))
    };
    assert_eq!(found(0.05), None);
    let (severity, text) = found(0.02).unwrap();
    assert!(severity == Severity::Warning && text.contains("times the known noise"), "{text}");
    let (severity, text) = found(0.075).unwrap();
    assert!(severity == Severity::Note && text.contains("Sigma is too large"), "{text}");
}

#[test]
fn sigma_must_be_positive_and_cannot_be_combined_with_the_likelihood() {
    for sigma in [Sigma::Constant(0.0), Sigma::Constant(-1.0), Sigma::Rows(vec![0.0; 51].into())] {
        let output = Experiment::new(decay(1, 0.1)).weighted_output("x", "x", sigma);
        let k = Parameter::new("k", 1.0);
        let built = Calibration::builder(open("dahlquist")).experiment(output).parameter(k).build();
        assert!(built.unwrap_err().to_string().contains("must be positive"));
    }
    let calibration = linear_decay(0.05, Sigma::Constant(0.05)).0;
    let objective = CostKind::Named(NamedCost::Likelihood);
    let likelihood = FitOptions { objective, ..run(NelderMead::default()).into() };
    let estimated = FitOptions { noise: NoiseRule::Estimated, ..run(LeastSquares::default()).into() };
    for options in [likelihood, estimated] {
        let error = calibration.fit(options).unwrap_err().to_string();
        assert!(error.contains("sigma"), "{error}");
    }
}

#[test]
fn fit_reports_when_noise_is_not_estimated() {
    let build =
        |weight: f64| dahlquist(decay(1, 1e-3), weight).parameter(rate(1.5, 2.0, 0.3)).build().unwrap();
    let robust = RobustLoss::new(Loss::SoftL1, 1e-3).unwrap();
    let with = |loss, noise, kind| FitOptions {
        loss,
        noise,
        objective: kind,
        ..run(AnyMethod::auto(Search::Local)).into()
    };
    let fit = build(1.0).fit(with(robust, NoiseRule::Auto, CostKind::SumOfSquares)).unwrap();
    assert!(warnings(&fit).iter().any(|reported| reported.contains("prior of k")), "{:?}", warnings(&fit));
    for (weight, loss, rule) in [
        (1e3, RobustLoss::default(), NoiseRule::Auto),
        (1e3, robust, NoiseRule::Auto),
        (1.0, robust, NoiseRule::Stated),
    ] {
        let fit = build(weight).fit(with(loss, rule, CostKind::SumOfSquares)).unwrap();
        assert_eq!(fit.noise, Some(FitNoise::Stated));
        assert!(warnings(&fit).iter().all(|reported| !reported.contains("prior")), "{:?}", warnings(&fit));
        assert!(fit.to_string().contains("stated by the weights"), "{fit}");
    }
    let likelihood = CostKind::Named(NamedCost::Likelihood);
    let fit = build(1.0).fit(with(RobustLoss::default(), NoiseRule::Auto, likelihood)).unwrap();
    assert!(
        fit.noise.is_none() && warnings(&fit).iter().all(|reported| !reported.contains("prior")),
        "{fit}"
    );
    let refused = build(1.0).fit(with(robust, NoiseRule::Estimated, CostKind::SumOfSquares));
    assert!(refused.unwrap_err().to_string().contains("noise 'estimated'"));
    let check = build(1.0).check();
    assert!(
        check.findings.iter().any(|f| f.subject == "prior of k" && f.severity == Severity::Note),
        "{check}"
    );
    // Without priors, the noise is estimated only on request.
    let plain =
        || dahlquist(decay(1, 1e-3), 1.0).parameter(Parameter::new("k", 1.0).bounds(0.01, 50.0)).build();
    assert!(plain().unwrap().fit(run(LeastSquares::default())).unwrap().noise.is_none());
    let requested = with(RobustLoss::default(), NoiseRule::Estimated, CostKind::SumOfSquares);
    let fit = plain().unwrap().fit(requested).unwrap();
    assert!((estimated(&fit).outputs[0].sd / 1e-3).ln().abs() < 0.35, "{fit}");
}

/// Two parameters that only their priors distinguish, and as many measurements as parameters.
#[test]
fn priors_determine_parameters_without_measurements() {
    let mut normal = normal(9);
    let y = times().iter().map(|t| 3.0 * (-2.0 * t).exp() + 0.01 * normal()).collect();
    let data = Data::from_columns(times(), [("x".to_owned(), y)]).unwrap();
    let prior = |mean, sd| Prior::Normal { mean, sd };
    let calibration = dahlquist(data.clone(), 1.0)
        .parameter(Parameter::new("x", 1.0).bounds(0.1, 10.0).prior(prior(2.5, 0.3)))
        .parameter(Parameter::new("offset", 0.1).offset_of("x").bounds(-5.0, 5.0).prior(prior(0.0, 1.0)))
        .parameter(rate(1.0, 2.0, 0.2));
    let fit = calibration.build().unwrap().fit(run(LeastSquares::default())).unwrap();
    assert!((estimated(&fit).outputs[0].sd / 0.01).ln().abs() < 0.35, "{fit}");
    assert!((fit.x[0] - 3.0).abs() < 0.1 && fit.x[1].abs() < 0.1 && (fit.x[2] - 2.0).abs() < 0.1, "{fit}");
    // One measurement does not determine its noise.
    let few = dahlquist(data, 1.0).parameter(rate(1.0, 2.0, 0.2));
    let mut problem = few.build().unwrap().problem().clone();
    problem.experiments[0] = problem.experiments[0].clone().window(0.0, 0.05);
    let fit = Calibration::from_problem(open("dahlquist"), problem)
        .unwrap()
        .fit(run(LeastSquares::default()))
        .unwrap();
    assert!(
        fit.x[0].is_finite() && warnings(&fit).iter().any(|reported| reported.contains("noise of x")),
        "{fit}"
    );
}

#[test]
fn limits_cover_all_noise_rounds_and_result_is_independent_of_workers() {
    let build = || dahlquist(decay(5, 0.05), 1.0).parameter(rate(0.5, 1.0, 0.05)).build().unwrap();
    for method in [AnyMethod::from(LeastSquares::default().serial()), NelderMead::default().into()] {
        let with = |workers: usize, most: Option<usize>| {
            let limits = Limits { max_evaluations: most, ..Limits::default() };
            let fit =
                build().fit(RunOptions { workers: Some(workers), limits, ..run(method.clone()) }).unwrap();
            assert_eq!(fit.start, [0.5]);
            fit
        };
        let whole = with(1, Some(1000));
        let rounds = estimated(&whole).n_rounds;
        assert!(rounds >= 2, "{whole}");
        let bits = |fit: &Fit| (fit.x[0].to_bits(), fit.cost.to_bits(), fit.report.n_evaluations);
        for workers in [2, 4] {
            let other = with(workers, Some(1000));
            assert_eq!((bits(&other), &other.noise), (bits(&whole), &whole.noise));
        }
        for most in 1..whole.report.n_evaluations {
            let cut = with(1, Some(most));
            assert_eq!(cut.report.n_evaluations, most);
            assert_eq!(cut.report.termination, Termination::MaxEvaluations);
            assert!(!cut.report.is_success() && !estimated(&cut).is_settled && cut.cost.is_finite(), "{cut}");
        }
        let mut counts = Vec::new();
        let options = FitOptions {
            observer: Some(Box::new(|progress| {
                counts.push((progress.n_evaluations, progress.n_iterations));
                ControlFlow::Continue(())
            })),
            ..run(method.clone()).into()
        };
        let seen = build().fit(options).unwrap();
        assert_eq!(bits(&seen), bits(&whole));
        assert!(counts.is_sorted() && counts.last().unwrap().0 == seen.report.n_evaluations, "{counts:?}");
        let flag = AtomicBool::new(false);
        let options = FitOptions {
            observer: Some(Box::new(|progress| {
                flag.store(progress.n_evaluations + 2 >= whole.report.n_evaluations, Ordering::Relaxed);
                ControlFlow::Continue(())
            })),
            context: RunContext::new().flagged(&flag),
            ..run(method.clone()).into()
        };
        let cut = build().fit(options).unwrap();
        assert!(cut.report.termination == Termination::Interrupted && cut.cost.is_finite(), "{cut}");
    }
}

#[test]
fn checkpoint_survives_all_noise_rounds() {
    let build = || dahlquist(decay(5, 0.05), 1.0).parameter(rate(0.5, 1.0, 0.05)).build().unwrap();
    for method in [AnyMethod::from(LeastSquares::default()), NelderMead::default().into()] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fit.ckpt");
        let with = |most: Option<usize>, checkpoint: Option<Checkpoint>| {
            let limits = Limits { max_evaluations: most, ..Limits::default() };
            build().fit(RunOptions { limits, checkpoint, ..run(method.clone()) }).unwrap()
        };
        let whole = with(Some(1000), None);
        let bits = |fit: &Fit| (fit.x[0].to_bits(), fit.cost.to_bits(), fit.report.n_evaluations);
        for most in [1, whole.report.n_evaluations / 2, whole.report.n_evaluations - 1, 1000, 1000] {
            let file = Checkpoint::new(&path).resume(Resume::Auto);
            let fit = with(Some(most), Some(file));
            assert_eq!(fit.report.n_evaluations, most.min(whole.report.n_evaluations), "{fit}");
            if most == 1000 {
                assert_eq!((bits(&fit), &fit.noise), (bits(&whole), &whole.noise));
                assert!(fit.report.resumed.is_some());
            }
        }
        assert!(folder.path().join("fit.ckpt.round2").is_file());
        // A leftover file of another run does not matter.
        std::fs::remove_file(&path).unwrap();
        let again = with(Some(1000), Some(Checkpoint::new(&path)));
        assert_eq!((bits(&again), again.report.resumed.is_none()), (bits(&whole), true));
    }
}

#[test]
fn later_analyses_use_the_weights_of_the_fit() {
    let calibration = dahlquist(decay(6, 1e-3), 1.0).parameter(rate(1.0, 1.0, 0.3)).build().unwrap();
    let fit = calibration.fit(run(LeastSquares::default())).unwrap();
    let noise = estimated(&fit).outputs[0].sd;
    let profile = calibration.profile(&fit, &ProfileOptions::default(), &RunContext::new()).unwrap();
    let (low, high) = profile.parameters[0].interval();
    let (from, to) = fit.uncertainty.as_ref().unwrap().confidence_intervals(0.95).unwrap()[0];
    assert!(low < fit.x[0] && fit.x[0] < high, "{low} {high} {fit}");
    assert!(((high - low) / (to - from)).ln().abs() < 0.05, "{low} {high} for {from} {to}");
    let bands = calibration.prediction_bands(&fit, &BandOptions::default(), &RunContext::new()).unwrap();
    // The residuals agree within the tolerance of the rounds.
    assert!(bands[0].noise.iter().all(|sd| (sd / noise - 1.0).abs() < 0.03), "{:?} {noise}", bands[0].noise);
    let curves = calibration.curves(&fit, &RunContext::new()).unwrap();
    let residuals = &curves[0].outputs[0].residuals;
    let plain = calibration.residuals(&fit.x, &RunContext::new()).unwrap();
    assert!(residuals.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-12), "{residuals:?}");
    let sensitivities = calibration.sensitivities(&fit);
    let expected = times().iter().map(|t| -t * fit.x[0] * (-fit.x[0] * t).exp()).collect::<Vec<_>>();
    assert!(
        sensitivities[0][0].iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-3),
        "{sensitivities:?}"
    );
    // The RMS uses the weights of the calibration, not of the fit.
    let squares: f64 = plain[..51].iter().map(|r| r * r).sum();
    assert!((fit.rms - (squares / 51.0).sqrt()).abs() < 1e-12, "{}", fit.rms);
    assert!((fit.outputs[0].rms - fit.rms).abs() < 1e-12);
    let validation =
        calibration.validate(&fit, &ValidationSet::Windows(vec![(0.0, 1.0)]), &RunContext::new()).unwrap();
    assert!(validation.rms < 3e-3, "{validation}");
    let bytes = fit.to_bytes(&calibration).unwrap();
    let saved = SavedFit::from_bytes(&bytes, "fit").unwrap();
    assert_eq!(saved.fit, fit);
    let again = saved
        .calibration()
        .unwrap()
        .profile(&saved.fit, &ProfileOptions::default(), &RunContext::new())
        .unwrap();
    assert_eq!((again.x, again.cost), (profile.x, profile.cost));
    let json: serde_json::Value = serde_json::from_str(&fit.to_json(&calibration).unwrap()).unwrap();
    assert_eq!(json["noise"]["estimated"]["outputs"][0]["sd"], noise);
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("fit.html");
    calibration.report(&fit, &page, &RunContext::new()).unwrap();
    assert!(std::fs::read_to_string(page).unwrap().contains("estimated with the parameters"));
}

#[test]
fn each_stage_estimates_its_noise_and_the_last_is_reported() {
    let calibration = throw(2, [1.0.into(), 1.0.into()]).build().unwrap();
    let stages = [Stage::new(["v"]).window(0.0, 0.8), Stage::new(["h", "v"])];
    let fit = calibration.fit_stages(&stages, run(LeastSquares::default())).unwrap();
    let whole = calibration.fit(run(LeastSquares::default())).unwrap();
    let errors = &whole.uncertainty.as_ref().unwrap().standard_errors;
    for ((a, b), error) in fit.x.iter().zip(&whole.x).zip(errors) {
        assert!((a - b).abs() < 0.02 * error, "{a} {b} +- {error}");
    }
    assert_eq!(fit.noise, fit.stages[1].noise);
    for (one, other) in estimated(&fit).outputs.iter().zip(&estimated(&whole).outputs) {
        assert!((one.sd / other.sd).ln().abs() < 0.011);
    }
    assert!((fit.rms / whole.rms - 1.0).abs() < 1e-3, "{} {}", fit.rms, whole.rms);
    assert!((fit.start_rms.unwrap() / whole.start_rms.unwrap() - 1.0).abs() < 1e-9);
    assert!((fit.cost / whole.cost - 1.0).abs() < 0.05 && fit.cost < fit.start_cost.unwrap());
    let (one, other) = (fit.uncertainty.as_ref().unwrap(), whole.uncertainty.as_ref().unwrap());
    assert!((one.standard_errors[0] / other.standard_errors[0]).ln().abs() < 0.02);
}

/// An offset with a distant prior and a robust loss: the loss applies only to the measurements.
#[test]
fn prior_counts_by_its_square_with_every_loss() {
    let (n, noise, sd, scale) = (50, 0.1, 0.02, 1.345);
    let mut normal = normal(5);
    let t: Vec<f64> = (0..n).map(|i| 2.0 * f64::from(i) / 49.0).collect();
    let off: Vec<f64> = (0..n).map(|_| 0.5 + noise * normal()).collect();
    let x = t.iter().zip(&off).map(|(t, off)| (-t).exp() + off).collect();
    let data = Data::from_columns(t, [("x".to_owned(), x)]).unwrap();
    let tolerances = Tolerances { x_tol: 1e-8, f_tol: 1e-12, ..Tolerances::default() };
    let accurate = RunOptions { tolerances, ..run(LeastSquares::default()) };
    for mean in [0.5, 0.44, 0.3, 0.0] {
        for kind in [Loss::Huber, Loss::SoftL1, Loss::Cauchy] {
            let loss = RobustLoss::new(kind, scale).unwrap();
            let prior = Prior::Normal { mean, sd };
            let offset = Parameter::new("off", 0.4).bounds(-5.0, 5.0).offset_of("x").prior(prior);
            let calibration = dahlquist(data.clone(), 1.0 / noise).parameter(offset).build().unwrap();
            let fit = calibration
                .fit(FitOptions { loss, noise: NoiseRule::Stated, ..accurate.clone().into() })
                .unwrap();
            // Half the derivative of the cost; bisection finds its zero.
            let slope = |at: f64| {
                let of = |off: &f64| {
                    let r = (at - off) / noise;
                    loss.transform(r) * loss.slope(r) / noise
                };
                off.iter().map(of).sum::<f64>() + (at - mean) / (sd * sd)
            };
            let (mut low, mut high) = (mean.min(0.3), 0.8);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if slope(middle) > 0.0 { high = middle } else { low = middle }
            }
            assert!((fit.x[0] - low).abs() < 1e-4, "{kind:?} {mean}: {} {low}", fit.x[0]);
            let uncertainty = fit.uncertainty.as_ref().unwrap();
            // The error is between the error with prior and measurements and the error with measurements
            // only.
            let error = uncertainty.standard_errors[0];
            assert!((0.009..0.03).contains(&error), "{kind:?} {mean}: {error}");
            assert_eq!(uncertainty.autocorrelations, [0.0]);
            let reported = warnings(&fit).iter().any(|text| text.contains("prior of off"));
            assert_eq!(reported, mean < 0.4, "{kind:?} {mean}: {:?}", warnings(&fit));
        }
    }
}

/// A vague prior does not change the intervals.
#[test]
fn vague_prior_keeps_degrees_of_freedom_and_intervals() {
    let data = || {
        let t: Vec<f64> = vec![0.3, 0.8, 1.3, 2.0];
        let mut normal = normal(9);
        let x = t.iter().map(|t| (-t).exp() + 0.01 * normal()).collect();
        Data::from_columns(t, [("x".to_owned(), x)]).unwrap()
    };
    let with = |prior: Option<f64>| {
        let with_prior = |p: Parameter| match prior {
            Some(sd) => p.prior(Prior::Normal { mean: 0.9, sd }),
            None => p,
        };
        let k = with_prior(Parameter::new("k", 1.0).bounds(0.01, 100.0));
        let off = with_prior(Parameter::new("off", 0.0).bounds(-1000.0, 1000.0).offset_of("x"));
        let calibration = dahlquist(data(), 1.0).parameter(k).parameter(off).build().unwrap();
        calibration.fit(FitOptions::default()).unwrap().uncertainty.unwrap()
    };
    let (without, vague) = (with(None), with(Some(1e4)));
    assert_eq!((without.degrees_of_freedom, vague.degrees_of_freedom), (2.0, 2.0));
    let width = |of: &calibration::Uncertainty| {
        let (low, high) = of.confidence_intervals(0.95).unwrap()[0];
        high - low
    };
    assert!((width(&vague) / width(&without) - 1.0).abs() < 0.02, "{} {}", width(&vague), width(&without));
    // With a dominant prior, all measurements are left for the noise.
    assert!(with(Some(1e-6)).degrees_of_freedom > 3.99);
}

#[test]
fn bootstrap_has_the_standard_error_of_a_linear_parameter_for_any_number_of_workers() {
    let sigma = 0.05;
    let (calibration, length) = linear_decay(sigma, Sigma::Constant(sigma));
    let fit = calibration.fit(run(LeastSquares::default())).unwrap();
    for kind in [BootstrapKind::Parametric, BootstrapKind::Residual, BootstrapKind::Block] {
        let of = |n, workers| {
            let workers = Some(workers);
            let options = BootstrapOptions { n, kind, seed: Some(3), workers, ..BootstrapOptions::default() };
            calibration.bootstrap(&fit, &options, &RunContext::new()).unwrap()
        };
        let found = of(100, 2);
        assert!(found.n_failed == 0 && found.samples.len() == 100, "{found}");
        assert_eq!(of(7, 1).samples, found.samples[..7], "{kind:?}");
        // The standard error of 100 fits is accurate to 7 %, and the standard deviation of 51 residuals to 10 %.
        let error = found.standard_errors()[0];
        assert!((error * length / sigma).ln().abs() < 0.35, "{kind:?}: {error} for {}", sigma / length);
        let (low, high) = found.intervals(0.95).unwrap()[0];
        assert!(low < fit.x[0] && fit.x[0] < high && (high - low) / error > 3.0, "{found}");
        assert!(found.to_string().contains("95 % interval of 100 fits"), "{found}");
    }
    let options = BootstrapOptions { n: 0, ..BootstrapOptions::default() };
    assert!(calibration.bootstrap(&fit, &options, &RunContext::new()).is_err());
}

#[test]
fn bootstrap_without_a_successful_fit_states_the_first_reason() {
    let (calibration, _) = linear_decay(0.05, Sigma::Constant(0.05));
    let fit = calibration.fit(run(LeastSquares::default())).unwrap();
    // The fitted value is outside of these bounds.
    let mut problem = calibration.problem().clone();
    let start = fit.x[0] - 1.5;
    problem.parameters[0] =
        Parameter::new(problem.parameters[0].name(), start).bounds(start - 0.5, start + 0.5);
    let narrow = Calibration::from_problem(calibration.fmu().clone(), problem).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = Some(folder.path().join("run.boot"));
    let options = BootstrapOptions { n: 3, seed: Some(1), checkpoint, ..BootstrapOptions::default() };
    // The reason is also known after the fits are read from the file.
    for _ in 0..2 {
        let error = narrow.bootstrap(&fit, &options, &RunContext::new()).unwrap_err().to_string();
        assert!(
            error.contains("none of the 3 fits of the bootstrap succeeded. Reason of the first: parameter")
                && error.contains("is outside of the bounds"),
            "{error}"
        );
    }
}

#[test]
fn bootstrap_continues_from_its_file_bit_for_bit() {
    let (calibration, _) = linear_decay(0.05, Sigma::Constant(0.05));
    let fit = calibration.fit(run(LeastSquares::default())).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.boot");
    let options = |n, seed| BootstrapOptions {
        n,
        seed,
        workers: Some(2),
        checkpoint: Some(file.clone()),
        ..BootstrapOptions::default()
    };
    let whole = BootstrapOptions { checkpoint: None, workers: Some(1), ..options(12, Some(3)) };
    let asked = AtomicUsize::new(0);
    let count = || asked.fetch_add(1, Ordering::Relaxed) == usize::MAX;
    let whole = calibration.bootstrap(&fit, &whole, &RunContext::new().polling(&count)).unwrap();
    let n_asked = asked.into_inner();
    let n_saved = || {
        let Ok(text) = std::fs::read_to_string(&file) else { return 0 };
        let saved: serde_json::Value = serde_json::from_str(text.split_once('\n').unwrap().1).unwrap();
        saved["fits"].as_object().unwrap().len()
    };
    // The first run ends after some of its fits. The context is also asked by the clock, so a loaded machine asks
    // more often.
    let interrupted = |part: usize| {
        let _ = std::fs::remove_file(&file);
        let asked = AtomicUsize::new(0);
        let is_over = || asked.fetch_add(1, Ordering::Relaxed) > part * n_asked / 8;
        let first = BootstrapOptions { workers: Some(1), ..options(12, Some(3)) };
        let ended = calibration.bootstrap(&fit, &first, &RunContext::new().polling(&is_over));
        (matches!(ended, Err(CalibrationError::Cancelled)) && n_saved() > 0).then(n_saved)
    };
    let n = (3..8).find_map(interrupted).unwrap();
    // The seed of the file applies, and a larger number of fits continues.
    let some = calibration.bootstrap(&fit, &options(n + 1, None), &RunContext::new()).unwrap();
    assert_eq!((some.samples.as_slice(), some.seed, n_saved()), (&whole.samples[..=n], 3, n + 1));
    let all = calibration.bootstrap(&fit, &options(12, Some(3)), &RunContext::new()).unwrap();
    assert_eq!((all, n_saved()), (whole, 12));
    let refused = |options: &BootstrapOptions| {
        let before = std::fs::read(&file).unwrap();
        let message = calibration.bootstrap(&fit, options, &RunContext::new()).unwrap_err().to_string();
        assert_eq!(std::fs::read(&file).unwrap(), before);
        assert!(message.contains("run.boot") && message.contains("Specify another file"), "{message}");
        message
    };
    let block = BootstrapOptions { kind: BootstrapKind::Block, ..options(12, Some(3)) };
    assert!(refused(&block).contains("of another fit or problem, or of another kind"));
    assert!(refused(&options(12, Some(4))).contains("with another seed"));
    // Another value of a stored fit would be a wrong result.
    let damaged =
        std::fs::read_to_string(&file).unwrap().replacen("\"fits\":{\"0\":[", "\"fits\":{\"0\":[1", 1);
    std::fs::write(&file, damaged).unwrap();
    assert!(refused(&options(12, Some(3))).contains("is damaged, because its checksum does not match"));
    std::fs::write(&file, b"{}").unwrap();
    assert!(refused(&options(12, Some(3))).contains("is not a file of a bootstrap of this version"));
}
