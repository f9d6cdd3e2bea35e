//! Diagnostics of model and measurements from the residuals of a fit: tests of each output and of priors.

pub(crate) mod lack_of_fit;
pub(crate) mod prior_check;
pub(crate) mod residual_check;
