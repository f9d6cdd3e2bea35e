//! Fits of setups with one mistake each name it, and sound ones are not accused of any.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::dfo::{Limits, Loss, Measure, RobustLoss, RunOptions, Stop, Tolerances};
use calibration::{
    Calibration, CheckOptions, Compared, CostKind, CustomCost, Data, Experiment, Finding, Fit, FitOptions,
    NoiseRule, Parameter, Parts, Prior, Scale, Severity, SimulationSettings, Stage, UncertaintyOptions,
    Weight,
};
use example_models::example_fmu;
use fmi::Fmu;
use ode::Method;
use std::path::Path;
use std::time::Duration;

fn open(model: &str) -> Fmu {
    Fmu::open(example_fmu(model).unwrap()).unwrap()
}

/// A pseudo-random number from -1 to 1.
fn noise(k: usize) -> f64 {
    2.0 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract().abs() - 1.0
}

fn times(n: usize, interval: f64) -> Vec<f64> {
    (0..n).map(|k| interval * k as f64).collect()
}

/// `exp(-rate t)` with noise of this size.
fn decay(t: &[f64], rate: f64, size: f64) -> Vec<f64> {
    t.iter().enumerate().map(|(k, t)| (-rate * t).exp() + size * noise(k)).collect()
}

fn recording(t: &[f64], x: Vec<f64>) -> Experiment {
    Experiment::new(Data::from_columns(t.to_vec(), [("x".to_owned(), x)]).unwrap()).output("x", "x")
}

fn k() -> Parameter {
    Parameter::new("k", 1.5).bounds(0.1, 10.0)
}

/// Of x' = -k x with x(0) = 1.
fn calibration(
    experiments: Vec<Experiment>,
    parameter: Parameter,
    settings: SimulationSettings,
) -> Calibration {
    let builder = Calibration::builder(open("dahlquist")).parameter(parameter).settings(settings);
    experiments.into_iter().fold(builder, calibration::CalibrationBuilder::experiment).build().unwrap()
}

/// A decay with k = 2 in 61 rows over 3 s.
fn sound(size: f64) -> Experiment {
    let t = times(61, 0.05);
    recording(&t, decay(&t, 2.0, size))
}

fn fitted(experiment: Experiment, parameter: Parameter) -> Fit {
    let fit = calibration(vec![experiment], parameter, SimulationSettings::default());
    fit.fit(FitOptions::default()).unwrap()
}

fn warns(findings: &[Finding], text: &str) -> bool {
    findings.iter().any(|f| f.severity != Severity::Note && f.to_string().contains(text))
}

fn warnings(findings: &[Finding]) -> Vec<String> {
    findings.iter().filter(|f| f.severity != Severity::Note).map(ToString::to_string).collect()
}

#[test]
fn a_sound_fit_has_no_warnings() {
    let fit = fitted(sound(1e-3), k());
    assert!((fit.x[0] - 2.0).abs() < 0.01 && warnings(&fit.findings()).is_empty(), "{fit}");
}

#[test]
fn a_fixed_step_that_is_too_large_is_compared_with_half_of_it() {
    let settings =
        |method, step| SimulationSettings { method, step_size: Some(step), ..SimulationSettings::default() };
    // One step of Euler's method multiplies with 1 - k h instead of exp(-k h): it is right with k = (1 - exp(-0.5)) / 0.25 = 1.574.
    let coarse = calibration(vec![sound(1e-3)], k(), settings(Method::Euler, 0.25));
    let check = coarse.check();
    assert!(warns(&check.findings, "half the step of the solver 'euler' changes 'x'"), "{check}");
    // At the start, with half the step, and between the rows.
    assert_eq!(check.n_evaluations, 3);
    let preflight = coarse.preflight(&calibration::PreflightOptions::default(), &RunContext::new()).unwrap();
    assert!(preflight.is_step_halved && preflight.to_string().contains("with half the step: give a smaller"));
    assert!(preflight.parameters[0].has_effect);
    let fit = coarse.fit(FitOptions { preflight: true, ..FitOptions::default() }).unwrap();
    assert!(fit.report.is_success() && (fit.x[0] - 1.6).abs() < 0.1, "{fit}");
    assert!(warns(&fit.findings(), "with half the step"), "{fit}");
    // The error of a fixed step is no noise, and no reason to end early.
    assert!(!fit.to_string().contains("f_tol was raised"), "{fit}");
    let mae =
        || FitOptions { objective: calibration::CostKind::of_name("mae").unwrap(), ..FitOptions::default() };
    let said = "half the step of the solver 'euler' changes 'x'";
    for fit in [coarse.fit(mae()).unwrap(), coarse.fit_stages(&[Stage::new(["k"])], mae()).unwrap()] {
        assert!(fit.uncertainty.is_none() && warns(&fit.findings(), said), "{fit}");
    }
    let fine = calibration(vec![sound(1e-3)], k(), settings(Method::Rk4, 0.01));
    assert!(
        fine.check().is_ok() && warnings(&fine.fit(FitOptions::default()).unwrap().findings()).is_empty()
    );
}

