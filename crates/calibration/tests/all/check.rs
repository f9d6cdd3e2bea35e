//! Findings of a check for setups with one mistake each, and the absence of findings for correct setups.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    Calibration, CalibrationBuilder, Check, CheckOptions, Data, Experiment, FitOptions, Parameter,
    PreflightOptions, Severity,
};
use example_models::example_fmu;
use fmi::RunSettings;
use fmi::{Fmu, SimulateOptions};
use std::path::Path;

const NO_SIMULATION: CheckOptions = CheckOptions { simulate: false, max_time: None };

type Columns = Vec<(String, Vec<f64>)>;

fn open(model: &str) -> Fmu {
    Fmu::open(example_fmu(model).unwrap()).unwrap()
}

/// Returns a pseudo-random number from -1 to 1.
fn noise(k: usize) -> f64 {
    2.0 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract().abs() - 1.0
}

/// Returns a recording of the tank with noise, with outlets other than the nominal ones: times, voltages,
/// levels in m.
fn tank_recording() -> (Vec<f64>, Columns) {
    let time: Vec<f64> = (0..61).map(f64::from).collect();
    let u1: Vec<f64> = time.iter().map(|t| if *t < 20.0 { 5.0 } else { 6.0 }).collect();
    let u2 = vec![5.0; time.len()];
    let inputs =
        fmi::Inputs::new().series("u1", time.clone(), u1.clone()).series("u2", time.clone(), u2.clone());
    let options = SimulateOptions {
        times: Some(time.clone()),
        inputs: Some(inputs),
        start_values: vec![("qt.a1".to_owned(), 2.7e-6.into()), ("qt.a2".to_owned(), 2.6e-6.into())],
        outputs: Some(["qt.x1", "qt.x2", "qt.x3"].map(str::to_owned).to_vec()),
        ..SimulateOptions::default()
    };
    let levels = open("quad_tank").simulate(&options).unwrap();
    let noisy = |column: &[f64], from: usize| {
        column.iter().enumerate().map(|(k, v)| v + 5e-4 * noise(from + k)).collect()
    };
    let columns = vec![
        ("u1".to_owned(), u1),
        ("u2".to_owned(), u2),
        ("x1".to_owned(), noisy(&levels.columns[0], 0)),
        ("x2".to_owned(), noisy(&levels.columns[1], 100)),
        ("x3".to_owned(), noisy(&levels.columns[2], 200)),
    ];
    (time, columns)
}

fn tank(
    time: Vec<f64>,
    columns: Columns,
    change: impl FnOnce(Experiment) -> Experiment,
) -> CalibrationBuilder {
    let experiment = Experiment::new(Data::from_columns(time, columns).unwrap())
        .output("qt.x1", "x1")
        .output("qt.x2", "x2")
        .input("u1", "u1");
    Calibration::builder(open("quad_tank"))
        .experiment(change(experiment))
        .parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6))
        .parameter(Parameter::new("qt.a2", 3e-6).bounds(2e-6, 4e-6))
}

fn with_u2(experiment: Experiment) -> Experiment {
    experiment.input("u2", "u2")
}

fn reported(check: &Check) -> Vec<String> {
    check.findings.iter().filter(|f| f.severity != Severity::Note).map(ToString::to_string).collect()
}

