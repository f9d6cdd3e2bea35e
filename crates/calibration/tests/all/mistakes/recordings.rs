//! Mistakes in recordings: their times, columns and sensors.

use super::{decay, fitted, k, noise, open, recording, times, warnings, warns};
use calibration::{
    Calibration, CheckOptions, Data, Experiment, FitOptions, Parameter, PreflightOptions, RunContext, Scale,
};
use std::path::Path;

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
fn times_of_sound_setups_cause_no_findings() {
    let dice = |k: usize| 0.5 + 0.5 * noise(k);
    for k in 0..100 {
        let rate_of = 10f64.powf(-2.0 + 2.0 * dice(7 * k));
        let n = 20 + (150.0 * dice(7 * k + 1)) as usize;
        // A third of them have times in seconds, starting at 0 or 1.
        let interval = if k % 3 == 0 { 1.0 } else { (1.0 + 4.0 * dice(7 * k + 2)) / rate_of / n as f64 };
        let start = rate_of * 10f64.powf(2.0 * dice(7 * k + 3) - 1.0);
        let first = if k % 6 == 0 { 1.0 } else { 0.0 };
        let t: Vec<f64> = times(n, interval).iter().map(|t| first + t).collect();
        let experiment = recording(&t, decay(&t, rate_of, 1e-2)).start_time(0.0);
        let fit = fitted(experiment, rate(start).bounds(1e-5, 1e2));
        let accused: Vec<String> =
            warnings(&fit.findings()).into_iter().filter(|text| text.contains("F041")).collect();
        assert!(accused.is_empty(), "set-up {k}: {accused:#?} {fit}");
    }
}

#[test]
fn placeholders_are_reported() {
    let t = times(301, 0.01);
    for value in [9999.0, -999.0, 1e30] {
        let mut x = decay(&t, 2.0, 1e-3);
        x[200] = value;
        let fit = fitted(recording(&t, x), k());
        assert!(warns(&fit.findings(), "F050 placeholder"), "{fit}");
    }
}

#[test]
fn column_used_as_input_and_output_is_reported() {
    let reported = "the column is also compared with the output 'qt.x1'";
    let tank = |input: &str| {
        let driven = Experiment::new(example("quad_tank", 1.0)).input("u1", input).input("u2", "u2");
        let builder = Calibration::builder(open("quad_tank")).experiment(driven.output("qt.x1", "x1"));
        builder.parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6)).build().unwrap()
    };
    assert!(warns(&tank("x1").check().findings, reported), "{}", tank("x1").check());
    assert!(!warns(&tank("u1").check().findings, reported));
}

/// The recording of the quadruple tank with changed columns and, optionally, changed names.
fn changed_tank(change: impl Fn(&str, &mut Vec<f64>) -> String) -> Calibration {
    let data = example("quad_tank", 1.0);
    let column = |name: &str| {
        let mut values = data.column(name).unwrap().to_vec();
        (change(name, &mut values), values)
    };
    let columns: Vec<_> = data.names().map(column).collect();
    tank(Data::from_columns(data.time().to_vec(), columns).unwrap())
}

#[test]
fn long_gaps_of_an_input_are_reported() {
    let without = |n: usize| {
        changed_tank(move |name, values| {
            if name == "u1" {
                values[20..20 + n].fill(f64::NAN);
            }
            name.to_owned()
        })
    };
    let reported = "input 'u1' (column 'u1'): the input has no value from";
    for (n, is_named) in [(1, false), (2, false), (3, true), (12, true)] {
        let calibration = without(n);
        let check = calibration
            .check_with(&CheckOptions { simulate: false, ..CheckOptions::default() }, &RunContext::new());
        assert_eq!(warns(&check.unwrap().findings, reported), is_named, "{n}");
    }
    let calibration = without(12);
    let preflight = calibration.preflight(&PreflightOptions::default(), &RunContext::new()).unwrap();
    assert!(warns(&preflight.findings, reported), "{preflight}");
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert!(warns(&fit.findings(), "The simulation uses a straight line there"), "{fit}");
}

#[test]
fn placeholder_is_reported_as_in_the_file_after_conversion() {
    let calibration = changed_tank(|name, values| match name {
        "x1" => {
            values.iter_mut().for_each(|value| *value *= 1e3);
            values[30] = -999.0;
            "x1 [mm]".to_owned()
        }
        other => other.to_owned(),
    });
    let check = calibration.check();
    assert!(warns(&check.findings, "one value is -999 mm, the others lie between"), "{check}");
}
