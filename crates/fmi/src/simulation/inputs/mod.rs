//! Time-varying inputs: tables, functions and strings, resolved to calls, and the input state of a run.

mod plan;
mod state;
mod texts;

pub use crate::worker::InputFunction;
pub(crate) use plan::InputPlan;
pub use plan::Inputs;
pub(crate) use state::InputState;
