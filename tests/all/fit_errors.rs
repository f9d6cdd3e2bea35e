//! Errors in the setup of a fit: every mistake is reported by name.

#![allow(clippy::unwrap_used)]

use crate::common;

use calibration::RunContext;
use common::*;
use fmufit::calibration::{Calibration, CalibrationBuilder, Data, Experiment, FitOptions, Parameter};
use fmufit::fmi::RunSettings;

fn data(columns: &[(&str, &[f64])]) -> Data {
    let time = (0..columns[0].1.len()).map(|k| k as f64 * 0.1).collect();
    Data::from_columns(time, columns.iter().map(|(n, v)| ((*n).to_owned(), v.to_vec()))).unwrap()
}

fn builder() -> CalibrationBuilder {
    Calibration::builder(example("dahlquist"))
}

fn error(builder: CalibrationBuilder) -> String {
    builder.build().unwrap_err().to_string()
}

#[test]
fn setup_errors_name_missing_and_unknown_items() {
    let d = data(&[("x", &[1.0, 0.9, 0.8]), ("gaps", &[f64::NAN; 3])]);
    let e = || Experiment::new(d.clone());
    let k = || Parameter::new("k", 1.0).bounds(0.1, 10.0);
    for (b, expected) in [
        (builder().experiment(e().output("x", "x")), "parameters is empty"),
        (builder().parameter(k()), "experiments is empty"),
        (builder().parameter(k()).experiment(e()), "no output"),
        (builder().parameter(k()).experiment(e().output("x", "y")), "column 'y' not found"),
        (builder().parameter(k()).experiment(e().output("x", "gaps")), "missing"),
        (builder().parameter(k()).experiment(e().output("y", "x")), "y"),
        (builder().parameter(Parameter::new("kk", 1.0)).experiment(e().output("x", "x")), "kk"),
        (builder().parameter(k()).parameter(k()).experiment(e().output("x", "x")), "twice"),
        (builder().parameter(k().bounds(2.0, 1.0)).experiment(e().output("x", "x")), "above upper bound"),
        (builder().parameter(Parameter::new("k", f64::NAN)).experiment(e().output("x", "x")), "NaN"),
        (builder().parameter(k()).experiment(e().output("x", "x").window(5.0, 6.0)), "window from 5 to 6"),
        (
            builder().parameter(k()).experiment(e().output("x", "x").start_time(0.05)),
            "before the simulation starts",
        ),
        (builder().parameter(k()).experiment(e().weighted_output("x", "x", -1.0)), "weight -1"),
    ] {
        let message = error(b);
        assert!(message.contains(expected), "expected '{expected}' in: {message}");
    }
}

#[test]
fn wrong_number_of_values_is_reported_with_both_numbers() {
    let d = data(&[("x", &[1.0, 0.9, 0.8])]);
    let c = builder()
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .experiment(Experiment::new(d).output("x", "x"))
        .build()
        .unwrap();
    let e = c.cost(&[1.0, 2.0], &RunContext::new()).unwrap_err().to_string();
    assert!(e.contains("2 values given for 1 parameters (k)"), "{e}");
    assert!(c.cost(&[f64::NAN], &RunContext::new()).is_err());
    let e = c.fit(FitOptions { start: Some(vec![20.0]), ..FitOptions::default() }).unwrap_err().to_string();
    assert!(e.contains("'k'") && e.contains("start 20 is outside of the bounds 0.1 and 10"), "{e}");
    // The times exceed the model's default experiment, which ends at 10.
    let times = [0.0, 5.0, 50.0];
    assert_eq!(c.simulate(&[0.1], Some(&times), &RunContext::new()).unwrap()[0].time, times);
}

#[test]
fn failure_at_every_start_is_reported_with_counts() {
    let d = data(&[("x", &[1.0, 0.9, 0.8])]);
    let c = builder()
        .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
        .experiment(Experiment::new(d).output("x", "x"))
        .settings(RunSettings { timeout: Some(std::time::Duration::ZERO), ..RunSettings::default() })
        .build()
        .unwrap();
    let e = c.fit(FitOptions::default()).unwrap_err().to_string();
    assert!(e.contains("at every starting point") && e.contains("2 x the time limit"), "{e}");
}
