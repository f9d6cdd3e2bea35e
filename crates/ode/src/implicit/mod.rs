//! Implicit methods for stiff systems.

mod bdf;
mod radau5;

pub(crate) use bdf::Bdf;
pub(crate) use radau5::Radau5;
