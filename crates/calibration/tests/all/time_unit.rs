//! Models that count time in hours: `x' = -k x` with k = 0.5 per hour, recorded for 8 hours.

#![allow(clippy::unwrap_used)]

use crate::support::faulty;
use calibration::{
    Calibration, CalibrationError, Data, Experiment, FitOptions, Parameter, RunContext, Severity,
    SimulationSettings,
};
use example_models::example_fmu;
use fmi::Fmu;
use std::path::Path;

const K: f64 = 0.5;

fn hours() -> Vec<f64> {
    (0..41).map(|row| 0.2 * f64::from(row)).collect()
}

/// The recording with its times multiplied and in a column of this name.
fn recording(name: &str, per_hour: f64) -> Data {
    let x: Vec<f64> = hours().iter().map(|t| (-K * t).exp()).collect();
    let times = hours().iter().map(|t| per_hour * t).collect();
    Data::from_table([(name.to_owned(), times), ("x".to_owned(), x)], None).unwrap()
}

fn in_hours(experiment: Experiment) -> Result<Calibration, CalibrationError> {
    let settings = SimulationSettings { time_unit: Some("h".to_owned()), ..SimulationSettings::default() };
    Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(experiment)
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .settings(settings)
        .build()
}

fn of(data: Data) -> Experiment {
    Experiment::new(data).output("x", "x")
}

#[test]
fn recorded_times_are_converted_to_the_time_unit() {
    let plain = in_hours(of(recording("time", 1.0))).unwrap();
    let bits = |calibration: &Calibration| -> Vec<u64> {
        let residuals = calibration.residuals(&[0.7], &RunContext::new()).unwrap();
        residuals.iter().map(|r| r.to_bits()).collect()
    };
    // Hours stay exactly as they are written.
    let same = in_hours(of(recording("time [h]", 1.0))).unwrap();
    assert_eq!(bits(&same), bits(&plain));
    assert_eq!(same.problem().experiments[0].data().time(), hours());
    for (name, per_hour) in [("time [min]", 60.0), ("time [s]", 3600.0), ("time [ms]", 3.6e6)] {
        let calibration = in_hours(of(recording(name, per_hour)).window(0.0, 6.0)).unwrap();
        assert_eq!(calibration.problem().experiments[0].data().time_unit(), "h");
        assert_eq!(calibration.n_measurements(), 31, "{name}");
        let fit = calibration.fit(FitOptions::default()).unwrap();
        assert!((fit.x[0] - K).abs() < 1e-5, "{name}: {:?}", fit.x);
    }
    // A loaded problem is not converted again.
    let again = Calibration::from_problem(same.fmu().clone(), same.problem().clone()).unwrap();
    assert_eq!(bits(&again), bits(&plain));
}

#[test]
fn dates_count_hours_since_the_first() {
    let rows = (0..9).map(|h| format!("2024-05-31 {h:02}:00:00,{}\n", (-K * f64::from(h)).exp()));
    let text = format!("time,x\n{}", rows.collect::<String>());
    let data = Data::from_csv_text(text.as_bytes(), "run.csv", None).unwrap();
    assert_eq!(data.time()[1], 3600.0);
    let fit = in_hours(of(data)).unwrap().fit(FitOptions::default()).unwrap();
    assert!((fit.x[0] - K).abs() < 1e-5, "{:?}", fit.x);
}

#[test]
fn delays_are_in_the_time_unit() {
    // The measurement at t is the model value at t - 0.5 h.
    let x: Vec<f64> = hours().iter().map(|t| (-K * (t - 0.5)).exp()).collect();
    let late = || Data::from_columns(hours(), [("x".to_owned(), x.clone())]).unwrap();
    let fit = in_hours(of(late()).delay("x", 0.5).window(0.6, 8.0)).unwrap().fit(FitOptions::default());
    assert!((fit.unwrap().x[0] - K).abs() < 1e-5);
    let settings = SimulationSettings { time_unit: Some("h".to_owned()), ..SimulationSettings::default() };
    let tau = |unit: Option<&str>, size: f64| {
        let tau = Parameter::new("tau", 0.4 * size).bounds(0.0, size).delay_of("x");
        let tau = unit.map_or(tau.clone(), |unit| tau.in_unit(unit));
        let calibration = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
            .experiment(of(late()).window(1.0, 8.0))
            .parameter(Parameter::new("k", 0.5).fixed(true))
            .parameter(tau)
            .settings(settings.clone())
            .build()
            .unwrap();
        let unit = calibration.parameters()[1].unit(calibration.fmu().description()).map(str::to_owned);
        (calibration.fit(FitOptions::default()).unwrap().x[1], unit.unwrap())
    };
    let (hours, unit) = tau(None, 1.0);
    assert!((hours - 0.5).abs() < 1e-4 && unit == "h", "{hours} {unit}");
    let (minutes, unit) = tau(Some("min"), 60.0);
    assert!((minutes - 30.0).abs() < 1e-2 && unit == "min", "{minutes} {unit}");
}

/// The model with this unit of its independent variable.
fn stating(unit: &str, definition: &str) -> tempfile::TempDir {
    let folder = faulty(&[]);
    let path = folder.path().join("modelDescription.xml");
    let text = std::fs::read_to_string(&path).unwrap();
    let text = text.replace(
        "causality=\"independent\" variability=\"continuous\"><Real/>",
        &format!("causality=\"independent\" variability=\"continuous\"><Real unit=\"{unit}\"/>"),
    );
    std::fs::write(
        &path,
        text.replace("  <DefaultExperiment", &format!("{definition}\n  <DefaultExperiment")),
    )
    .unwrap();
    folder
}

