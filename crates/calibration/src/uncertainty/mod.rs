//! Uncertainty of the parameters: covariance, residual tests, active bounds, the same before a fit.

pub(crate) mod bounds;
pub(crate) mod estimate;
pub(crate) mod preflight;
