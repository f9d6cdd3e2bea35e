//! Fits with constraints between parameters: `x + k == 3.4`, `x * k <= 2.9`.

use calibration::{
    Calibration, CalibrationBuilder, Data, Experiment, Fit, FitOptions, Parameter, PosteriorOptions,
    ProfileOptions, RunContext,
};
use dfo::{AnyMethod, Checkpoint, QuadraticModel, RunOptions};
use example_models::example_fmu;
use fmi::{Fmu, RunSettings};

const TIMES: usize = 21;

fn time(i: usize) -> f64 {
    0.1 * i as f64
}

/// x(0) = 1.5, x' = -2 x, with a perturbation in place of noise.
fn measured(i: usize) -> f64 {
    1.5 * (-2.0 * time(i)).exp() + 1e-3 * (40.0 * time(i)).sin()
}

/// Sum of squares of the closed form.
fn cost(x0: f64, k: f64) -> f64 {
    (0..TIMES).map(|i| (x0 * (-k * time(i)).exp() - measured(i)).powi(2)).sum()
}

fn builder(constraints: &[&str]) -> CalibrationBuilder {
    let columns = [("x".to_owned(), (0..TIMES).map(measured).collect())];
    let data = Data::from_columns((0..TIMES).map(time).collect(), columns).unwrap();
    let builder = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(Experiment::new(data).output("x", "x"))
        .parameter(Parameter::new("x", 1.0).bounds(0.1, 10.0))
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .settings(RunSettings { relative_tolerance: Some(1e-9), ..RunSettings::default() });
    constraints.iter().fold(builder, |builder, text| builder.constraint(text.parse().unwrap()))
}

fn fitted(constraints: &[&str], method: Option<AnyMethod>) -> (Calibration, Fit) {
    let calibration = builder(constraints).build().unwrap();
    let mut options = FitOptions::default_run();
    if let Some(method) = method {
        options.method = method;
    }
    let fit = calibration.fit(options).unwrap();
    (calibration, fit)
}

/// Returns the minimum of a function of one variable by golden sections.
fn minimum(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..200 {
        let (a, b) = (high - golden * (high - low), low + golden * (high - low));
        if f(a) < f(b) { high = b } else { low = a }
    }
    0.5 * (low + high)
}

fn methods() -> [Option<AnyMethod>; 2] {
    [None, Some(QuadraticModel::default().into())]
}

#[test]
fn linear_equality_holds_and_the_rest_is_fitted() {
    let k = minimum(|k| cost(3.4 - k, k), 0.5, 3.3);
    for method in methods() {
        let (_, fit) = fitted(&["x + k == 3.4"], method);
        assert!(fit.report.is_success(), "{fit}");
        assert!((fit.x[0] + fit.x[1] - 3.4).abs() < 1e-14, "{fit}");
        assert!((fit.x[1] / k - 1.0).abs() < 1e-4, "{k} {fit}");
        let sums = fit.report.trace.iter().map(|e| (e.x[0] + e.x[1] - 3.4).abs());
        assert!(sums.fold(0.0, f64::max) < 1e-14);
    }
}

/// Conditional on x + k = 3.4, there is one direction z = (1, -1): var = s^2 / |J z|^2.
#[test]
fn standard_errors_are_conditional_on_active_constraints() {
    let (_, fit) = fitted(&["x + k == 3.4"], None);
    let (x0, k) = (fit.x[0], fit.x[1]);
    let along = |t: f64| (-k * t).exp() * (1.0 + x0 * t);
    let squares: f64 = (0..TIMES).map(|i| along(time(i)).powi(2)).sum();
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    assert_eq!(uncertainty.active_constraints, ["x + k == 3.4"]);
    assert!(uncertainty.held.is_empty());
    assert_eq!(uncertainty.degrees_of_freedom, TIMES as f64 - 1.0);
    // The errors of independent residuals; the perturbation is autocorrelated.
    let covariance = uncertainty.uncorrected_covariance.as_ref().unwrap_or(&uncertainty.covariance);
    let variance = cost(x0, k) / (TIMES as f64 - 1.0) / squares;
    for (entry, sign) in covariance.iter().zip([1.0, -1.0, -1.0, 1.0]) {
        assert!((entry / (sign * variance) - 1.0).abs() < 2e-2, "{covariance:?} {variance}");
    }
    assert!(uncertainty.message().contains("active constraints: 'x + k == 3.4'"));
    assert!(fit.to_string().contains("conditional on the active constraints 'x + k == 3.4'"), "{fit}");
    // Correlations along the constraint do not come from the measurements.
    assert!(uncertainty.confounded.is_empty());
    assert!(!fit.to_string().contains("F007"), "{fit}");
}

