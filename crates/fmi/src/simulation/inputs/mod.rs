//! Time-varying inputs: tables, functions and texts, resolved to calls, and where a run stands in them.

mod plan;
mod state;
mod texts;

pub use crate::worker::InputFunction;
pub(crate) use plan::InputPlan;
pub use plan::Inputs;
pub(crate) use state::InputState;
