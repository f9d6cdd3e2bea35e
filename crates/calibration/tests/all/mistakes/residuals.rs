//! Mistakes that are visible in the residuals of a fit.

use super::{calibration, decay, fitted, k, noise, open, recording, sound, times, warnings, warns};
use calibration::dfo::{Limits, Loss, RobustLoss, RunOptions};
use calibration::{
    Calibration, Compared, CostKind, CustomCost, Data, Experiment, Fit, FitOptions, Origin, Parameter,
    Severity, SimulationSettings, UncertaintyOptions, Weight,
};
use fmi::SimulateOptions;

fn fitted_as(experiment: Experiment, options: FitOptions<'_>) -> Fit {
    calibration(vec![experiment], k(), SimulationSettings::default()).fit(options).unwrap()
}

#[test]
fn outputs_missed_by_a_fit_are_reported() {
    // First the column has the wrong sign; then it is the wrong column.
    let t = times(61, 0.05);
    let mirrored = decay(&t, 2.0, 1e-3).iter().map(|x| -x).collect();
    let fit = fitted(recording(&t, mirrored), k());
    assert!(warns(&fit.findings(), "the fit is worse than a constant"), "{fit}");
    let few = times(6, 0.5);
    let fit = fitted(recording(&few, few.iter().map(|t| 5.0 + (7.0 * t).sin()).collect()), k());
    assert!(warns(&fit.findings(), "the fit is worse than a constant"), "{fit}");
    let other = t.iter().enumerate().map(|(i, t)| 5.0 + (7.0 * t).sin() + 0.1 * noise(i)).collect();
    let fit = fitted(recording(&t, other), k());
    assert!(warns(&fit.findings(), "the fit is worse than a constant"), "{fit}");
    assert!(fit.is_success() && !fit.is_usable(), "{fit}");
}

#[test]
fn recording_at_rest_does_not_make_a_fit_unusable() {
    // For the last part of the decay, a constant is a better model than one with a small offset.
    let (t, late) = (times(61, 0.05), times(161, 0.05));
    let rest = late.iter().map(|t| if *t < 5.0 { f64::NAN } else { (-2.0 * t).exp() + 2e-4 }).collect();
    let (moving, rest) = (recording(&t, decay(&t, 2.0, 1e-3)), recording(&late, rest));
    let both = calibration(vec![moving, rest.clone()], k(), SimulationSettings::default());
    let fit = both.fit(FitOptions::default()).unwrap();
    assert!(fit.is_usable(), "{fit}");
    let found = fit.findings();
    assert!(warns(&found, "run2: output 'x' (column 'x'): the fit is worse than a constant"), "{fit}");
    // Without other recordings, the fit is unusable.
    assert!(!fitted(rest, k()).is_usable());
}

#[test]
fn causes_are_listed_before_other_findings() {
    // 0 degC is 273.15 K: the parameter moves to its bound, and nothing is explained.
    let t = times(61, 0.05);
    let fit = fitted(recording(&t, decay(&t, 2.0, 1e-3).iter().map(|x| x + 273.15).collect()), k());
    let origins: Vec<Origin> =
        fit.findings().iter().filter(|f| f.severity != Severity::Note).map(|f| f.origin).collect();
    assert!(origins.is_sorted() && origins[0] == Origin::Problem, "{fit}");
    assert!(origins.contains(&Origin::Search) && origins.contains(&Origin::Residuals), "{fit}");
    let first_note = fit.findings().iter().position(|f| f.severity == Severity::Note);
    assert!(first_note.is_none_or(|k| fit.findings()[k..].iter().all(|f| f.severity == Severity::Note)));
}

/// A bouncing ball with restitution 0.7, recorded with noise, and fitted from another value.
fn ball(output: &str, size: f64, start: f64) -> Fit {
    let t = times(301, 0.01);
    let options = SimulateOptions::new().times(t.clone()).outputs([output]).start_value("e", 0.7);
    let ran = open("bouncing_ball").simulate(&options).unwrap();
    let measured: Vec<f64> =
        ran.get(output).unwrap().iter().enumerate().map(|(k, value)| value + size * noise(k)).collect();
    let data = Data::from_columns(t, [(output.to_owned(), measured)]).unwrap();
    let builder = Calibration::builder(open("bouncing_ball"))
        .experiment(Experiment::new(data).output(output, output))
        .parameter(Parameter::new("e", start).bounds(0.3, 0.95))
        .parameter(Parameter::new("g", -9.8).bounds(-12.0, -8.0));
    builder.build().unwrap().fit(FitOptions::default()).unwrap()
}

