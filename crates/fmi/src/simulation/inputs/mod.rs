//! Time-varying inputs: tables, functions and texts, resolved to calls, and where a run stands in them.

mod plan;
mod state;
mod texts;

pub(crate) use plan::InputPlan;
pub use plan::{InputFunction, Inputs};
pub(crate) use state::InputState;