#[test]
fn check_reports_mistakes() {
    let scaled = |name: &str, by: f64, plus: f64| {
        let (time, mut columns) = tank_recording();
        let column = columns.iter_mut().find(|(column, _)| column == name).unwrap();
        column.1.iter_mut().for_each(|v| *v = *v * by + plus);
        tank(time, columns, with_u2)
    };
    let times = |by: f64, plus: f64, change: fn(Experiment) -> Experiment| {
        let (time, columns) = tank_recording();
        tank(time.iter().map(|t| t * by + plus).collect(), columns, change)
    };
    let swapped = {
        let (time, columns) = tank_recording();
        let experiment = Experiment::new(Data::from_columns(time, columns).unwrap());
        let experiment = experiment.output("qt.x1", "x3").output("qt.x3", "x1").input("u1", "u1");
        Calibration::builder(open("quad_tank"))
            .experiment(with_u2(experiment))
            .parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6))
    };
    let open_input = {
        let (time, columns) = tank_recording();
        tank(time, columns.into_iter().filter(|(name, _)| name != "u2").collect(), |e| e)
    };
    let unused = {
        let (time, columns) = tank_recording();
        tank(time, columns, |e| e)
    };
    let changed = |name: &str, change: &dyn Fn(usize, f64) -> f64| {
        let (time, mut columns) = tank_recording();
        let column = columns.iter_mut().find(|(column, _)| column == name).unwrap();
        column.1.iter_mut().enumerate().for_each(|(k, v)| *v = change(k, *v));
        tank(time, columns, with_u2)
    };
    for (builder, expected) in [
        (scaled("x1", 1e3, 0.0), "output 'qt.x1' (column 'x1'): the measurements range over"),
        (scaled("x1", 1e3, 0.0), "Range and size differ by a factor of about"),
        (scaled("x2", 1e-3, 0.0), "State the unit in the name of the column, as in 'x2 [mm]'"),
        (
            times(1e3, 0.0, with_u2),
            "The times are probably in ms [F041 time-unit]. State the unit in the name of the column: 'time [ms]'",
        ),
        (
            times(1.0, 100.0, |e| with_u2(e).start_time(0.0).hold_inputs(true)),
            "the first row is at 100 s, but the simulation starts at 0 s.",
        ),
        (swapped, "outputs 'qt.x1' and 'qt.x3': column 'x3' is closer to the simulated 'qt.x3'"),
        (open_input, "input 'u2': the input is not driven"),
        (unused, "column 'u2' is not used, but nothing drives the input 'u2'"),
        (changed("x1", &|_, _| 0.06), "all 61 measurements are 0.06"),
        (changed("x1", &|_, v| v + 0.04), "the first measurement is 0.1"),
        (changed("u1", &|k, v| if k > 40 { f64::NAN } else { v }), "input 'u1' is recorded from 0 s to 40 s"),
        (
            scaled("x1", 1.0, 0.0).parameter(Parameter::new("qt.A1", -1.0)),
            "parameter 'qt.A1': start -1 is outside of the model's range",
        ),
        (
            scaled("x1", 1.0, 0.0).parameter(Parameter::new("qt.A1", 5e-4).bounds(-1.0, 1.0)),
            "parameter 'qt.A1': lower bound -1, but the model declares a range",
        ),
    ] {
        // Setups that cannot be evaluated are rejected with the message of the finding.
        let calibration = match builder.build() {
            Ok(calibration) => calibration,
            Err(error) if error.to_string().contains(expected) => continue,
            Err(error) => panic!("{expected}: {error}"),
        };
        let check = calibration.check();
        assert!(reported(&check).iter().any(|text| text.contains(expected)), "{expected}:\n{check}");
        assert!(!check.is_ok());
    }
}

#[test]
fn check_reports_temperatures_in_degrees_celsius() {
    let time: Vec<f64> = (0..60).map(|k| 2.0 * f64::from(k)).collect();
    // Values near 30 degC, whose ratio to the simulation is similar to the ratio of rpm to rad/s.
    let start = ["T_in", "T1", "T2", "Tw1", "Tw2"].map(|name| (name.to_owned(), 305.0.into()));
    let options = SimulateOptions {
        times: Some(time.clone()),
        start_values: start.to_vec(),
        outputs: Some(vec!["T_out".to_owned()]),
        ..SimulateOptions::default()
    };
    let kelvin = open("exhaust").simulate(&options).unwrap().columns.swap_remove(0);
    for (zero, is_reported) in [(273.15, true), (0.0, false)] {
        let values = kelvin.iter().enumerate().map(|(k, v)| v - zero + 0.05 * noise(k)).collect();
        let recording = Data::from_columns(time.clone(), [("outlet".to_owned(), values)]).unwrap();
        let experiment = start
            .iter()
            .fold(Experiment::new(recording).output("T_out", "outlet"), |experiment, (name, _)| {
                experiment.start_value(name.clone(), 305.0)
            });
        let check = Calibration::builder(open("exhaust"))
            .experiment(experiment)
            .parameter(Parameter::new("C1", 2500.0).bounds(1.0, 50e3))
            .build()
            .unwrap()
            .check();
        let reported = reported(&check).concat();
        assert_eq!(reported.contains("between degC and K"), is_reported, "{check}");
        assert_eq!(reported.contains("as in 'outlet [degC]'"), is_reported, "{check}");
        assert!(!reported.contains("rpm") && !check.to_string().contains("[mm]"), "{check}");
    }
}

