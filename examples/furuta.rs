//! Calibrates the friction of a Furuta pendulum (Gedda, Andersson, Akesson, Diehl 2012, section 6.1) from Rust.
//!
//! Run with `cargo run --release --example furuta`.

#![allow(clippy::print_stdout)]

use calibration::RunContext;
use fmufit::calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
use fmufit::example_models::example_fmu;
use fmufit::fmi::Fmu;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/data/furuta.csv");
    let fmu = Fmu::open(example_fmu("furuta")?)?;
    let calibration = Calibration::builder(fmu)
        .experiment(
            Experiment::new(Data::from_csv(data)?)
                .output("armJoint.phi", "phi")
                .output("pendulumJoint.phi", "theta"),
        )
        .parameter(Parameter::new("armFriction", 0.012).bounds(0.0, 0.022))
        .parameter(Parameter::new("pendulumFriction", 0.002).bounds(0.0, 0.012))
        .build()?;
    let nominal = calibration.cost(&calibration.start(), &RunContext::new())?;
    let fit = calibration.fit(FitOptions::default())?;
    println!("nominal cost {nominal:.4}");
    println!("{fit}");
    Ok(())
}
