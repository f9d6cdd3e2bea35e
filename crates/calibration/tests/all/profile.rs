//! Profile likelihoods compared with closed forms.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    Calibration, CalibrationError, CostKind, Data, Estimator, Experiment, Fit, FitOptions, NamedCost,
    Parameter, Profile, ProfileEnd, ProfileOptions, Scale, UncertaintyOptions,
};
use example_models::example_fmu;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::path::Path;

fn open(name: &str) -> fmi::Fmu {
    fmi::Fmu::open(example_fmu(name).unwrap()).unwrap()
}

fn data(time: &[f64], columns: &[(&str, Vec<f64>)]) -> Data {
    let columns = columns.iter().map(|(name, values)| ((*name).to_owned(), values.clone()));
    Data::from_columns(time.to_vec(), columns).unwrap()
}

fn near(got: f64, expected: f64, within: f64) {
    assert!((got - expected).abs() <= within, "{got} instead of {expected}");
}

/// Numbers between -1 and 1 that look random.
fn noise(n: usize) -> impl Iterator<Item = f64> {
    (0..n).map(|k| 2.0 * ((k as f64 * 12.9898).sin() * 43758.5453).abs().fract() - 1.0)
}

fn fitted(calibration: &Calibration, options: FitOptions<'_>) -> Fit {
    calibration.fit(options).unwrap()
}

fn profile(calibration: &Calibration, fit: &Fit, options: &ProfileOptions) -> Profile {
    calibration.profile(fit, options, &RunContext::new()).unwrap()
}

/// x = x0 exp(-k t), with noise.
fn decay(parameters: impl IntoIterator<Item = Parameter>) -> Calibration {
    let time: Vec<f64> = (0..30).map(|k| 0.1 * f64::from(k)).collect();
    let x = time.iter().zip(noise(30)).map(|(t, e)| (-1.5 * t).exp() + 0.1 * e).collect();
    let builder = Calibration::builder(open("dahlquist"))
        .experiment(Experiment::new(data(&time, &[("x", x)])).output("x", "x"));
    parameters.into_iter().fold(builder, |builder, p| builder.parameter(p)).build().unwrap()
}

/// h = h0 + v0 t without gravity, and v = v0: a linear model with two outputs whose weights declare no
/// errors.
fn line() -> Calibration {
    let time: Vec<f64> = (0..50).map(|k| 0.01 * f64::from(k)).collect();
    let e: Vec<f64> = noise(100).collect();
    let h = time.iter().zip(&e).map(|(t, e)| 10.0 + 2.0 * t + 0.3 * e).collect();
    let v = e[50..].iter().map(|e| 2.0 + 0.05 * e).collect();
    let rows = (0..50).map(|_| 2.0).collect();
    let experiment = Experiment::new(data(&time, &[("h", h), ("v", v), ("w", rows)]))
        .output("h", "h")
        .weighted_output("v", "v", calibration::Weight::Column("w".to_owned()))
        .start_value("g", 0.0);
    Calibration::builder(open("bouncing_ball"))
        .experiment(experiment)
        .parameter(Parameter::new("h", 9.0))
        .parameter(Parameter::new("v", 1.0))
        .build()
        .unwrap()
}