#[test]
fn check_returns_only_notes_for_correct_setups() {
    let (time, columns) = tank_recording();
    let check = tank(time, columns, with_u2).build().unwrap().check();
    assert!(check.is_ok() && reported(&check).is_empty(), "{check}");
    assert_eq!(check.findings.len(), 2, "{check}");
    assert!(check.to_string().contains("the values switch between 2 levels (jumps: 1)"), "{check}");
    assert!(
        check.to_string().contains(
            "columns without a unit are not converted to the units of the model: 'x1' in m, 'x2' in m"
        ),
        "{check}"
    );

    let csv = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/data/furuta.csv");
    let check = Calibration::builder(open("furuta"))
        .experiment(
            Experiment::new(Data::from_csv(csv).unwrap())
                .output("armJoint.phi", "phi")
                .output("pendulumJoint.phi", "theta"),
        )
        .parameter(Parameter::new("armFriction", 0.02).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.01).bounds(0.0, 0.022))
        .build()
        .unwrap()
        .check();
    assert!(reported(&check).is_empty(), "{check}");

    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/exhaust_measurements.csv");
    if !shared.is_file() {
        eprintln!("skipped: {} is not at hand", shared.display());
        return;
    }
    let inputs = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"];
    let experiment = Experiment::new(Data::from_csv(shared).unwrap()).output("T_out", "T_out");
    let check = Calibration::builder(open("exhaust"))
        .experiment(inputs.iter().fold(experiment, |experiment, input| experiment.input(*input, *input)))
        .parameter(Parameter::new("C1", 2500.0).bounds(1.0, 50e3))
        .build()
        .unwrap()
        .check();
    assert!(reported(&check).is_empty(), "{check}");
}

#[test]
fn check_reports_a_failed_simulation() {
    let t: Vec<f64> = (0..20).map(|k| 0.1 * f64::from(k)).collect();
    let x = t.iter().map(|t| (-2.0 * t).exp()).collect();
    let experiment = Experiment::new(Data::from_columns(t, [("x".to_owned(), x)]).unwrap()).output("x", "x");
    let calibration = Calibration::builder(open("dahlquist"))
        .experiment(experiment)
        .parameter(Parameter::new("k", -1e6))
        .build()
        .unwrap();
    let check = calibration.check();
    assert_eq!(check.findings[0].severity, Severity::Error);
    assert!(check.findings[0].sentence.contains("k = -1000000"), "{check}");
    assert!(calibration.check_with(&NO_SIMULATION, &RunContext::new()).unwrap().is_ok());
    assert!(calibration.check_with(&CheckOptions::default(), &RunContext::new().polling(&|| true)).is_err());
}

/// Returns a calibration to a decay with k = 20 and x(0) = 0.9, from a start at 15 and 0.5. Its value and its
/// derivative are measured with these errors.
fn fast_decay(errors: [f64; 2]) -> Calibration {
    let t: Vec<f64> = (0..61).map(|k| f64::from(k) / 200.0).collect();
    let x = |t: f64| 0.9 * (-20.0 * t).exp();
    let measured = |of: &dyn Fn(f64) -> f64, from: usize, error: f64| {
        t.iter().enumerate().map(|(k, t)| of(*t) + error * noise(from + k)).collect::<Vec<f64>>()
    };
    let columns = [
        ("value".to_owned(), measured(&x, 0, errors[0])),
        ("slope".to_owned(), measured(&|t| -20.0 * x(t), 100, errors[1])),
    ];
    let experiment = Experiment::new(Data::from_columns(t, columns).unwrap())
        .output("x", "value")
        .output("der(x)", "slope")
        .initial_state("x", Parameter::new("x0", 0.5).bounds(0.0, 2.0));
    Calibration::builder(open("dahlquist"))
        .experiment(experiment)
        .parameter(Parameter::new("k", 15.0).bounds(1.0, 100.0))
        .build()
        .unwrap()
}

