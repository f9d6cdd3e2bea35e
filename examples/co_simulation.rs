//! Fits a co-simulation FMU, which contains its own solver, to a recording in cm and ms instead of the
//! model's units.
//!
//! The recording is the quadruple-tank recording in the form that a data logger might write. Columns with
//! units are converted to the units of the model's variables. The fit is then exported: saved, as a parameter
//! file for other tools (`.ssv`), and as a report. Run with `cargo run --release --example co_simulation`.

#![allow(clippy::print_stdout)]

use calibration::RunContext;
use fmufit::calibration::{Calibration, Data, Experiment, FitOptions, Parameter, SavedFit};
use fmufit::example_models::{ExampleKind, example_fmu_as};
use fmufit::fmi::{Fmu, RunSettings};
use std::error::Error;
use std::path::Path;

/// Returns the recording in cm and ms, with column names of a data logger.
fn logged() -> Result<Data, Box<dyn Error>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/data/quad_tank.csv");
    let recording = Data::from_csv(path)?;
    let scaled = |values: &[f64], by: f64| values.iter().map(|v| v * by).collect::<Vec<f64>>();
    let mut columns = vec![("time [ms]".to_owned(), scaled(recording.time(), 1e3))];
    for input in ["u1", "u2"] {
        columns.push((input.to_owned(), recording.column(input)?.to_vec()));
    }
    for i in 1..=4 {
        columns.push((format!("level {i} [cm]"), scaled(recording.column(&format!("x{i}"))?, 1e2)));
    }
    Ok(Data::from_table(columns, None)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let fmu = Fmu::open(example_fmu_as("quad_tank", ExampleKind::Fmi2CoSimulation)?)?;
    let mut experiment = Experiment::new(logged()?).input("u1", "u1").input("u2", "u2");
    for i in 1..=4 {
        experiment = experiment.output(format!("qt.x{i}"), format!("level {i}"));
    }
    let settings = RunSettings { step_size: Some(0.1), ..RunSettings::default() };
    let mut builder = Calibration::builder(fmu.clone()).experiment(experiment).settings(settings);
    for i in 1..=4 {
        builder = builder.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6));
    }
    let calibration = builder.build()?;
    println!("{}", calibration.check());
    let fit = calibration.fit(FitOptions::default())?;
    println!("{fit}");

    let folder = std::env::temp_dir().join(format!("quad-tank-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    fit.save(&calibration, folder.join("quad_tank.fit"))?;
    fit.export_ssv(&calibration, folder.join("quad_tank.ssv"), None)?;
    calibration.report(&fit, folder.join("report.html"), &RunContext::new())?;
    let again = SavedFit::load(folder.join("quad_tank.fit"))?;
    if again.fit.x != fit.x || again.calibration_with(fmu)?.cost(&fit.x, &RunContext::new())? != fit.cost {
        return Err("the loaded fit differs from the saved fit".into());
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