#[test]
fn profile_interval_matches_covariance_for_linear_model() {
    let calibration = line();
    for estimator in [Estimator::Sandwich, Estimator::Pooled] {
        let uncertainty = Some(UncertaintyOptions { estimator, ..UncertaintyOptions::default() });
        let fit = fitted(&calibration, FitOptions { uncertainty, ..FitOptions::default() });
        let options = ProfileOptions { is_corrected: false, ..ProfileOptions::default() };
        let found = profile(&calibration, &fit, &options);
        let r = calibration.residuals(&fit.x, &RunContext::new()).unwrap();
        // (J'J)^-1 J'SJ (J'J)^-1 with the rows (1, t) of h and (0, 2) of v.
        // The residuals are M = I - J (J'J)^-1 J' times the errors. The variances follow from the means
        // tr(P M S M) of the sums of squares, of both outputs or of all rows.
        let jacobian = DMatrix::from_fn(100, 2, |i, k| match (i < 50, k) {
            (true, 0) => 1.0,
            (true, _) => 0.01 * i as f64,
            (false, k) => 2.0 * k as f64,
        });
        let inverse = (jacobian.transpose() * &jacobian).try_inverse().unwrap();
        let m = DMatrix::identity(100, 100) - &jacobian * &inverse * jacobian.transpose();
        let n = if estimator == Estimator::Pooled { 1 } else { 2 };
        let groups: Vec<_> = (0..n).map(|g| g * 100 / n..(g + 1) * 100 / n).collect();
        let of = |g: usize| {
            DMatrix::from_diagonal(&DVector::from_fn(100, |i, _| f64::from(u8::from(groups[g].contains(&i)))))
        };
        let means = DMatrix::from_fn(n, n, |g, h| (of(g) * &m * of(h) * &m).trace()).try_inverse().unwrap();
        let squares = groups.iter().map(|rows| r[rows.clone()].iter().map(|r| r * r).sum::<f64>());
        let variances = &means * DVector::from_iterator(n, squares);
        let s = (0..n).fold(DMatrix::zeros(100, 100), |s, g| s + of(g) * variances[g]);
        let quadratic = |g: usize| of(g) * &m * &s * &m;
        let of_squares = DMatrix::from_fn(n, n, |g, h| 2.0 * (quadratic(g) * quadratic(h)).trace());
        let of_variances = &means * of_squares * means.transpose();
        let middle = &inverse * jacobian.transpose();
        let covariance = |s: &DMatrix<f64>| &middle * s * middle.transpose();
        let errors = covariance(&s).diagonal().map(f64::sqrt);
        // Degrees of freedom of Satterthwaite.
        let quantile = |degrees: f64| StudentsT::new(0.0, 1.0, degrees).unwrap().inverse_cdf(0.975);
        let t = |k: usize| {
            let by = DVector::from_fn(n, |g, _| covariance(&of(g))[(k, k)]);
            quantile(2.0 * errors[k].powi(4) / by.dot(&(&of_variances * &by)))
        };
        near(found.threshold, quantile(98.0).powi(2), 1e-5);
        assert_eq!(found.degrees_of_freedom, 98.0);
        for (k, p) in found.parameters.iter().enumerate() {
            let (low, high) = p.interval();
            let quantile = t(k);
            near(low, found.x[k] - quantile * errors[k], 0.01 * errors[k]);
            near(high, found.x[k] + quantile * errors[k], 0.01 * errors[k]);
            // The profile is a parabola with about five steps on each side, the first ones near the optimum.
            assert!((9..=19).contains(&p.points.len()), "{}", p.points.len());
            let near_optimum =
                p.points.iter().filter(|point| point.statistic < 0.1 * found.threshold).count();
            assert!(near_optimum >= 3, "{p:?}");
            for point in &p.points {
                let z = (point.value - found.x[k]) / (errors[k] * quantile);
                near(point.statistic, found.threshold * z * z, 0.01);
                assert_eq!(point.x[k], point.value);
            }
            assert!(p.points.is_sorted_by(|a, b| a.value < b.value) && p.message().is_empty());
            // The profile is centred at the optimum of the fit.
            near(found.x[k], fit.x[k], 0.02 * errors[k]);
        }
        assert!(!found.is_interrupted && found.stats.right_hand_sides > 0 && found.n_simulations > 50);
    }
}

#[test]
fn profile_width_matches_standard_errors_with_loss_and_correlation() {
    let interval = |fit: &Fit, calibration: &Calibration, options: &ProfileOptions| {
        let found = profile(calibration, fit, options);
        (found.parameters[0].interval(), found.is_autocorrelated)
    };
    let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 5.0), Parameter::new("x", 1.0)]);
    let loss = dfo::RobustLoss::new(dfo::Loss::SoftL1, 0.1).unwrap();
    let fit = fitted(&calibration, FitOptions { loss, ..FitOptions::default() });
    let ((low, high), _) = interval(&fit, &calibration, &ProfileOptions::default());
    let (lower, upper) = fit.uncertainty.as_ref().unwrap().confidence_intervals(0.95).unwrap()[0];
    assert!(((high - low) / (upper - lower) - 1.0).abs() < 0.15, "{low} {high} {lower} {upper}");

    // The level is low because one smooth misfit leaves few degrees of freedom, and a decay is not linear
    // that far.
    let time: Vec<f64> = (0..80).map(|k| 0.05 * f64::from(k)).collect();
    let x = time.iter().map(|t| (-1.5 * t).exp() + 0.02 * (4.0 * t).sin()).collect();
    let calibration = Calibration::builder(open("dahlquist"))
        .experiment(Experiment::new(data(&time, &[("x", x)])).output("x", "x"))
        .parameter(Parameter::new("k", 1.0))
        .build()
        .unwrap();
    let fit = fitted(&calibration, FitOptions::default());
    for is_corrected in [true, false] {
        let options = ProfileOptions { is_corrected, level: 0.5, ..ProfileOptions::default() };
        let ((low, high), is_autocorrelated) = interval(&fit, &calibration, &options);
        let uncertainty = fit.uncertainty.as_ref().unwrap();
        let uncertainty = if is_corrected { uncertainty.clone() } else { uncertainty.uncorrected() };
        let (lower, upper) = uncertainty.confidence_intervals(0.5).unwrap()[0];
        assert!(((high - low) / (upper - lower) - 1.0).abs() < 0.1, "{low} {high} {lower} {upper}");
        assert_eq!(is_autocorrelated, is_corrected);
    }
}