/// The start value of a fitted state is accepted, but a wrong given value is a mistake.
#[test]
fn check_ignores_the_start_value_of_a_fitted_state() {
    let t: Vec<f64> = (0..61).map(|k| 0.05 * f64::from(k)).collect();
    let x = t.iter().enumerate().map(|(k, t)| 0.9 * (-2.0 * t).exp() + 1e-3 * noise(k)).collect();
    let data = Data::from_columns(t, [("x".to_owned(), x)]).unwrap();
    let reports_start = |initial: calibration::InitialState| {
        let experiment = Experiment::new(data.clone()).output("x", "x").initial_state("x", initial);
        let calibration = Calibration::builder(open("dahlquist"))
            .experiment(experiment)
            .parameter(Parameter::new("k", 1.5).bounds(0.1, 10.0))
            .build()
            .unwrap();
        calibration.check().to_string().contains("the simulation starts at 0.2")
    };
    assert!(reports_start(0.2.into()) && !reports_start(Parameter::new("x0", 0.2).bounds(0.0, 2.0).into()));
}

#[test]
fn check_findings_are_updated_after_the_fit() {
    let calibration = fast_decay([0.02, 0.02]);
    let reported = "the simulation starts at -7.5";
    assert!(calibration.check().to_string().contains(reported), "{}", calibration.check());
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert!((fit.x[1] - 0.9).abs() < 0.02 && !fit.to_string().contains(reported), "{fit}");
    assert!(!fit.report.message.contains("measurement"), "{}", fit.report.message);
}

/// Rows of an input shorten the steps of a fixed-step method. The comparison halves the actual steps.
#[test]
fn fixed_step_is_halved_when_input_rows_shorten_it() {
    let time: Vec<f64> = (0..41).map(|k| 15.0 * f64::from(k)).collect();
    let u1: Vec<f64> = (0..41).map(|k| 5.0 + 2.0 * noise(k)).collect();
    let options = SimulateOptions {
        times: Some(time.clone()),
        final_time: time.last().copied(),
        inputs: Some(fmi::Inputs::new().series("u1", time.clone(), u1.clone()).series("u2", [0.0], [5.0])),
        outputs: Some(vec!["qt.x1".to_owned()]),
        ..SimulateOptions::default()
    };
    let level = open("quad_tank").simulate(&options).unwrap().columns.remove(0);
    let columns = vec![("u1".to_owned(), u1), ("x1".to_owned(), level)];
    let reported_with = |step: f64| {
        let experiment = Experiment::new(Data::from_columns(time.clone(), columns.clone()).unwrap())
            .output("qt.x1", "x1")
            .input("u1", "u1")
            .constant_input("u2", 5.0);
        let settings =
            RunSettings { method: ode::Method::Euler, step_size: Some(step), ..RunSettings::default() };
        let builder = Calibration::builder(open("quad_tank")).experiment(experiment).settings(settings);
        let calibration =
            builder.parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6)).build().unwrap();
        let preflight = calibration.preflight(&PreflightOptions::default(), &RunContext::new()).unwrap();
        (calibration.check().to_string().contains("half the step of the solver 'euler'"), preflight.noise)
    };
    let (is_named, of_rows) = reported_with(15.0);
    assert!(is_named && of_rows > 1e-3);
    // These steps are also shortened to the row spacing.
    for step in [30.0, 60.0] {
        assert_eq!(reported_with(step), (true, of_rows), "step {step}");
    }
    assert!(!reported_with(0.5).0);
}

#[test]
fn check_reports_more_than_a_million_steps_before_the_simulation() {
    let findings = |step: f64| {
        let columns = [("x1".to_owned(), vec![0.06, 0.061, 0.062])];
        let experiment = Experiment::new(Data::from_columns(vec![0.0, 10.0, 20.0], columns).unwrap())
            .output("qt.x1", "x1")
            .constant_input("u1", 5.0)
            .constant_input("u2", 5.0);
        let settings =
            RunSettings { method: ode::Method::Euler, step_size: Some(step), ..RunSettings::default() };
        let builder = Calibration::builder(open("quad_tank")).experiment(experiment).settings(settings);
        let calibration = builder.parameter(Parameter::new("qt.a1", 3e-6)).build().unwrap();
        calibration.check_with(&NO_SIMULATION, &RunContext::new()).unwrap().to_string()
    };
    let steps = "requires 2e9 steps of at most 1e-8";
    assert!(findings(1e-8).contains(steps), "{}", findings(1e-8));
    assert!(!findings(1e-3).contains("steps"), "{}", findings(1e-3));
}

