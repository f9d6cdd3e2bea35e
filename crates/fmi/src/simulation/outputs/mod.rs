//! Outputs of a simulation: the recorded variables, the buffers for their values, and the tables of strings.

mod buffers;
mod selection;
mod texts;

pub use buffers::Recorded;
pub(crate) use buffers::{OutputBuffers, OutputContext, OutputPlan, element_of};
pub(crate) use selection::{Selection, states};
pub(crate) use texts::{ValueTable, integers, places, width};