#[test]
fn profile_of_single_parameter_works_on_both_scales() {
    // The statistic of a single parameter is the cost itself.
    for scale in [Scale::Linear, Scale::Log] {
        let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 5.0).scale(scale)]);
        let fit = fitted(&calibration, FitOptions::default());
        let found = profile(&calibration, &fit, &ProfileOptions { level: 0.9, ..ProfileOptions::default() });
        let (low, high) = found.parameters[0].interval();
        let variance = fit.cost / 29.0;
        for end in [low, high] {
            let rise = (calibration.cost(&[end], &RunContext::new()).unwrap() - fit.cost) / variance;
            near(rise, found.threshold, 0.01 * found.threshold);
        }
        // The data distinguish fast decays less well than slow ones.
        assert!(high - fit.x[0] > 1.02 * (fit.x[0] - low), "{low} {high}");
        let text = found.to_string();
        assert!(text.contains("90 % intervals") && text.contains("29 degrees of freedom"), "{text}");
    }
}

#[test]
fn profile_reports_open_ends() {
    let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 1.55), Parameter::new("x", 1.0)]);
    let fit = fitted(&calibration, FitOptions::default());
    let found = profile(&calibration, &fit, &ProfileOptions::default());
    let [k, x] = &found.parameters[..] else { panic!("{found}") };
    assert_eq!((&k.upper, k.interval().1), (&ProfileEnd::AtBound(1.55), f64::INFINITY));
    assert!(k.interval().0 > 0.5 && x.interval().0.is_finite() && x.interval().1.is_finite());
    let reported = "k: open towards larger values: reaches its upper bound, 1.55";
    assert!(found.to_string().contains(reported), "{found}");
    // A parameter at its bound has one side. In the profile of the other parameter, it may leave its bound.
    let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 1.2), Parameter::new("x", 1.0)]);
    let fit = fitted(&calibration, FitOptions::default());
    let found = profile(&calibration, &fit, &ProfileOptions::default());
    assert_eq!((fit.at_bound.len(), &found.parameters[0].upper), (1, &ProfileEnd::AtBound(1.2)));
    assert!(found.parameters[0].interval().0 < 1.2);
    // The first coefficient of restitution has no effect before the ball has fallen.
    let time: Vec<f64> = (0..40).map(|k| 0.01 * f64::from(k)).collect();
    let h = time.iter().zip(noise(40)).map(|(t, e)| 1.0 - 0.5 * 9.81 * t * t + 1e-3 * e).collect();
    let calibration = Calibration::builder(open("bouncing_ball"))
        .experiment(Experiment::new(data(&time, &[("h", h)])).output("h", "h"))
        .parameter(Parameter::new("e", 0.7).bounds(0.1, 0.95))
        .parameter(Parameter::new("g", -9.0).bounds(-15.0, -5.0))
        .build()
        .unwrap();
    let fit = fitted(&calibration, FitOptions::default());
    let few = ProfileOptions { max_points: 2, ..ProfileOptions::default() };
    let found = profile(&calibration, &fit, &few);
    assert!(matches!(found.parameters[0].lower, ProfileEnd::PointLimit(_)), "{found}");
    let found = profile(&calibration, &fit, &ProfileOptions::default());
    assert_eq!(
        (&found.parameters[0].lower, &found.parameters[0].upper),
        (&ProfileEnd::AtBound(0.1), &ProfileEnd::AtBound(0.95))
    );
    assert!(found.parameters[1].message().is_empty(), "{found}");
}

#[test]
fn profile_of_confounded_parameters_extends_to_bounds_of_others() {
    // The data determine the sum of a height and an offset between -0.5 and 1.
    let (n, time) = (40_u32, (0..40).map(|k| 0.01 * f64::from(k)).collect::<Vec<f64>>());
    let h: Vec<f64> = noise(40).map(|e| 10.0 + 0.05 * e).collect();
    let mean = h.iter().sum::<f64>() / f64::from(n);
    let calibration = Calibration::builder(open("bouncing_ball"))
        .experiment(
            Experiment::new(data(&time, &[("h", h)]))
                .output("h", "h")
                .start_value("g", 0.0)
                .start_value("v", 0.0),
        )
        .parameter(Parameter::new("h", 9.9))
        .parameter(Parameter::new("o", 0.1).bounds(-0.5, 1.0).offset_of("h"))
        .build()
        .unwrap();
    let fit = fitted(&calibration, FitOptions::default());
    assert_eq!(fit.uncertainty.as_ref().unwrap().undetermined, [0, 1]);
    let found = profile(&calibration, &fit, &ProfileOptions::default());
    let beyond = (found.threshold * fit.cost / f64::from(n - 2) / f64::from(n)).sqrt();
    let (low, high) = found.parameters[0].interval();
    near(low, mean - 1.0 - beyond, 2e-3);
    near(high, mean + 0.5 + beyond, 2e-3);
    let open = [&found.parameters[1].lower, &found.parameters[1].upper];
    assert_eq!(open, [&ProfileEnd::AtBound(-0.5), &ProfileEnd::AtBound(1.0)]);
}

