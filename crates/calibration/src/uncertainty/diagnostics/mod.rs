//! What the residuals of a fit say about model and measurements: tests of each output, and their causes.

pub(crate) mod by_weights;
pub(crate) mod output_effect;
pub(crate) mod parameter_constancy;
pub(crate) mod prior_check;
pub(crate) mod residual_check;
