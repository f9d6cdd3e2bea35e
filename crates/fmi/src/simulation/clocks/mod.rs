//! Clocks of model exchange and co-simulation: who ticks when, and what happens at a tick.

mod plan;
mod schedule;
mod state;

pub(crate) use plan::{ClockInputs, ClockPlan, Clocked};
pub(crate) use state::ClockState;
pub use state::Tick;
