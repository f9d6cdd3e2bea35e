//! Implicit methods for stiff systems: Newton's method and the age of its matrices are the same for all.

mod algebraic;
mod bdf;
mod kept_jacobian;
mod newton;
mod radau5;

pub(crate) use bdf::Bdf;
pub(crate) use radau5::Radau5;
