//! Calibrates the outlets of a quadruple tank in two steps, with recorded voltages as inputs.
//!
//! The first step fits the outlets of the lower tanks to the lower levels only. The second step fits all four
//! outlets to all four levels. Run with `cargo run --release --example quad_tank`.

#![allow(clippy::print_stdout)]

use fmufit::calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
use fmufit::example_models::example_fmu;
use fmufit::fmi::Fmu;
use std::error::Error;
use std::path::Path;

/// Fits the first `n` outlets to the first `n` levels, starting at 3e-6 m2.
fn calibrate(fmu: &Fmu, data: &Data, n: usize) -> Result<(), Box<dyn Error>> {
    let mut experiment = Experiment::new(data.clone()).input("u1", "u1").input("u2", "u2");
    for i in 1..=n {
        experiment = experiment.output(format!("qt.x{i}"), format!("x{i}"));
    }
    let mut builder = Calibration::builder(fmu.clone()).experiment(experiment);
    for i in 1..=n {
        builder = builder.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6));
    }
    let fit = builder.build()?.fit(FitOptions::default())?;
    println!("{n} outlets to {n} levels\n{fit}\n");
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/data/quad_tank.csv");
    let (fmu, data) = (Fmu::open(example_fmu("quad_tank")?)?, Data::from_csv(data)?);
    calibrate(&fmu, &data, 2)?;
    calibrate(&fmu, &data, 4)
}