/// Columns that drive inputs are checked in the same way as measured columns.
#[test]
fn check_reports_mistakes_in_input_columns() {
    let with_u1 = |name: &'static str, u1: &dyn Fn(f64) -> f64| {
        let time: Vec<f64> = (0..601).map(|k| 0.1 * f64::from(k)).collect();
        let columns = vec![
            ("x1".to_owned(), time.iter().map(|t| 0.06 + 1e-4 * t).collect()),
            (name.to_owned(), time.iter().map(|t| u1(*t)).collect()),
        ];
        let experiment = Experiment::new(Data::from_columns(time, columns).unwrap())
            .output("qt.x1", "x1")
            .input("u1", name)
            .constant_input("u2", 5.0);
        let calibration = Calibration::builder(open("quad_tank"))
            .experiment(experiment)
            .parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6))
            .build()
            .unwrap();
        let check = calibration.check_with(&NO_SIMULATION, &RunContext::new()).unwrap();
        let reported = check.findings.iter().map(ToString::to_string);
        let is_other = |reported: &String| !reported.contains("F044") && !reported.contains("F065");
        reported.filter(|reported| reported.contains("'u1'") && is_other(reported)).collect::<Vec<_>>()
    };
    let sine = |t: f64| 5.0 + (0.65 * t).sin();
    let near = |t: f64, other: f64| (t - other).abs() < 0.01;
    let mistakes: [(&dyn Fn(f64) -> f64, &str); 3] = [
        (&|_| 0.0, "input 'u1' (column 'u1'): all 601 values are 0"),
        (&|t| if near(t, 20.0) || near(t, 30.0) { -999.0 } else { sine(t) }, "2 values are -999"),
        (
            &|t| if t > 10.0 && t < 15.0 { f64::NAN } else { sine(t) },
            "the input has no value from 10 s to 15 s",
        ),
    ];
    for (u1, expected) in mistakes {
        let reported = with_u1("u1", u1);
        assert!(reported.len() == 1 && reported[0].contains(expected), "{expected}: {reported:?}");
    }
    let sound: [&dyn Fn(f64) -> f64; 6] = [
        &sine,
        &|_| 5.0,
        &|t| if t < 20.0 { 5.0 } else { 6.0 },
        &|t| (0.2 * t).min(8.0),
        &|t| sine(t).clamp(4.5, 5.5),
        &|t| if (t / 7.0).fract() < 0.5 { 0.0 } else { 10.0 },
    ];
    for (which, u1) in sound.into_iter().enumerate() {
        let reported = with_u1("u1", u1);
        assert!(reported.is_empty(), "{which}: {reported:?}");
    }
}

#[test]
fn check_reports_an_input_in_degrees_celsius() {
    let time: Vec<f64> = (0..60).map(|k| 2.0 * f64::from(k)).collect();
    for (zero, is_reported) in [(0.0, true), (273.15, false)] {
        let inlet = time.iter().map(|t| zero + 20.0 + 0.1 * t).collect();
        let outlet = time.iter().map(|t| 290.0 + 0.1 * t).collect();
        let columns = [("inlet".to_owned(), inlet), ("outlet".to_owned(), outlet)];
        let experiment = Experiment::new(Data::from_columns(time.clone(), columns).unwrap())
            .output("T_out", "outlet")
            .input("T_in", "inlet");
        let calibration = Calibration::builder(open("exhaust"))
            .experiment(experiment)
            .parameter(Parameter::new("C1", 2500.0).bounds(1.0, 50e3))
            .build()
            .unwrap();
        let check = calibration.check_with(&NO_SIMULATION, &RunContext::new()).unwrap();
        let reported = "the values lie between 20 and 31.8 K, but the start value of the model is 550, as with degC instead of K";
        assert_eq!(check.to_string().contains(reported), is_reported, "{check}");
    }
}