#[test]
fn times_in_minutes_are_named() {
    let minutes: Vec<f64> = times(55, 1.0 / 300.0);
    let x = decay(&minutes, 60.0, 1e-3);
    let calibration = calibration(
        vec![recording(&minutes, x)],
        Parameter::new("k", 1.5).bounds(0.01, 1e3).scale(Scale::Log),
        SimulationSettings::default(),
    );
    let said = "the times look as if they were in min";
    assert!(warns(&calibration.check().findings, said), "{}", calibration.check());
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert!((fit.x[0] - 60.0).abs() < 1.0 && warns(&fit.findings(), said), "{fit}");
    // A short recording that the model follows is none.
    let short = times(61, 0.005);
    let fit = fitted(recording(&short, decay(&short, 2.0, 1e-3)), k());
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
}

/// A rate from 1e-5 to 10 on a logarithmic scale.
fn rate(start: f64) -> Parameter {
    Parameter::new("k", start).bounds(1e-5, 10.0).scale(Scale::Log)
}

fn tank(data: Data) -> Calibration {
    let driven = Experiment::new(data).input("u1", "u1").input("u2", "u2");
    let measured = (1..=2).fold(driven, |e, i| e.output(format!("qt.x{i}"), format!("x{i}")));
    let builder = Calibration::builder(open("quad_tank")).experiment(measured);
    (1..=2)
        .fold(builder, |b, i| b.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6)))
        .build()
        .unwrap()
}

/// A recording of the examples with its times multiplied.
fn example(name: &str, factor: f64) -> Data {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../examples/data/{name}.csv"));
    let data = Data::from_csv(path).unwrap();
    let columns = data.names().map(|name| (name.to_owned(), data.column(name).unwrap().to_vec()));
    Data::from_columns(data.time().iter().map(|t| factor * t).collect(), columns).unwrap()
}

#[test]
fn times_that_are_numbers_of_rows_or_in_another_unit_are_named() {
    // A decay by 0.5 per second, minute or hour, whose times last as the model suggests but for the first.
    let seconds = times(201, 0.05);
    let rows = times(201, 1.0);
    for (t, start, said) in [
        (&rows, 0.4, "the times look like numbers of rows"),
        (&seconds, 0.01, "the times look as if they were in min"),
        (&seconds, 2e-4, "the times look as if they were in h"),
    ] {
        let calibration = calibration(
            vec![recording(t, decay(&seconds, 0.5, 1e-2))],
            rate(start),
            SimulationSettings::default(),
        );
        assert!(warns(&calibration.check().findings, said), "{}", calibration.check());
        let fit = calibration.fit(FitOptions::default()).unwrap();
        assert!(fit.report.is_success() && warns(&fit.findings(), said), "{fit}");
    }
    // Bounds keep the parameters of a tank from making up for it, and the fit is poor.
    let fit = tank(example("quad_tank", 1.0 / 60.0)).fit(FitOptions::default()).unwrap();
    assert!(warns(&fit.findings(), "in min"), "{fit}");
    let fit = tank(example("quad_tank", 1.0)).fit(FitOptions::default()).unwrap();
    assert!(!warns(&fit.findings(), "in min"), "{fit}");
}

#[test]
fn times_of_sound_setups_are_not_accused() {
    let dice = |k: usize| 0.5 + 0.5 * noise(k);
    for k in 0..100 {
        let rate_of = 10f64.powf(-2.0 + 2.0 * dice(7 * k));
        let n = 20 + (150.0 * dice(7 * k + 1)) as usize;
        // A third of them by the second, from 0 or 1 on.
        let interval = if k % 3 == 0 { 1.0 } else { (1.0 + 4.0 * dice(7 * k + 2)) / rate_of / n as f64 };
        let start = rate_of * 10f64.powf(2.0 * dice(7 * k + 3) - 1.0);
        let first = if k % 6 == 0 { 1.0 } else { 0.0 };
        let t: Vec<f64> = times(n, interval).iter().map(|t| first + t).collect();
        let experiment = recording(&t, decay(&t, rate_of, 1e-2)).start_time(0.0);
        let fit = fitted(experiment, rate(start).bounds(1e-5, 1e2));
        let accused: Vec<String> =
            warnings(&fit.findings()).into_iter().filter(|text| text.contains("the times look")).collect();
        assert!(accused.is_empty(), "set-up {k}: {accused:#?} {fit}");
    }
}