fn without_stats(mut profile: Profile) -> Profile {
    profile.stats = ode::Stats::default();
    profile
}

#[test]
fn profile_is_unchanged_by_workers_interrupts_and_files() {
    let calibration = decay([Parameter::new("k", 1.0).bounds(0.1, 5.0), Parameter::new("x", 1.2)]);
    let fit = fitted(&calibration, FitOptions::default());
    let with = |workers, checkpoint: Option<&Path>| ProfileOptions {
        workers: Some(workers),
        checkpoint: checkpoint.map(Path::to_owned),
        ..ProfileOptions::default()
    };
    let whole = without_stats(profile(&calibration, &fit, &with(1, None)));
    assert_eq!(whole, without_stats(profile(&calibration, &fit, &with(3, None))));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("profile.json");
    let n_saved = || std::fs::read_to_string(&file).unwrap_or_default().matches("\"side\"").count();
    let cut = calibration
        .profile(&fit, &with(1, Some(&file)), &RunContext::new().polling(&|| n_saved() > 1))
        .unwrap();
    assert!(cut.is_interrupted && cut.to_string().contains("interrupted"), "{cut}");
    assert_eq!((n_saved(), &cut.parameters[0]), (2, &whole.parameters[0]));
    assert_eq!(cut.parameters[1].upper, ProfileEnd::Interrupted);
    let resumed = profile(&calibration, &fit, &with(3, Some(&file)));
    assert_eq!((n_saved(), &without_stats(resumed)), (4, &whole));
    let again = profile(&calibration, &fit, &with(1, Some(&file)));
    assert!(again.n_simulations == whole.n_simulations && n_saved() == 4);
    let cancelled =
        calibration.profile(&fit, &with(1, None), &RunContext::new().polling(&|| true)).unwrap_err();
    assert!(matches!(cancelled, CalibrationError::Cancelled));

    let refused = |options: ProfileOptions| {
        calibration.profile(&fit, &options, &RunContext::new()).map(|_| ()).unwrap_err().to_string()
    };
    let reported = refused(ProfileOptions { level: 0.9, ..with(1, Some(&file)) });
    assert!(reported.contains("another fit") && reported.contains("profile.json"), "{reported}");
    std::fs::write(&file, "x").unwrap();
    assert!(refused(with(1, Some(&file))).contains("not a file of profiles"));
    assert!(refused(with(1, Some(&folder.path().join("none/p.json")))).contains("none"));
    assert!(refused(ProfileOptions { level: 95.0, ..with(1, None) }).contains("between 0 and 1"));
    assert!(
        refused(ProfileOptions { parameters: Some(vec![2]), ..with(1, None) })
            .contains("number of parameters, 2")
    );
    assert!(refused(ProfileOptions { parameters: Some(vec![1, 1]), ..with(1, None) }).contains("twice"));
    assert!(refused(ProfileOptions { max_points: 0, ..with(1, None) }).contains("at least one point"));
}

#[test]
fn profile_rejects_unsupported_fits() {
    let calibration =
        decay([Parameter::new("k", 1.0).bounds(0.1, 5.0), Parameter::new("x", 1.0).fixed(true)]);
    let fit = fitted(&calibration, FitOptions::default());
    let fixed = ProfileOptions { parameters: Some(vec![1]), ..ProfileOptions::default() };
    let reported = calibration.profile(&fit, &fixed, &RunContext::new()).unwrap_err().to_string();
    assert!(reported.contains("'x' has no profile because it was not fitted"), "{reported}");
    assert_eq!(profile(&calibration, &fit, &ProfileOptions::default()).parameters.len(), 1);
    let mae = FitOptions { objective: CostKind::Named(NamedCost::Mae), ..FitOptions::default() };
    let fit = fitted(&calibration, mae);
    let reported =
        calibration.profile(&fit, &ProfileOptions::default(), &RunContext::new()).unwrap_err().to_string();
    assert!(reported.contains("requires a sum of squares") && reported.contains("mae"), "{reported}");
}
