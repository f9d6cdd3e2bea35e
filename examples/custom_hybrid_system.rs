//! A hand-written hybrid system without an FMU: a room with a heater that a thermostat switches.
//!
//! The temperature falls towards 5 degrees outside and rises while the heater is on. The thermostat switches
//! on below 19 and off above 21 degrees. Both switches are state events. Run with
//! `cargo run --example custom_hybrid_system`.

#![allow(clippy::print_stdout)]

use fmufit::ode::{
    CallResult, Driver, EventOutcome, EventRecord, EventVisit, HybridSystem, Observer, Options, Sample,
};
use std::ops::ControlFlow;

const OUTSIDE: f64 = 5.0;
/// Loss rate of the room, 1/h.
const LOSS: f64 = 0.2;
/// Heating rate, degrees per hour.
const HEAT: f64 = 6.0;

struct Room {
    heater_on: bool,
}

impl HybridSystem for Room {
    fn n_states(&self) -> usize {
        1
    }

    fn n_event_indicators(&self) -> usize {
        1
    }

    fn start(&mut self, _t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x[0] = 20.0;
        self.heater_on = false;
        Ok(EventOutcome::default())
    }

    fn derivatives(&mut self, _t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx[0] = LOSS * (OUTSIDE - x[0]) + if self.heater_on { HEAT } else { 0.0 };
        Ok(())
    }

    /// Positive as long as the present mode continues.
    fn event_indicators(&mut self, _t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        z[0] = if self.heater_on { 21.0 - x[0] } else { x[0] - 19.0 };
        Ok(())
    }

    fn handle_event(&mut self, _visit: &EventVisit<'_>, _x: &mut [f64]) -> CallResult<EventOutcome> {
        self.heater_on = !self.heater_on;
        Ok(EventOutcome::default())
    }
}

#[derive(Default)]
struct Printer {
    switches: Vec<f64>,
}

impl Observer for Printer {
    fn sample(&mut self, s: &Sample<'_>) -> ControlFlow<()> {
        println!("{:5.2} h  {:6.3} degrees", s.time, s.states[0]);
        ControlFlow::Continue(())
    }

    fn event(&mut self, event: &EventRecord) {
        self.switches.push(event.time);
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let hours: Vec<f64> = (0..=16).map(|k| 0.25 * f64::from(k)).collect();
    let mut printer = Printer::default();
    let mut driver = Driver::new(Options { relative_tolerance: 1e-8, ..Options::default() })?;
    let report = driver.run(&mut Room { heater_on: false }, 0.0, 4.0, &hours, &mut printer)?;
    println!("switched at {:.6?} h; {} steps", printer.switches, report.stats.accepted_steps);
    // The first switch has a closed form: 5 + 15 exp(-0.2 t) = 19.
    let exact = (15.0_f64 / 14.0).ln() / LOSS;
    assert!((printer.switches[0] - exact).abs() < 1e-7, "{} instead of {exact}", printer.switches[0]);
    Ok(())
}