#[test]
fn months_taken_for_days_are_named() {
    let day = 86_400.0;
    let slow = || Parameter::new("k", 1e-7).bounds(1e-9, 1e-5).scale(Scale::Log);
    let check = |t: &[f64]| {
        let experiment = recording(t, decay(t, 1e-7, 1e-3));
        let calibration = calibration(vec![experiment], slow(), SimulationSettings::default());
        calibration.check_with(&CheckOptions { simulate: false, max_time: None }, &RunContext::new()).unwrap()
    };
    // The first of January to the first of April of 2024, and four days by the hour.
    let first = [0.0, 31.0, 60.0, 91.0].map(|days| days * day);
    assert!(warns(&check(&first).findings, "a month of the calendar apart: are day and month swapped"));
    let hourly: Vec<f64> =
        first.iter().flat_map(|start| (0..24).map(move |h| start + 3600.0 * f64::from(h))).collect();
    assert!(warns(&check(&hourly).findings, "to the same day of the next month: are day and month swapped"));
    for sound in [times(100, day), times(300, 3600.0)] {
        assert!(!warns(&check(&sound).findings, "month"));
    }
}

#[test]
fn means_that_are_too_coarse_are_named() {
    let t = times(601, 0.01);
    let resampled = |interval: f64| {
        let data = Data::from_columns(t.clone(), [("x".to_owned(), decay(&t, 2.0, 1e-2))]).unwrap();
        fitted(Experiment::new(data.resampled(interval).unwrap()).output("x", "x"), k())
    };
    let coarse = resampled(1.5);
    assert!(warns(&coarse.findings(), "means over 1.5 s take away"), "{coarse}");
    let fine = resampled(0.1);
    assert!(!warns(&fine.findings(), "means over"), "{fine}");
}

#[test]
fn priors_that_the_data_contradict_are_named_whichever_wins() {
    let with_prior = |sd: f64, mean: f64, weight: f64, rule| {
        let t = times(61, 0.05);
        let x = decay(&t, 2.0, 1e-2);
        let data = Data::from_columns(t, [("x".to_owned(), x)]).unwrap();
        let experiment = Experiment::new(data).weighted_output("x", "x", Weight::Constant(weight));
        let parameter = k().prior(Prior::Normal { mean, sd });
        let calibration = calibration(vec![experiment], parameter, SimulationSettings::default());
        calibration.fit(FitOptions { noise: rule, ..FitOptions::default() }).unwrap()
    };
    let said = "contradicts the measurements: these alone give about";
    for (sd, wins) in [(1e-4, 3.0), (0.1, 2.0)] {
        let fit = with_prior(sd, 3.0, 1.0, NoiseRule::Auto);
        assert!((fit.x[0] - wins).abs() < 0.1 && warns(&fit.findings(), said), "{sd}: {fit}");
        assert!(!warns(&fit.findings(), "the weights of the other outputs"), "{fit}");
    }
    // The noise has an sd of 0.0058.
    let fit = with_prior(0.5, 2.0, 1.0, NoiseRule::Auto);
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
    let fit = with_prior(0.5, 2.0, 170.0, NoiseRule::Auto);
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
    for (weight, said) in [(0.0058, "are the weights 1/sigma, not sigma?"), (1e4, "priors count too little")]
    {
        let fit = with_prior(0.5, 2.0, weight, NoiseRule::Auto);
        assert!(warns(&fit.findings(), said), "{weight}: {fit}");
    }
}

#[test]
fn weights_of_sigma_for_one_over_sigma_are_named() {
    let t = times(61, 0.05);
    let slope: Vec<f64> =
        t.iter().enumerate().map(|(k, t)| -2.0 * (-2.0 * t).exp() + 0.2 * noise(k)).collect();
    let fit = |weights: [f64; 2]| {
        let columns = [("x".to_owned(), decay(&t, 2.0, 1e-3)), ("slope".to_owned(), slope.clone())];
        let data = Data::from_columns(t.clone(), columns).unwrap();
        let experiment = Experiment::new(data).weighted_output("x", "x", weights[0]);
        fitted(experiment.weighted_output("der(x)", "slope", weights[1]), k())
    };
    for (weights, is_inverse) in [([1e-3, 0.2], true), ([1e3, 5.0], false), ([100.0, 1.0], false)] {
        let fit = fit(weights);
        assert_eq!(warns(&fit.findings(), "are the weights sigma?"), is_inverse, "{fit}");
    }
}

#[test]
fn tolerances_that_mean_nothing_are_named() {
    let calibration = calibration(vec![sound(1e-3)], k(), SimulationSettings::default());
    for (x_tol, f_tol, is_loose) in [(0.5, 1e-4, true), (1e-4, 0.1, true), (1e-2, 1e-2, false)] {
        let tolerances = Tolerances { x_tol, f_tol, measure: Measure::Relative, stop: Stop::All };
        let run = RunOptions { tolerances, ..FitOptions::default_run() };
        let fit = calibration.fit(run).unwrap();
        assert_eq!(warns(&fit.findings(), "the search may end far from the minimum"), is_loose, "{fit}");
    }
    for (x_tol, is_loose) in [(1e-3, false), (2.0, true)] {
        let tolerances = Tolerances { x_tol, f_tol: 1e-3, measure: Measure::Absolute, stop: Stop::All };
        let fit = calibration.fit(RunOptions { tolerances, ..FitOptions::default_run() }).unwrap();
        assert_eq!(warns(&fit.findings(), "x_tol 2 is absolute, k has the size"), is_loose, "{fit}");
    }
}