#[test]
fn rough_cost_is_reported_for_local_search() {
    let reported = "the cost is not smooth";
    // The height is smooth, but the velocity jumps at impacts. A local search ends where a jump reaches a
    // row.
    for start in [0.6, 0.699, 0.8] {
        let fit = ball("h", 1e-2, start);
        assert!((fit.x[0] - 0.7).abs() < 1e-2 && !warns(&fit.findings(), reported), "{fit}");
    }
    let near = ball("v", 5e-2, 0.7);
    assert!((near.x[0] - 0.7).abs() < 1e-3 && !warns(&near.findings(), reported), "{near}");
    let far = ball("v", 5e-2, 0.6);
    // The result is at least twenty times farther from the true value than after a start at the true value.
    assert!((far.x[0] - 0.7).abs() > 0.02 && !far.is_usable(), "{far}");
    let errors: Vec<_> = far.findings().into_iter().filter(|f| f.severity == Severity::Error).collect();
    assert!(errors.len() == 1 && errors[0].sentence.starts_with(reported), "{far}");
    // Unreliable standard errors are not printed.
    let printed = far.to_string();
    assert!(printed.contains("Standard errors: unreliable."), "{far}");
    let mut values = printed.lines().filter(|line| line.starts_with("  ") && line.contains("  -> "));
    assert!(values.all(|line| !line.contains("+-")), "{far}");
}

#[test]
fn outliers_are_reported_and_a_used_loss_is_not_proposed() {
    let t = times(100, 0.03);
    let mut x = decay(&t, 2.0, 1e-3);
    let together = {
        let mut x = x.clone();
        (30..35).for_each(|i| x[i] += 0.2);
        fitted(recording(&t, x), k())
    };
    (10..35).step_by(5).for_each(|i| x[i] += 0.2);
    let calibration = calibration(vec![recording(&t, x)], k(), SimulationSettings::default());
    let reported = "or use a robust loss";
    let plain = calibration.fit(FitOptions::default()).unwrap();
    assert!(warns(&plain.findings(), reported), "{plain}");
    // A loss does not help if the model does not follow a part of the recording. It does not help with a
    // wrong model either, such as one that settles at 0.
    assert!(!warns(&together.findings(), reported) && !together.findings().is_empty(), "{together}");
    let offset = decay(&t, 2.0, 1e-3)
        .iter()
        .zip(&t)
        .map(|(x, t)| x + 0.2 * (1.0 - (-6.0 * t).exp()).powi(8))
        .collect();
    let misfit = fitted(recording(&t, offset), k());
    assert!(!misfit.to_string().contains("robust"), "{misfit}");
    let loss = RobustLoss::new(Loss::SoftL1, 2e-3).unwrap();
    let robust = calibration.fit(FitOptions { loss, ..FitOptions::default() }).unwrap();
    assert!(
        !warns(&robust.findings(), reported)
            && robust.to_string().contains("The robust loss reduces the influence"),
        "{robust}"
    );
    let t = vec![0.0, 0.5, 1.0];
    let fit = fitted(recording(&t, vec![1.0, 0.37, 0.2]), k());
    assert!(!fit.to_string().contains("outliers"), "{fit}");
}

/// Systematic residuals are reported for every cost, with and without standard errors.
#[test]
fn residuals_are_checked_with_every_cost_and_without_covariance() {
    let t = times(101, 0.05);
    let with_offset: Vec<f64> = decay(&t, 2.0, 0.005).iter().map(|x| x + 0.1).collect();
    let squares = CustomCost::cost("squares", |compared| {
        let of =
            |c: &Compared<'_>| c.simulated.iter().zip(c.measured).map(|(s, m)| (s - m).powi(2)).sum::<f64>();
        Ok(compared.iter().map(of).sum())
    });
    let costs = || CostKind::named().chain([CostKind::Custom(squares.clone())]);
    for objective in costs() {
        for uncertainty in [None, Some(UncertaintyOptions::default())] {
            let name = objective.name().to_owned();
            let options = || FitOptions {
                objective: objective.clone(),
                uncertainty: uncertainty.clone(),
                ..FitOptions::default()
            };
            let fit = fitted_as(recording(&t, with_offset.clone()), options());
            let reported = warnings(&fit.findings());
            let text = "the residuals of x are autocorrelated";
            let n_reported = reported.iter().filter(|reported| reported.contains(text)).count();
            assert!(fit.report.is_success() && n_reported == 1, "{name}: {fit}");
            let has_errors = fit.uncertainty.is_some();
            assert_eq!(
                reported.iter().any(|reported| reported.contains("Standard errors are corrected")),
                has_errors
            );
            let fit = fitted_as(sound(1e-3), options());
            assert!(warnings(&fit.findings()).is_empty(), "{name}: {fit}");
        }
    }
    // Nothing is reported for an interrupted search, or if simulations reproduce the measurements.
    let without = || FitOptions { uncertainty: None, ..FitOptions::default() };
    let limits = Limits { max_evaluations: Some(2), ..Limits::default() };
    let ended = FitOptions { run: RunOptions { limits, ..FitOptions::default_run() }, ..without() };
    assert!(warnings(&fitted_as(sound(1e-3), ended).findings()).is_empty());
    assert!(warnings(&fitted_as(sound(0.0), without()).findings()).is_empty());
}

