//! Validation on recordings that a fit has not used, and cross-validation.

pub(crate) mod bootstrap;
pub(crate) mod cross_validation;
pub(crate) mod held_out;
mod saved_fits;