#[test]
fn a_search_that_ended_before_the_minimum_is_named_and_not_taken_for_weights() {
    // Both outputs, of which one hardly counts, far from the minimum.
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
    let uncertainty = fit.uncertainty.as_ref().map(|uncertainty| uncertainty.left_to_gain);
    let at = calibration
        .uncertainty(&fit.x, &calibration::UncertaintyOptions::default(), &RunContext::new())
        .unwrap();
    assert!(uncertainty.is_none_or(|left| left > 0.9) && at.left_to_gain > 0.9, "{fit}");
    assert!(warns(&at.findings, "the search ended before the minimum"), "{at}");
    assert!(!at.to_string().contains("weights of the other outputs"), "{at}");
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert_eq!(fit.uncertainty.as_ref().unwrap().left_to_gain, 0.0, "{fit}");
    assert!(fit.is_success(), "{fit}");
    // A search that is satisfied too early is no success, whatever its own tests say.
    let tolerances = Tolerances { x_tol: 0.5, f_tol: 1e-4, measure: Measure::Relative, stop: Stop::Any };
    let method = calibration::dfo::NelderMead::default().into();
    let run = RunOptions { tolerances, method, ..FitOptions::default_run() };
    let fit = calibration.fit(run).unwrap();
    assert!(fit.report.is_success() && !fit.is_success(), "{fit}");
    assert!(fit.to_string().contains("The fit ended before the minimum"), "{fit}");
}

#[test]
fn a_recording_that_is_there_twice_is_named_and_parts_of_one_are_not() {
    let two = |first: Experiment, second: Experiment| {
        calibration(vec![first, second], k(), SimulationSettings::default())
            .fit(FitOptions::default())
            .unwrap()
    };
    let fit = two(sound(1e-3), sound(1e-3));
    assert!(
        warns(&fit.findings(), "experiments run1 and run2: output 'x' has the same 61 measurements"),
        "{fit}"
    );
    let fit = two(sound(1e-3).window(0.0, 1.0), sound(1e-3).window(1.05, 3.0));
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
    let fit = two(sound(1e-3).window(0.0, 2.0), sound(1e-3).window(1.5, 3.0));
    assert!(warns(&fit.findings(), "output 'x' has the same 11 measurements in both"), "{fit}");
    let t = times(61, 0.05);
    let late = t.iter().map(|t| t + 10.0).collect::<Vec<f64>>();
    let later = recording(&late, decay(&t, 2.0, 1e-3)).start_time(10.0);
    let fit = two(sound(1e-3), later);
    assert!(warns(&fit.findings(), "output 'x' has the same 61 measurements in both"), "{fit}");
    let t = times(61, 0.05);
    let columns = ["x", "copy"].map(|name| (name.to_owned(), decay(&t, 2.0, 1e-3)));
    let one = Experiment::new(Data::from_columns(t.clone(), columns).unwrap())
        .output("x", "x")
        .output("der(x)", "copy");
    let check = calibration(vec![one], k(), SimulationSettings::default()).check();
    assert!(
        warns(&check.findings, "outputs 'x' and 'der(x)': both have the same 61 measurements"),
        "{check}"
    );
}

#[test]
fn starts_and_bounds_far_from_the_models_own_are_named() {
    let check = |parameter: Parameter| {
        calibration(vec![sound(1e-3)], parameter, SimulationSettings::default()).check()
    };
    let far = check(Parameter::new("k", 2e3).bounds(1.0, 1e4));
    assert!(warns(&far.findings, "start 2000 is 2000 times the model's own value 1"), "{far}");
    let beyond = check(Parameter::new("k", 100.0).bounds(60.0, 1e3));
    assert!(warns(&beyond.findings, "its bounds 60 and 1000 leave out the model's own value 1"), "{beyond}");
    let near = check(Parameter::new("k", 3.0).bounds(2.0, 4.0));
    assert!(!warns(&near.findings, "leave out") && near.to_string().contains("leave out"), "{near}");
    // A start that the fit has left is none any more.
    let fit = fitted(sound(1e-3), Parameter::new("k", 1e-3).bounds(1e-4, 10.0).scale(Scale::Log));
    assert!((fit.x[0] - 2.0).abs() < 0.01 && !warns(&fit.findings(), "the model's own value"), "{fit}");
    // A start value in degC.
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
        warns(&check.findings, "start value of 'T1': it is 25 K, the model's own is 480: degC for K?"),
        "{check}"
    );
    assert!(warns(&check.findings, "constant input of 'T_in': it is 30 K"), "{check}");
}

