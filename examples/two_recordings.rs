//! Fits one pendulum to two recordings that begin at different angles. The frictions are shared; each
//! recording has its own initial angle.
//!
//! The recordings are generated from the bundled model with known parameters and noise. Run with
//! `cargo run --release --example two_recordings`.

#![allow(clippy::print_stdout)]

use fmufit::calibration::{Calibration, Data, Experiment, FitOptions, Parameter};
use fmufit::example_models::example_fmu;
use fmufit::fmi::{Fmu, SimulateOptions};
use std::error::Error;

/// Output and standard deviation of its noise in rad.
const OUTPUTS: [(&str, f64); 2] = [("armJoint.phi", 0.03), ("pendulumJoint.phi", 0.02)];

/// Friction, true value, start value of the fit and upper bound, in N m.
const FRICTIONS: [(&str, f64, f64, f64); 2] =
    [("armFriction", 0.011, 0.012, 0.022), ("pendulumFriction", 0.0013, 0.002, 0.012)];

/// Returns a standard normal number: the sum of twelve uniform numbers, minus six.
fn noise(seed: &mut u64) -> f64 {
    let mut uniform = || {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..12).map(|_| uniform()).sum::<f64>() - 6.0
}

/// Generates a recording of 20 s that begins at this angle of the pendulum.
fn recording(fmu: &Fmu, angle: f64, seed: &mut u64) -> Result<Data, Box<dyn Error>> {
    let time: Vec<f64> = (0..=400).map(|k| 0.05 * f64::from(k)).collect();
    let mut options = SimulateOptions::new()
        .times(time.clone())
        .final_time(20.0)
        .outputs(OUTPUTS.map(|(name, _)| name))
        .start_value("pendulumJoint.phi", angle);
    for (name, truth, ..) in FRICTIONS {
        options = options.start_value(name, truth);
    }
    let trajectory = fmu.simulate(&options)?;
    let mut columns = Vec::new();
    for (name, sigma) in OUTPUTS {
        let measured = trajectory.get(name)?.iter().map(|y| y + sigma * noise(seed)).collect();
        columns.push((name.to_owned(), measured));
    }
    Ok(Data::from_columns(time, columns)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let fmu = Fmu::open(example_fmu("furuta")?)?;
    let (mut builder, mut seed) = (Calibration::builder(fmu.clone()), 7);
    for (name, angle, guess) in [("high", 0.52, 0.5), ("low", 1.9, 2.0)] {
        let first_angle = Parameter::new("first angle", guess).bounds(0.0, 3.0);
        let mut experiment = Experiment::new(recording(&fmu, angle, &mut seed)?)
            .named(name)
            .initial_state("pendulumJoint.phi", first_angle);
        for (output, sigma) in OUTPUTS {
            experiment = experiment.weighted_output(output, output, 1.0 / sigma);
        }
        builder = builder.experiment(experiment);
    }
    for (name, _, start, upper) in FRICTIONS {
        builder = builder.parameter(Parameter::new(name, start).bounds(0.0, upper));
    }
    let fit = builder.build()?.fit(FitOptions::default())?;
    println!("{fit}");
    if (fit.rms - 1.0).abs() > 0.1 {
        return Err(format!(
            "residuals divided by their standard deviations have the RMS {}, not 1",
            fit.rms
        )
        .into());
    }
    Ok(())
}
