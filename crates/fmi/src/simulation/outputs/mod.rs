//! Outputs of a simulation: the variables recorded, the buffers they are read into, and the tables of texts
//! beside them.

mod buffers;
mod selection;
mod texts;

pub use buffers::Recorded;
pub(crate) use buffers::{OutputBuffers, OutputContext, OutputPlan, element_of};
pub(crate) use selection::{Selection, states};
pub(crate) use texts::{ValueTable, integers, places, width};