#[test]
fn a_fit_without_time_says_what_needs_no_simulation() {
    let parameter = Parameter::new("k", 2e3).bounds(1.0, 1e4);
    let calibration = calibration(vec![sound(1e-3)], parameter, SimulationSettings::default());
    let limits = Limits { max_time: Some(Duration::from_nanos(1)), ..Limits::default() };
    let fit = calibration.fit(RunOptions { limits, ..FitOptions::default_run() }).unwrap();
    assert!(warns(&fit.findings(), "start 2000 is 2000 times the model's own value 1"), "{fit}");
}

#[test]
fn a_check_ends_by_its_time() {
    let calibration = calibration(vec![sound(1e-3)], k(), SimulationSettings::default());
    let options = CheckOptions { max_time: Some(Duration::from_nanos(1)), ..CheckOptions::default() };
    let check = calibration.check_with(&options, &RunContext::new()).unwrap();
    assert!(warns(&check.findings, "max_time: the check was ended by its time limit of 1e-9 s"), "{check}");
    assert!(calibration.check().is_ok());
}

#[test]
fn outputs_that_a_fit_misses_are_named() {
    // The sign of the column is wrong; so is the column.
    let t = times(61, 0.05);
    let mirrored = decay(&t, 2.0, 1e-3).iter().map(|x| -x).collect();
    let fit = fitted(recording(&t, mirrored), k());
    assert!(warns(&fit.findings(), "measured and simulated values go opposite ways"), "{fit}");
    let few = times(6, 0.5);
    let fit = fitted(recording(&few, few.iter().map(|t| 5.0 + (7.0 * t).sin()).collect()), k());
    assert!(warns(&fit.findings(), "the fit is worse than a constant"), "{fit}");
    let other = t.iter().enumerate().map(|(i, t)| 5.0 + (7.0 * t).sin() + 0.1 * noise(i)).collect();
    let fit = fitted(recording(&t, other), k());
    assert!(warns(&fit.findings(), "the fit is worse than a constant"), "{fit}");
}

#[test]
fn sensors_that_stand_still_wrap_or_write_placeholders_are_named() {
    let t = times(301, 0.01);
    let changed = |change: &dyn Fn(&mut Vec<f64>)| {
        let mut x = decay(&t, 2.0, 1e-3);
        change(&mut x);
        fitted(recording(&t, x), k())
    };
    let fit = changed(&|x| (100..160).for_each(|i| x[i] = x[100]));
    assert!(warns(&fit.findings(), "frozen?"), "{fit}");
    for value in [9999.0, -999.0, 1e30] {
        let fit = changed(&|x| x[200] = value);
        assert!(warns(&fit.findings(), "a placeholder for a missing value?"), "{fit}");
    }
    let angle: Vec<f64> =
        t.iter().enumerate().map(|(i, t)| 20.0 * (-2.0 * t).exp() + 1e-3 * noise(i)).collect();
    for (is_wrapped, values) in
        [(false, angle.clone()), (true, angle.iter().map(|v| v.rem_euclid(std::f64::consts::TAU)).collect())]
    {
        let fit = fitted(recording(&t, values).start_value("x", 20.0), k());
        assert_eq!(warns(&fit.findings(), "measured values jump by 2 pi"), is_wrapped, "{fit}");
    }
}

#[test]
fn loose_simulations_are_named_and_reproduce_nothing() {
    let loose = SimulationSettings { relative_tolerance: Some(0.1), ..SimulationSettings::default() };
    let fit = calibration(vec![sound(1e-2)], k(), loose).fit(FitOptions::default()).unwrap();
    assert!(warns(&fit.findings(), "relative_tolerance 0.1 lets each step"), "{fit}");
    assert!(!fit.to_string().contains("reproduced to the accuracy"), "{fit}");
}

#[test]
fn outliers_are_those_of_many_residuals_and_a_robust_loss_is_not_proposed_to_itself() {
    let t = times(100, 0.03);
    let mut x = decay(&t, 2.0, 1e-3);
    let together = {
        let mut x = x.clone();
        (30..35).for_each(|i| x[i] += 0.2);
        fitted(recording(&t, x), k())
    };
    (10..35).step_by(5).for_each(|i| x[i] += 0.2);
    let calibration = calibration(vec![recording(&t, x)], k(), SimulationSettings::default());
    let said = "a robust loss counts them less";
    let plain = calibration.fit(FitOptions::default()).unwrap();
    assert!(warns(&plain.findings(), said), "{plain}");
    // A part of the recording that the model does not follow is no matter of the loss, nor is a wrong model: one that settles at 0.
    assert!(!warns(&together.findings(), said) && !together.findings().is_empty(), "{together}");
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
        !warns(&robust.findings(), said) && robust.to_string().contains("which the robust loss counts less"),
        "{robust}"
    );
    let t = vec![0.0, 0.5, 1.0];
    let fit = fitted(recording(&t, vec![1.0, 0.37, 0.2]), k());
    assert!(!fit.to_string().contains("outliers"), "{fit}");
}

