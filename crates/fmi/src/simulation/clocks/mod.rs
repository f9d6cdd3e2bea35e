//! Clocks (FMI 3.0) in simulations. `state` contains their state during a run.

mod plan;
mod state;

pub(crate) use plan::{ClockInputs, ClockPlan, Clocked};
pub(crate) use state::ClockState;
pub use state::Tick;
