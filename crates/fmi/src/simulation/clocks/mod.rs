//! Clocks (FMI 3.0) in simulations: `state` has them while it runs.

mod plan;
mod state;

pub(crate) use plan::{ClockInputs, ClockPlan, Clocked};
pub(crate) use state::ClockState;
pub use state::Tick;
