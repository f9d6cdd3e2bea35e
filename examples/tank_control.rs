//! Tunes a PI controller of the quadruple tank: fast, with an overshoot below 5 %.

#![allow(clippy::print_stdout)]

use fmufit::calibration::{Design, Experiment, FitOptions, Parameter};
use fmufit::example_models::example_fmu;
use fmufit::fmi::Fmu;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    fmufit::calibration::serve_if_worker();
    let design = Design::builder(Fmu::open(example_fmu("tank_control")?)?)
        .goal("itae(e1)".parse()?)
        .constraint("overshoot(x1, r1) <= 5".parse()?)
        // Gain in V/cm and integral time in s of the left controller.
        .parameter(Parameter::new("K1", 3.0).bounds(0.5, 20.0))
        .parameter(Parameter::new("T1", 30.0).bounds(5.0, 200.0))
        .scenario(Experiment::default().final_time(400.0).start_value("r2", 12.783_158_403_008_972))
        .build()?;
    let result = design.optimize(FitOptions::default())?;
    println!("{result}");
    assert!(result.is_success());
    Ok(())
}
