//! Calibrates a diesel exhaust pipe as in Gedda, Andersson, Åkesson and Diehl (2012), section 6.2: first the
//! right gas volume, then the left.
//!
//! The model is stiff and has five recorded inputs. Its solver is chosen by comparison. The first 500 s of
//! the recording are used for the calibration, the rest for the validation. Then all four parameters are
//! fitted at once, and the fit reports that the data do not determine them separately. Run with
//! `cargo run --release --example exhaust`.

#![allow(clippy::print_stdout)]

use calibration::RunContext;
use fmufit::calibration::{
    Calibration, Data, Experiment, Fit, FitOptions, Parameter, Stage, Validation, ValidationSet,
};
use fmufit::example_models::example_fmu;
use fmufit::fmi::Fmu;
use std::error::Error;
use std::path::Path;

const INPUTS: [&str; 5] = ["T_in", "p_in", "w_turb1", "w_turb2", "p_out"];

/// Parameter, nominal value and upper bound: heat capacities in J/K and conductances in W/K of both walls.
const PARAMETERS: [(&str, f64, f64); 4] =
    [("C1", 2500.0, 5e4), ("G1", 120.0, 500.0), ("C2", 9000.0, 5e4), ("G2", 80.0, 500.0)];

/// Prints the parameters of a fit and its RMS relative to the RMS of the nominal parameters.
fn show(what: &str, fit: &Fit, validation: &Validation, nominal: (f64, f64)) {
    let values: Vec<String> =
        fit.names.iter().zip(&fit.x).map(|(name, x)| format!("{name} = {x:.1}")).collect();
    let (scaled, elsewhere) = (fit.rms / nominal.0, validation.rms / nominal.1);
    println!(
        "{what}: {}; scaled RMS {scaled:.3} in the fit, {elsewhere:.3} in the validation",
        values.join(", ")
    );
}

fn main() -> Result<(), Box<dyn Error>> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/data/exhaust.csv");
    let mut experiment = Experiment::new(Data::from_csv(data)?).output("T_out", "T_out").window(0.0, 500.0);
    for name in INPUTS {
        experiment = experiment.input(name, name);
    }
    let mut builder = Calibration::builder(Fmu::open(example_fmu("exhaust")?)?).experiment(experiment);
    for (name, nominal, upper) in PARAMETERS {
        builder = builder.parameter(Parameter::new(name, nominal).bounds(1e-4 * nominal, upper));
    }
    let calibration = builder.build()?;
    let validated = |fit: &Fit| {
        calibration.validate(fit, &ValidationSet::Windows(vec![(501.0, 1200.0)]), &RunContext::new())
    };

    let stages = [Stage::new(["C2", "G2"]), Stage::new(["C1", "G1"])];
    let fit = calibration.fit_stages(&stages, FitOptions::default())?;
    let simulated = "the simulation failed at the nominal parameters";
    let nominal = (fit.start_rms.ok_or(simulated)?, validated(&fit)?.start_rms.ok_or(simulated)?);
    for (stage, volume) in fit.stages.iter().zip(["right volume", "then left"]) {
        show(volume, stage, &validated(stage)?, nominal);
    }

    let at_once = calibration.fit(FitOptions::default())?;
    show("all four at once", &at_once, &validated(&at_once)?, nominal);
    println!("\n{at_once}");
    let uncertainty = at_once.uncertainty.as_ref().ok_or("the fit has no uncertainty")?;
    if uncertainty.confounded.is_empty() {
        return Err("the four parameters are not identifiable together, but the fit did not report it".into());
    }
    Ok(())
}