#[test]
fn inactive_inequality_changes_nothing() {
    let (_, free) = fitted(&[], None);
    let (_, fit) = fitted(&["x <= k"], None);
    let uncertainty = fit.uncertainty.as_ref().unwrap();
    assert!(uncertainty.active_constraints.is_empty());
    for i in 0..2 {
        let errors = [&free, &fit].map(|fit| fit.uncertainty.as_ref().unwrap().standard_errors[i]);
        assert!((errors[0] / errors[1] - 1.0).abs() < 1e-2, "{errors:?}");
        assert!((fit.x[i] - free.x[i]).abs() < 0.05 * errors[0], "{} {}", fit.x[i], free.x[i]);
    }
}

#[test]
fn nonlinear_inequality_is_active_at_the_result() {
    let k = minimum(|k| cost(2.9 / k, k), 1.0, 4.0);
    for method in methods() {
        let (_, fit) = fitted(&["x * k <= 2.9"], method);
        assert!(fit.report.is_success(), "{fit}");
        assert!(fit.x[0] * fit.x[1] <= 2.9 + 1e-6 && fit.report.constr_violation <= 1e-6, "{fit}");
        assert!((fit.x[1] / k - 1.0).abs() < 1e-3, "{k} {fit}");
        let uncertainty = fit.uncertainty.as_ref().unwrap();
        assert_eq!(uncertainty.active_constraints, ["x * k <= 2.9"]);
        // Along the constraint, dx / x = -dk / k.
        let errors = &uncertainty.standard_errors;
        assert!((errors[0] / fit.x[0] / (errors[1] / fit.x[1]) - 1.0).abs() < 1e-3, "{errors:?}");
    }
}

#[test]
fn profile_and_posterior_stay_within_constraints() {
    let (calibration, fit) = fitted(&["x >= 1.5"], None);
    let context = RunContext::new();
    let profile = calibration.profile(&fit, &ProfileOptions::default(), &context).unwrap();
    let of_x = &profile.parameters[0];
    assert!(of_x.points.iter().all(|point| point.x[0] >= 1.5), "{of_x:?}");
    let options = PosteriorOptions { n_steps: 200, seed: Some(3), ..Default::default() };
    let posterior = calibration.sample(&fit, &options, &mut |_| (), &context).unwrap();
    assert!(posterior.interval(0, 0.99).0 >= 1.5);
    let (calibration, fit) = fitted(&["x + k == 3.4"], None);
    let error = calibration.sample(&fit, &options, &mut |_| (), &context).unwrap_err().to_string();
    assert!(error.contains("'x + k == 3.4' cannot be sampled"), "{error}");
}

#[test]
fn contradictions_and_unsupported_methods_are_named() {
    let calibration = builder(&["x + k <= 3", "2*x + k >= 7.5", "k >= 1"]).build().unwrap();
    let error = calibration.fit(FitOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no parameter values satisfy the constraints"), "{error}");
    let options = RunOptions { method: "barrier".parse().unwrap(), ..FitOptions::default_run() };
    let error = builder(&["x <= k"]).build().unwrap().fit(options).unwrap_err().to_string();
    assert!(error.contains("barrier does not support linear constraints; use"), "{error}");
}

/// The limits of both fits are equal, so only the formulas differ.
#[test]
fn checkpoint_of_a_fit_with_other_constraints_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = |constraint: &str| {
        let checkpoint = Some(Checkpoint::new(folder.path().join("fit")));
        let options = RunOptions { checkpoint, ..FitOptions::default_run() };
        builder(&[constraint]).build().unwrap().fit(options)
    };
    run("x * k <= 2.9").unwrap();
    let error = run("x * sqrt(k) <= 2.9").unwrap_err().to_string();
    assert!(error.contains("constraints") && error.contains("x * sqrt(k) <= 2.9"), "{error}");
}

#[test]
fn goodness_counts_independent_equalities() {
    for (constraints, nvarys) in
        [(&[][..], 2), (&["x <= k"], 2), (&["x + k == 3.4"], 1), (&["x + k == 3.4", "2*x + 2*k == 6.8"], 1)]
    {
        let (_, fit) = fitted(constraints, None);
        let goodness = fit.goodness();
        assert_eq!((goodness.nvarys, goodness.nfree), (nvarys, TIMES - nvarys), "{constraints:?}");
    }
}

#[test]
fn profile_refits_within_nonlinear_constraints() {
    let (calibration, fit) = fitted(&["x * k <= 2.9"], None);
    let profile = calibration.profile(&fit, &ProfileOptions::default(), &RunContext::new()).unwrap();
    for of in &profile.parameters {
        assert!(of.points.len() > 4, "{of:?}");
        assert!(of.points.iter().all(|point| point.x[0] * point.x[1] <= 2.9 + 2e-6), "{of:?}");
    }
}
