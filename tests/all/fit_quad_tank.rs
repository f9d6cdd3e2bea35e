//! Black-box test of a model driven by recorded inputs: the outlets of the quadruple tank from noisy levels.

#![allow(clippy::unwrap_used)]

use crate::common;

use calibration::RunContext;
use common::*;
use fmufit::calibration::{Calibration, Data, Experiment, Fit, FitOptions, Parameter};
use fmufit::dfo::RunOptions;
use std::path::Path;

/// True values of the outlets, in 1e-6 m2, and the standard deviations of a fit of all four.
const TRUE: [f64; 4] = [2.66, 2.71, 3.01, 2.93];
const DEVIATION: [f64; 4] = [0.0012, 0.0013, 0.0027, 0.0026];

fn measurements() -> Data {
    Data::from_csv(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/data/quad_tank.csv")).unwrap()
}

/// Returns the calibration of the first `n` outlets with the first `n` levels.
fn calibration(data: Data, n: usize) -> Calibration {
    let mut experiment = Experiment::new(data).input("u1", "u1").input("u2", "u2");
    for i in 1..=n {
        experiment = experiment.output(format!("qt.x{i}"), format!("x{i}"));
    }
    let mut builder = Calibration::builder(example("quad_tank")).experiment(experiment);
    for i in 1..=n {
        builder = builder.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6));
    }
    builder.build().unwrap()
}

fn fit(calibration: &Calibration, workers: usize) -> Fit {
    calibration.fit(RunOptions { workers: Some(workers), ..FitOptions::default_run() }).unwrap()
}

#[test]
fn fit_finds_two_outlets_from_two_levels() {
    let calibration = calibration(measurements(), 2);
    let fit = fit(&calibration, 2);
    // The outlets of the upper tanks are fixed at start values next to the true ones, which causes a bias of
    // a few per mille.
    assert!((1e6 * fit.x[0] - TRUE[0]).abs() < 0.01, "{fit}");
    assert!((1e6 * fit.x[1] - TRUE[1]).abs() < 0.01, "{fit}");
    assert!(fit.start_cost.unwrap() > 100.0 * fit.cost);
    assert!((1e3 * fit.rms - 0.3).abs() < 0.06, "{fit}");
}

#[test]
fn fit_finds_four_outlets_for_any_number_of_workers() {
    let calibration = calibration(measurements(), 4);
    let one = fit(&calibration, 1);
    for i in 0..4 {
        assert!((1e6 * one.x[i] - TRUE[i]).abs() < 4.0 * DEVIATION[i], "{one}");
    }
    assert!((1e3 * one.rms - 0.3).abs() < 0.04, "{one}");
    let three = fit(&calibration, 3);
    assert_eq!((&one.x, one.cost.to_bits()), (&three.x, three.cost.to_bits()));
}

/// An input is linear between its rows. Additional rows on the same lines change only rounding.
#[test]
fn inputs_are_linear_between_rows() {
    let data = measurements();
    let between = |values: &[f64]| -> Vec<f64> {
        (0..=120).map(|k| 0.5 * (values[k / 2] + values[k.div_ceil(2)])).collect()
    };
    let mut columns: Vec<(String, Vec<f64>)> =
        ["u1", "u2"].map(|u| (u.to_owned(), between(data.column(u).unwrap()))).into();
    for level in ["x1", "x2"] {
        let mut measured = vec![f64::NAN; 121];
        for (k, value) in data.column(level).unwrap().iter().enumerate() {
            measured[2 * k] = *value;
        }
        columns.push((level.to_owned(), measured));
    }
    let finer = Data::from_columns((0..=120).map(|k| 0.5 * f64::from(k)).collect(), columns).unwrap();
    let x = [2.66e-6, 2.71e-6];
    let expected = calibration(data, 2).cost(&x, &RunContext::new()).unwrap();
    let found = calibration(finer, 2).cost(&x, &RunContext::new()).unwrap();
    assert!((found - expected).abs() < 1e-5 * expected, "{found} instead of {expected}");
}
