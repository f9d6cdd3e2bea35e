//! Mistakes in parameters, priors, weights and solvers.

use super::{calibration, decay, fitted, k, noise, open, sound, times, warnings, warns};
use calibration::dfo::{Limits, RunOptions, StopRule, Termination, ToleranceMeasure, Tolerances};
use calibration::{
    Calibration, CheckOptions, Data, Experiment, FitOptions, NoiseRule, Parameter, Prior, RunContext, Scale,
    SimulationSettings, Stage, Weight,
};
use fmi::RunSettings;
use ode::Method;
use std::time::Duration;

#[test]
fn large_fixed_step_is_compared_with_half_the_step() {
    let settings = |method, step| RunSettings { method, step_size: Some(step), ..RunSettings::default() };
    // One step of Euler's method multiplies by 1 - k h instead of exp(-k h).
    // It is exact for k = (1 - exp(-0.5)) / 0.25 = 1.574.
    let coarse = calibration(vec![sound(1e-3)], k(), settings(Method::Euler, 0.25));
    let check = coarse.check();
    assert!(warns(&check.findings, "half the step of the solver 'euler' changes 'x'"), "{check}");
    // The start is simulated twice: as given, and with half the step.
    assert_eq!(check.n_evaluations, 2);
    let preflight = coarse.preflight(&calibration::PreflightOptions::default(), &RunContext::new()).unwrap();
    assert!(
        preflight.is_step_halved
            && preflight.to_string().contains("with half the step. Smaller changes")
            && preflight.to_string().contains("\n         -> Set a smaller step_size than 0.25")
    );
    assert!(preflight.parameters[0].has_effect);
    // The search is long enough for one more simulation.
    let run = dfo::RunOptions { method: dfo::NelderMead::default().into(), ..FitOptions::default_run() };
    let fit = coarse.fit(FitOptions { preflight: true, run, ..FitOptions::default() }).unwrap();
    assert!(fit.report.is_success() && (fit.x[0] - 1.6).abs() < 0.1, "{fit}");
    assert!(warns(&fit.findings(), "with half the step"), "{fit}");
    // The error of a fixed step is not noise, so it is not a reason to end early.
    assert!(!fit.to_string().contains("F026"), "{fit}");
    let mae =
        || FitOptions { objective: calibration::CostKind::of_name("mae").unwrap(), ..FitOptions::default() };
    let reported = "half the step of the solver 'euler' changes 'x'";
    for fit in [coarse.fit(mae()).unwrap(), coarse.fit_stages(&[Stage::new(["k"])], mae()).unwrap()] {
        assert!(fit.uncertainty.is_none() && warns(&fit.findings(), reported), "{fit}");
    }
    let fine = calibration(vec![sound(1e-3)], k(), settings(Method::Rk4, 0.01));
    assert!(
        fine.check().is_ok() && warnings(&fine.fit(FitOptions::default()).unwrap().findings()).is_empty()
    );
}

#[test]
fn contradicted_priors_are_reported() {
    let with_prior = |sd: f64, mean: f64, weight: f64, rule| {
        let t = times(61, 0.05);
        let x = decay(&t, 2.0, 1e-2);
        let data = Data::from_columns(t, [("x".to_owned(), x)]).unwrap();
        let experiment = Experiment::new(data).weighted_output("x", "x", Weight::Constant(weight));
        let parameter = k().prior(Prior::Normal { mean, sd });
        let calibration = calibration(vec![experiment], parameter, SimulationSettings::default());
        calibration.fit(FitOptions { noise: rule, ..FitOptions::default() }).unwrap()
    };
    let reported = "contradicts the measurements, which lead to a smaller value";
    for (sd, wins) in [(1e-4, 3.0), (0.1, 2.0)] {
        let fit = with_prior(sd, 3.0, 1.0, NoiseRule::Auto);
        assert!((fit.x[0] - wins).abs() < 0.1 && warns(&fit.findings(), reported), "{sd}: {fit}");
    }
    // The standard deviation of the noise is 0.0058.
    let fit = with_prior(0.5, 2.0, 1.0, NoiseRule::Auto);
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
    let fit = with_prior(0.5, 2.0, 170.0, NoiseRule::Auto);
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
    for (weight, reported) in
        [(0.0058, "Check that the weights are 1/sigma and not sigma"), (1e4, "priors count too little")]
    {
        let fit = with_prior(0.5, 2.0, weight, NoiseRule::Auto);
        assert!(warns(&fit.findings(), reported), "{weight}: {fit}");
    }
}

#[test]
fn note_on_priors_describes_the_fit() {
    let calibration = calibration(
        vec![sound(1e-2)],
        k().prior(Prior::Normal { mean: 2.0, sd: 1.0 }),
        SimulationSettings::default(),
    );
    let check = calibration.check().to_string();
    assert!(check.contains("A fit of the sum of squares estimates the noise"), "{check}");
}

