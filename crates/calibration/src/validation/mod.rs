//! Validation with recordings that a fit has not seen, and cross-validation.

pub(crate) mod cross_validation;
pub(crate) mod held_out;
