//! Implicit methods for stiff systems, with a common Newton's method and common rules for reusing its
//! matrices.

mod algebraic;
mod kept_jacobian;
mod multistep;
mod newton;
mod radau5;

pub(crate) use multistep::{Formula, Multistep};
pub(crate) use radau5::Radau5;
