//! What the residuals of a fit say about model and measurements: tests of each output, and of priors.

pub(crate) mod prior_check;
pub(crate) mod residual_check;