/// A sensor that ends at 0.8, in a part of the rows that is too small for a doubt without the simulation.
#[test]
fn a_column_that_stays_at_its_limit_below_the_simulation_is_clipped() {
    let t = times(400, 0.01);
    let of = |limit: f64| {
        let x = decay(&t, 2.0, 1e-3).into_iter().map(|x| x.min(limit)).collect();
        fitted(recording(&t, x), k())
    };
    let clipped = of(0.8);
    let said = "it is clipped at 0.8: 12 measurements are exactly that, its largest value, and the simulation at the fitted values goes beyond it by up to";
    assert!(warns(&clipped.findings(), said), "{clipped}");
    assert!(!clipped.to_string().contains("clipped?"), "{clipped}");
    let larger = of(0.5);
    assert!(
        warns(&larger.findings(), "it is clipped at 0.5") && !larger.to_string().contains("clipped?"),
        "{larger}"
    );
    let sound = of(2.0);
    assert!(!sound.to_string().contains("clipped"), "{sound}");
}

/// The same recording as the logger has it, and as it was exported in six digits.
#[test]
fn a_recording_that_is_there_twice_in_fewer_digits_is_named() {
    let t: Vec<f64> = times(61, 0.05).iter().map(|t| t + 1e-8 * t.sin()).collect();
    let x = decay(&t, 2.0, 1e-3);
    let printed =
        |values: &[f64]| values.iter().map(|v| format!("{v:.5e}").parse().unwrap()).collect::<Vec<f64>>();
    let check = |other: Experiment| {
        calibration(vec![recording(&t, x.clone()), other], k(), SimulationSettings::default()).check()
    };
    let twice = check(recording(&printed(&t), printed(&x)));
    let said = "output 'x' has the same 61 measurements at the same times in both";
    assert!(warns(&twice.findings, said), "{twice}");
    let other: Vec<f64> = x.iter().enumerate().map(|(k, x)| x + 1e-3 * noise(k + 500)).collect();
    let two = check(recording(&printed(&t), printed(&other)));
    assert!(!two.to_string().contains("in both"), "{two}");
}

#[test]
fn the_note_on_priors_says_what_a_fit_does() {
    let calibration = calibration(
        vec![sound(1e-2)],
        k().prior(Prior::Normal { mean: 2.0, sd: 1.0 }),
        SimulationSettings::default(),
    );
    let check = calibration.check().to_string();
    assert!(check.contains("a fit of the sum of squares estimates it with the parameters"), "{check}");
}

#[test]
fn fits_of_the_examples_are_accused_of_nothing_new() {
    let data = |name: &str| {
        Data::from_csv(Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../examples/data/{name}.csv")))
            .unwrap()
    };
    let furuta = Calibration::builder(open("furuta"))
        .experiment(
            Experiment::new(data("furuta"))
                .output("armJoint.phi", "phi")
                .output("pendulumJoint.phi", "theta"),
        )
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012));
    let tank = |n: usize| {
        let driven = Experiment::new(data("quad_tank")).input("u1", "u1").input("u2", "u2");
        let measured = (1..=n).fold(driven, |e, i| e.output(format!("qt.x{i}"), format!("x{i}")));
        let builder = Calibration::builder(open("quad_tank")).experiment(measured);
        (1..=n).fold(builder, |b, i| b.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6)))
    };
    let inputs = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"];
    let exhaust = inputs.into_iter().fold(
        Experiment::new(data("exhaust")).output("T_out", "T_out").window(0.0, 500.0),
        |experiment, name| experiment.input(name, name),
    );
    let exhaust = Calibration::builder(open("exhaust"))
        .experiment(exhaust)
        .parameter(Parameter::new("C1", 2500.0).bounds(0.25, 50e3))
        .parameter(Parameter::new("G1", 120.0).bounds(0.012, 1e3));
    let known = ["autocorrelated", "offset", "is at its", "standard error of", "keep their sign", "outliers"];
    for (name, builder) in [("furuta", furuta), ("tank2", tank(2)), ("tank4", tank(4)), ("exhaust", exhaust)]
    {
        let fit = builder.build().unwrap().fit(FitOptions::default()).unwrap();
        let new: Vec<String> = warnings(&fit.findings())
            .into_iter()
            .filter(|text| !known.iter().any(|k| text.contains(k)))
            .collect();
        assert!(new.is_empty(), "{name}: {new:#?}");
    }
}

#[test]
fn residuals_that_one_number_explains_say_which() {
    let t = times(201, 0.02);
    let fit = |change: &dyn Fn(usize, f64) -> f64| {
        let x = t.iter().enumerate().map(|(i, t)| change(i, *t) + 1e-3 * noise(i)).collect();
        fitted(recording(&t, x).start_value("x", 1.0), k())
    };
    for (change, said) in [
        (
            &(|_, t: f64| (-2.0 * t).exp() + 0.1) as &dyn Fn(usize, f64) -> f64,
            "an offset of the measurements of 0.1",
        ),
        (&|_, t| 1.3 * (-2.0 * t).exp(), "measurements that are 1.28"),
        (&|_, t| (-2.0 * t).exp() + 0.05 * (t - 2.0), "a drift of the measurements of 0.05"),
    ] {
        let fit = fit(change);
        assert!(warns(&fit.findings(), said), "{said}: {fit}");
    }
}