/// Uniform noise from -size to size has the standard deviation size / sqrt(3).
#[test]
fn residuals_are_compared_with_noise_declared_by_weights() {
    let sigma = 0.01 / 3f64.sqrt();
    let t = times(201, 0.025);
    let findings = |weight: Weight, change: &dyn Fn(f64) -> f64| {
        let x = decay(&t, 2.0, 0.01).iter().zip(&t).map(|(x, t)| x + change(*t)).collect();
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x)]).unwrap();
        let fit = fitted(Experiment::new(data).weighted_output("x", "x", weight), k());
        fit.findings()
            .iter()
            .map(ToString::to_string)
            .filter(|reported| reported.contains("F016"))
            .collect::<Vec<_>>()
    };
    let plain = |weight: f64| findings(weight.into(), &|_| 0.0);
    for sound in [plain(1.0 / sigma), plain(0.9 / sigma), plain(1.05 / sigma), plain(1.0)] {
        assert!(sound.is_empty(), "{sound:?}");
    }
    // Weights of 0 and 1 do not declare noise.
    let chosen: Vec<f64> = (0..201).map(|k| f64::from(k % 2)).collect();
    assert!(findings(Weight::Rows(chosen.into()), &|_| 0.0).is_empty());
    for (factor, reported) in [(3.0, "larger than stated"), (0.2, "smaller than stated"), (100.0, "larger")] {
        let found = plain(factor / sigma);
        assert!(found.len() == 1 && found[0].starts_with("note: noise of x: "), "{found:?}");
        assert!(found[0].contains(reported), "{found:?}");
    }
    // The model omits a fast effect that no autocorrelation shows.
    let reported = findings((1.0 / sigma).into(), &|t| 0.03 * (80.0 * t).sin());
    assert!(reported.len() == 1 && reported[0].contains("The model lacks an effect"), "{reported:?}");
}

#[test]
fn autocorrelation_correction_is_reported() {
    let t = times(201, 0.025);
    let mut last = 0.0;
    let lasting = |(k, x): (usize, f64)| {
        last = 0.8 * last + 0.005 * noise(k);
        x + last
    };
    let x: Vec<f64> = decay(&t, 2.0, 0.0).into_iter().enumerate().map(lasting).collect();
    let fit = fitted(recording(&t, x), k());
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    let factor = uncertainty.standard_errors[0] / uncertainty.uncorrected_errors().unwrap()[0];
    let finding = fit.findings().iter().find(|f| f.subject == "standard errors").unwrap().to_string();
    let reported = finding.strip_prefix("note: standard errors: the standard errors are ");
    let reported = reported.or_else(|| finding.strip_prefix("note: the standard errors are ")).unwrap();
    let reported: f64 = reported.split(' ').next().unwrap().parse().unwrap();
    assert!(factor > 1.5 && (reported / factor - 1.0).abs() < 0.01, "{factor}: {reported}");
    let sound = fitted(sound(1e-3), k());
    assert!(sound.findings().iter().all(|f| f.subject != "standard errors"), "{sound}");
}

#[test]
fn zero_offset_few_rows_and_loss_are_reported_correctly() {
    let with = |experiment: Experiment, other: Parameter, loss: RobustLoss| {
        let builder = Calibration::builder(open("dahlquist")).experiment(experiment);
        let calibration = builder.parameter(k()).parameter(other).build().unwrap();
        calibration.fit(FitOptions { loss, ..FitOptions::default() }).unwrap()
    };
    let zero = || Parameter::new("zero", 0.0).bounds(-0.5, 0.5).offset_of("x");
    let plain = RobustLoss::default();
    // Zero is a usual value of the offset, so its relative error is not reported.
    let fit = with(sound(1e-2), zero(), plain);
    assert!(!fit.to_string().contains("the standard error of zero"), "{fit}");
    let t = times(3, 0.5);
    let few = with(recording(&t, decay(&t, 2.0, 1e-2)), zero(), plain);
    assert!(few.to_string().contains("Standard errors, with 1 degree of freedom: k"), "{few}");
    // The RMS uses the differences without the loss.
    let robust = with(sound(1e-1), zero(), RobustLoss::new(Loss::SoftL1, 1e-2).unwrap());
    let residuals = &robust.uncertainty.as_ref().unwrap().residuals;
    let rms = (residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64).sqrt();
    assert!((robust.rms - rms).abs() < 1e-12 * rms && rms > 2e-2, "{robust}");
}
