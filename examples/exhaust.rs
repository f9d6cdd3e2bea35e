//! Calibrates the heat losses of a diesel exhaust pipe: a stiff model driven by five inputs, its solver found by a race.
//!
//! The recording is made of the model itself with known parameters, noise of a degree, and a drive cycle of ramps; then the
//! parameters are found again from a start that is off by up to 60 %. Run with `cargo run --release --example exhaust`.

#![allow(clippy::print_stdout)]

use fmufit::calibration::{Calibration, Data, Experiment, FitOptions, Parameter, Scale};
use fmufit::example_models::example_fmu;
use fmufit::fmi::{Fmu, Inputs, SimulateOptions};
use std::error::Error;

/// Parameter, its true value, where the fit starts.
const PARAMETERS: [(&str, f64, f64); 4] =
    [("C1", 2500.0, 4000.0), ("G1", 120.0, 80.0), ("C2", 9000.0, 6000.0), ("G2", 80.0, 120.0)];

/// Input, its value without load, what full load adds.
const INPUTS: [(&str, f64, f64); 5] = [
    ("T_in", 450.0, 450.0),
    ("p_in", 1.1e5, 1.2e5),
    ("w_turb1", 2000.0, 4000.0),
    ("w_turb2", 1500.0, 3500.0),
    ("p_out", 1.013e5, 0.0),
];

/// Times in s and the load there, with ramps between them.
const CYCLE: [(f64, f64); 9] = [
    (0.0, 0.1),
    (20.0, 0.1),
    (50.0, 0.6),
    (90.0, 0.4),
    (120.0, 0.9),
    (160.0, 0.2),
    (200.0, 0.7),
    (230.0, 0.3),
    (300.0, 0.5),
];

fn load(time: f64) -> f64 {
    let ramp = CYCLE.windows(2).find(|ramp| time <= ramp[1].0).unwrap_or(&CYCLE[7..]);
    let ((from, low), (to, high)) = (ramp[0], ramp[1]);
    low + (high - low) * (time - from) / (to - from)
}

/// Standard normal numbers: sums of twelve uniform ones, less six.
fn noise(seed: &mut u64) -> f64 {
    let mut uniform = || {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..12).map(|_| uniform()).sum::<f64>() - 6.0
}

/// Inputs and measured outlet temperature, once a second.
fn recording(fmu: &Fmu) -> Result<Data, Box<dyn Error>> {
    let time: Vec<f64> = (0..=300).map(f64::from).collect();
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    let mut inputs = Inputs::new();
    for (name, idle, more) in INPUTS {
        let values: Vec<f64> = time.iter().map(|t| idle + more * load(*t)).collect();
        inputs = inputs.series(name, time.clone(), values.clone());
        columns.push((name.to_owned(), values));
    }
    let mut options =
        SimulateOptions::new().times(time.clone()).final_time(300.0).inputs(inputs).outputs(["T_out"]);
    for (name, truth, _) in PARAMETERS {
        options = options.start_value(name, truth);
    }
    let mut seed = 1;
    let measured = fmu.simulate(&options)?.get("T_out")?.iter().map(|t| t + noise(&mut seed)).collect();
    columns.push(("T_out".to_owned(), measured));
    Ok(Data::from_columns(time, columns)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let fmu = Fmu::open(example_fmu("exhaust")?)?;
    let mut experiment = Experiment::new(recording(&fmu)?).output("T_out", "T_out");
    for (name, ..) in INPUTS {
        experiment = experiment.input(name, name);
    }
    let mut builder = Calibration::builder(fmu).experiment(experiment);
    for (name, _, start) in PARAMETERS {
        let parameter = Parameter::new(name, start).bounds(0.1 * start, 10.0 * start).scale(Scale::Log);
        builder = builder.parameter(parameter);
    }
    let fit = builder.build()?.fit(FitOptions::default())?;
    for entry in fit.solver.race.iter().flat_map(|race| &race.entries) {
        println!("{}: {:?} right-hand sides' work, {:?}", entry.method.name(), entry.work, entry.verdict);
    }
    println!("{fit}");
    for ((name, truth, start), x) in PARAMETERS.iter().zip(&fit.x) {
        println!("{name}: {start} -> {x:.1}, truth {truth}");
    }
    if (fit.rms - 1.0).abs() > 0.1 {
        return Err(format!("the fit has not found the noise: RMS {} K", fit.rms).into());
    }
    Ok(())
}