/// What the model leaves out is said of the residuals, whatever the cost is and with or without standard
/// errors.
#[test]
fn residuals_are_looked_at_with_every_cost_and_without_a_covariance() {
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
            let said = warnings(&fit.findings());
            let text = "the residuals of x are autocorrelated";
            let times_said = said.iter().filter(|said| said.contains(text)).count();
            assert!(fit.report.is_success() && times_said == 1, "{name}: {fit}");
            let has_errors = fit.uncertainty.is_some();
            assert_eq!(said.iter().any(|said| said.contains("standard errors are corrected")), has_errors);
            let fit = fitted_as(sound(1e-3), options());
            assert!(warnings(&fit.findings()).is_empty(), "{name}: {fit}");
        }
    }
    // Nothing is said of a search that was ended, nor of simulations that reproduce the measurements.
    let without = || FitOptions { uncertainty: None, ..FitOptions::default() };
    let limits = Limits { max_evaluations: Some(2), ..Limits::default() };
    let ended = FitOptions { run: RunOptions { limits, ..FitOptions::default_run() }, ..without() };
    assert!(warnings(&fitted_as(sound(1e-3), ended).findings()).is_empty());
    assert!(warnings(&fitted_as(sound(0.0), without()).findings()).is_empty());
}

fn fitted_as(experiment: Experiment, options: FitOptions<'_>) -> Fit {
    calibration(vec![experiment], k(), SimulationSettings::default()).fit(options).unwrap()
}

/// Uniform noise from -size to size has the standard deviation size / sqrt(3).
#[test]
fn residuals_are_compared_with_the_noise_that_weights_state() {
    let sigma = 0.01 / 3f64.sqrt();
    let t = times(201, 0.025);
    let findings = |weight: Weight, change: &dyn Fn(f64) -> f64| {
        let x = decay(&t, 2.0, 0.01).iter().zip(&t).map(|(x, t)| x + change(*t)).collect();
        let data = Data::from_columns(t.clone(), [("x".to_owned(), x)]).unwrap();
        let fit = fitted(Experiment::new(data).weighted_output("x", "x", weight), k());
        fit.findings()
            .iter()
            .map(ToString::to_string)
            .filter(|said| said.contains("state"))
            .collect::<Vec<_>>()
    };
    let plain = |weight: f64| findings(weight.into(), &|_| 0.0);
    for sound in [plain(1.0 / sigma), plain(0.9 / sigma), plain(1.05 / sigma), plain(1.0)] {
        assert!(sound.is_empty(), "{sound:?}");
    }
    // Rows that count and rows that do not state no noise.
    let chosen: Vec<f64> = (0..201).map(|k| f64::from(k % 2)).collect();
    assert!(findings(Weight::Rows(chosen.into()), &|_| 0.0).is_empty());
    let said = plain(1.5 / sigma);
    assert!(
        said.len() == 1 && said[0].starts_with("warning: noise of x: the residuals of x are 1.5"),
        "{said:?}"
    );
    let said = plain(0.2 / sigma);
    assert!(
        said.len() == 1 && said[0].starts_with("note: ") && said[0].contains("smaller than stated"),
        "{said:?}"
    );
    let said = plain(100.0 / sigma);
    assert!(said.len() == 1 && said[0].starts_with("note: "), "{said:?}");
    // Something fast that the model leaves out, of which no autocorrelation tells.
    let said = findings((1.0 / sigma).into(), &|t| 0.012 * (80.0 * t).sin());
    assert!(said.len() == 1 && said[0].contains("the model leaves out something"), "{said:?}");
}

#[test]
fn the_correction_for_autocorrelation_is_told() {
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
    let said = fit.findings().iter().find(|f| f.subject == "standard errors").unwrap().to_string();
    let told = said.strip_prefix("note: standard errors: the standard errors are ");
    let told = told.or_else(|| said.strip_prefix("note: the standard errors are ")).unwrap();
    let told: f64 = told.split(' ').next().unwrap().parse().unwrap();
    assert!(factor > 1.5 && (told / factor - 1.0).abs() < 0.01, "{factor}: {said}");
    let sound = fitted(sound(1e-3), k());
    assert!(sound.findings().iter().all(|f| f.subject != "standard errors"), "{sound}");
}

#[test]
fn nominal_values_that_are_no_size_are_named() {
    let said = |parameter: Parameter| {
        let calibration = calibration(vec![sound(1e-3)], parameter, SimulationSettings::default());
        let findings = calibration.fit(FitOptions::default()).unwrap().findings();
        let check = calibration.check().to_string();
        [check.contains("steps of the search are in units of it"), warns(&findings, "nominal")]
    };
    for nominal in [1e-8, 1e9] {
        assert_eq!(said(k().nominal(nominal)), [true; 2], "{nominal}");
    }
    for parameter in
        [k().nominal(1e-3), k().nominal(1e3), k(), Parameter::new("k", 0.0).nominal(0.1).bounds(-1.0, 5.0)]
    {
        assert_eq!(said(parameter), [false; 2]);
    }
}