#[test]
fn time_unit_is_read_from_the_model() {
    let defined =
        "<UnitDefinitions><Unit name=\"Std\"><BaseUnit s=\"1\" factor=\"3600\"/></Unit></UnitDefinitions>";
    let fit = |folder: &Path, name: &str, per_hour: f64| {
        let calibration = Calibration::builder(Fmu::open(folder).unwrap())
            .experiment(Experiment::new(recording(name, per_hour)).output("y", "x").window(0.0, 6.0))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
            .build();
        calibration.map(|calibration| (calibration.fit(FitOptions::default()).unwrap().x[0], calibration))
    };
    let folder = stating("Std", defined);
    for (name, per_hour) in [("time [min]", 60.0), ("time", 1.0), ("time [s]", 3600.0)] {
        let (k, calibration) = fit(folder.path(), name, per_hour).unwrap();
        assert!((k - K).abs() < 1e-5, "{name}: {k}");
        assert_eq!(calibration.fmu().description().time_unit(), "Std");
        let check = calibration.check();
        assert!(!check.to_string().contains("F041"), "{check}");
    }
    // An independent variable that is not a time.
    let length = stating("m", "");
    assert!((fit(length.path(), "time", 1.0).unwrap().0 - K).abs() < 1e-5);
    let message = fit(length.path(), "time [s]", 3600.0).unwrap_err().to_string();
    assert!(
        message.contains("the times are in s, but the model counts its independent variable in 'm', which is not a unit of time"),
        "{message}"
    );
}

/// The default experiment lasts 10.
#[test]
fn check_reports_a_model_in_hours() {
    let reported = |name: &str, per_hour: f64, unit: Option<&str>, rate: f64| {
        let times: Vec<f64> = (0..51).map(|row| 0.2 * f64::from(row)).collect();
        let x: Vec<f64> = times.iter().map(|t| (-rate * t).exp()).collect();
        let table = [(name.to_owned(), times.iter().map(|t| per_hour * t).collect()), ("x".to_owned(), x)];
        let settings =
            SimulationSettings { time_unit: unit.map(str::to_owned), ..SimulationSettings::default() };
        let calibration = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
            .experiment(of(Data::from_table(table, None).unwrap()))
            .parameter(Parameter::new("k", 0.6).bounds(1e-6, 10.0))
            .settings(settings)
            .build()
            .unwrap();
        let check = calibration.check();
        let of_fit = calibration.fit(FitOptions::default()).unwrap().findings();
        let is_it = |text: &str| text.contains("F041");
        let found = check.findings.iter().find(|f| is_it(&f.to_string()));
        assert_eq!(found.is_some(), of_fit.iter().any(|f| is_it(&f.to_string())), "{name}: {of_fit:#?}");
        found.map(|finding| {
            assert_eq!(finding.severity, Severity::Warning);
            finding.advice()
        })
    };
    let text = reported("time [h]", 1.0, None, K).unwrap();
    assert!(
        text.contains("the recording lasts 36000 s, but the default experiment of the model lasts 10 s. In h, the start values have the cost")
            && text.contains("The model probably counts its time in h")
            && text.ends_with("Set time_unit = \"h\""),
        "{text}"
    );
    assert!(reported("time [min]", 60.0, None, K).unwrap().contains("counts its time in h"));
    assert_eq!(reported("time [h]", 1.0, Some("h"), K), None);
    assert_eq!(reported("time", 1.0, None, K), None);
    let text = reported("time", 60.0, Some("h"), K).unwrap();
    assert!(text.contains("The times are probably in min") && text.contains("'time [min]'"), "{text}");
    // The length fits, but the measurements do not: the rate is 0.5 per second.
    assert_eq!(reported("time [h]", 1.0, None, 3600.0 * K), None);
}

#[test]
fn time_unit_that_contradicts_the_model_is_a_warning() {
    let warnings = |stated: &str, given: &str| {
        let folder = stating(stated, "");
        let settings =
            SimulationSettings { time_unit: Some(given.to_owned()), ..SimulationSettings::default() };
        let calibration = Calibration::builder(Fmu::open(folder.path()).unwrap())
            .experiment(Experiment::new(recording("time", 1.0)).output("y", "x").window(0.0, 6.0))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
            .settings(settings)
            .build()
            .unwrap();
        let mut all = calibration.warnings().iter().map(ToString::to_string);
        all.find(|text| text.contains("F069 contradicted-time-unit"))
    };
    let text = warnings("s", "h").unwrap();
    assert!(text.contains("time_unit is 'h', but the model states the time unit 's'"), "{text}");
    assert_eq!((warnings("h", "h"), warnings("ms", "ms")), (None, None));
    // The independent variable is not a time, so the setting does not contradict it.
    assert_eq!(warnings("m", "h"), None);
}

#[test]
fn invalid_time_units_are_rejected() {
    let settings = SimulationSettings { time_unit: Some("kg".to_owned()), ..SimulationSettings::default() };
    let message = Calibration::builder(Fmu::open(example_fmu("dahlquist").unwrap()).unwrap())
        .experiment(of(recording("time", 1.0)))
        .parameter(Parameter::new("k", 1.0))
        .settings(settings)
        .build()
        .unwrap_err()
        .to_string();
    assert!(message.contains("time_unit: 'kg' is not a unit of time; expected s, ms"), "{message}");
    let experiment = of(recording("time [min]", 60.0)).start_time(5.0);
    let message = in_hours(experiment).unwrap_err().to_string();
    assert!(
        message.contains("the first measurement is at 0 h, before the simulation starts at 5 h"),
        "{message}"
    );
}