#[test]
fn starts_far_from_model_values_are_reported() {
    let check = |parameter: Parameter| {
        calibration(vec![sound(1e-3)], parameter, SimulationSettings::default()).check()
    };
    let far = check(Parameter::new("k", 2e3).bounds(1.0, 1e4));
    assert!(warns(&far.findings, "start 2000 is 2000 times the start value 1 of the model"), "{far}");
    // A start that the fit has left is not reported any more.
    let fit = fitted(sound(1e-3), Parameter::new("k", 1e-3).bounds(1e-4, 10.0).scale(Scale::Log));
    assert!((fit.x[0] - 2.0).abs() < 0.01 && !warns(&fit.findings(), "F058"), "{fit}");
    // The start value is in degC.
    let t = times(60, 2.0);
    let outlet = t.iter().map(|t| 300.0 + 0.1 * t).collect();
    let data = Data::from_columns(t, [("T_out".to_owned(), outlet)]).unwrap();
    let check = Calibration::builder(open("exhaust"))
        .experiment(
            Experiment::new(data)
                .output("T_out", "T_out")
                .start_value("T1", 25.0)
                .constant_input("T_in", 30.0),
        )
        .parameter(Parameter::new("C1", 2500.0).bounds(1.0, 50e3))
        .build()
        .unwrap()
        .check_with(&CheckOptions { simulate: false, max_time: None }, &RunContext::new())
        .unwrap();
    assert!(
        warns(
            &check.findings,
            "start value of 'T1': the value is 25 K, but the start value of the model is 480, as with degC"
        ),
        "{check}"
    );
    assert!(warns(&check.findings, "constant input of 'T_in': the value is 30 K"), "{check}");
}

#[test]
fn search_ended_before_minimum_is_reported() {
    // There are two outputs, far from the minimum; one of them hardly counts.
    let t = times(61, 0.05);
    let slope = t.iter().enumerate().map(|(k, t)| -2.0 * (-2.0 * t).exp() + 1e-3 * noise(k)).collect();
    let columns = [("x".to_owned(), decay(&t, 2.0, 1e-3)), ("slope".to_owned(), slope)];
    let experiment = Experiment::new(Data::from_columns(t, columns).unwrap())
        .output("x", "x")
        .weighted_output("der(x)", "slope", 0.1);
    let calibration = calibration(vec![experiment], k(), SimulationSettings::default());
    let limits = Limits { max_evaluations: Some(3), ..Limits::default() };
    let run = RunOptions {
        limits,
        method: calibration::dfo::NelderMead::default().into(),
        ..FitOptions::default_run()
    };
    let fit = calibration.fit(run).unwrap();
    let uncertainty = fit.uncertainty.as_ref().map(|uncertainty| uncertainty.achievable_decrease);
    let at = calibration
        .uncertainty(&fit.x, &calibration::UncertaintyOptions::default(), &RunContext::new())
        .unwrap();
    assert!(uncertainty.is_none_or(|left| left > 0.9) && at.achievable_decrease > 0.9, "{fit}");
    assert!(warns(&at.findings, "The search ended before the minimum"), "{at}");
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert_eq!(fit.uncertainty.as_ref().unwrap().achievable_decrease, 0.0, "{fit}");
    assert!(fit.is_success(), "{fit}");
    // A search with loose tolerances is not a success, even if its own criteria are met.
    let tolerances =
        Tolerances { x_tol: 0.5, f_tol: 1e-4, measure: ToleranceMeasure::Relative, stop: StopRule::Any };
    let method = calibration::dfo::NelderMead::default().into();
    let run = RunOptions { tolerances, method, ..FitOptions::default_run() };
    let fit = calibration.fit(run).unwrap();
    assert_eq!(fit.report.termination, Termination::BeforeMinimum, "{fit}");
    assert!(fit.report.message.contains("% of the cost; converged") && !fit.is_success(), "{fit}");
    assert!(fit.to_string().contains("The fit ended before the minimum"), "{fit}");
}

#[test]
fn fit_without_time_reports_findings_that_need_no_simulation() {
    let parameter = Parameter::new("k", 2e3).bounds(1.0, 1e4);
    let calibration = calibration(vec![sound(1e-3)], parameter, SimulationSettings::default());
    let limits = Limits { max_time: Some(Duration::from_nanos(1)), ..Limits::default() };
    let fit = calibration.fit(RunOptions { limits, ..FitOptions::default_run() }).unwrap();
    assert!(warns(&fit.findings(), "start 2000 is 2000 times the start value 1 of the model"), "{fit}");
}

#[test]
fn check_ends_at_its_time_limit() {
    let calibration = calibration(vec![sound(1e-3)], k(), SimulationSettings::default());
    let options = CheckOptions { max_time: Some(Duration::from_nanos(1)), ..CheckOptions::default() };
    let check = calibration.check_with(&options, &RunContext::new()).unwrap();
    assert!(warns(&check.findings, "max_time: the time limit of 1e-9 s ended the check"), "{check}");
    assert!(calibration.check().is_ok());
}
