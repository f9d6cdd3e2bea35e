//! Implicit methods for stiff systems, with a common Newton's method and common rules for reusing its
//! matrices.

mod algebraic;
mod bdf;
mod kept_jacobian;
mod newton;
mod radau5;

pub(crate) use bdf::Bdf;
pub(crate) use radau5::Radau5;