#[test]
fn recordings_that_ask_for_other_values_are_named() {
    let t = times(60, 0.05);
    let one = |rate: f64, from: usize| {
        let x = t.iter().enumerate().map(|(k, t)| (-rate * t).exp() + 0.03 * noise(from + 7 * k)).collect();
        recording(&t, x)
    };
    let fit = |rates: [f64; 2]| {
        let experiments = vec![one(rates[0], 0), one(rates[1], 1000)];
        calibration(experiments, k(), SimulationSettings::default()).fit(FitOptions::default()).unwrap()
    };
    let other = fit([2.0, 2.2]);
    let conflict = other.uncertainty.as_ref().unwrap().part_conflict.clone().unwrap();
    let (index, [(first, _), (second, _)]) = conflict.differs_most.unwrap();
    let is_near = (first - 2.0).abs() < 0.06 && (second - 2.2).abs() < 0.06;
    assert!(index == 0 && is_near && conflict.chance < 1e-3, "{conflict:?}");
    assert!(matches!(conflict.parts, Parts::Experiment(_)), "{conflict:?}");
    assert!(
        warns(&other.findings(), "ask for different values of the parameters (apart, k about"),
        "{other}"
    );
    let same = fit([2.0, 2.0]);
    assert!(warnings(&same.findings()).is_empty(), "{same}");
}

#[test]
fn a_fit_that_leaves_start_and_own_value_far_behind_is_doubted() {
    let t = times(61, 1.0);
    let tank = |data: Vec<f64>| {
        let data = Data::from_columns(t.clone(), [("qt.x1".to_owned(), data)]).unwrap();
        Calibration::builder(open("quad_tank"))
            .experiment(Experiment::new(data).output("qt.x1", "qt.x1"))
            .parameter(Parameter::new("qt.a1", 2e-6).bounds(1e-6, 1e-3).scale(Scale::Log))
            .build()
            .unwrap()
    };
    let fit = |truth: f64| {
        let simulated = tank(vec![0.0; t.len()]).simulate(&[truth], None, &RunContext::new()).unwrap();
        let exact = &simulated[0].columns[0];
        let fit = tank(exact.iter().enumerate().map(|(k, x)| x + 1e-5 * noise(k)).collect())
            .fit(FitOptions::default());
        fit.unwrap()
    };
    let far = fit(3.6e-5);
    assert!((far.x[0] / 3.6e-5 - 1.0).abs() < 0.05, "{far}");
    assert!(
        warns(&far.findings(), "moved it from 2e-6 to 3.6e-5, 12 times the model's own value 3e-6"),
        "{far}"
    );
    assert!(!warns(&fit(6e-6).findings(), "the model's own value"));
}

#[test]
fn rows_too_far_apart_for_the_simulation_are_named() {
    // The van der Pol oscillator with mu = 0.1 has a period of 6.29 s: rows every 5 s show one of 24 s.
    let t = times(30, 5.0);
    let settings = SimulationSettings::default();
    let oscillator = |t: &[f64], columns: Vec<f64>| {
        let data = Data::from_columns(t.to_vec(), [("x0".to_owned(), columns)]).unwrap();
        Calibration::builder(open("van_der_pol"))
            .experiment(Experiment::new(data).output("x0", "x0"))
            .parameter(Parameter::new("mu", 0.12).bounds(0.05, 5.0))
            .settings(settings.clone())
            .build()
            .unwrap()
    };
    let simulated = |t: &[f64]| {
        let series = oscillator(t, vec![0.0; t.len()]).simulate(&[0.1], None, &RunContext::new()).unwrap();
        series[0].columns[0].iter().enumerate().map(|(k, x)| x + 0.01 * noise(k)).collect::<Vec<f64>>()
    };
    let coarse = oscillator(&t, simulated(&t));
    let said = "turns back within the 5 s from row to row";
    assert!(warns(&coarse.check().findings, said), "{}", coarse.check());
    let fit = coarse.fit(FitOptions::default()).unwrap();
    assert!(warns(&fit.findings(), said), "{fit}");
    let t = times(60, 2.5);
    let fine = oscillator(&t, simulated(&t));
    assert!(!warns(&fine.check().findings, "turns back"), "{}", fine.check());
    assert!(!warns(&fine.fit(FitOptions::default()).unwrap().findings(), "turns back"));
}

#[test]
fn measurements_in_coarse_steps_are_named() {
    let t = times(61, 0.05);
    let cut: Vec<f64> = decay(&t, 2.0, 0.02).iter().map(|x| (10.0 * x).floor() / 10.0).collect();
    let fit = fitted(recording(&t, cut), k());
    assert!(warns(&fit.findings(), "come in steps of 0.1"), "{fit}");
}
