//! Uncertainty of the parameters: covariance, residual tests, active bounds, the same before a fit.

pub(crate) mod active_bounds;
pub(crate) mod estimate;
pub(crate) mod preflight;
pub(crate) mod row_blocks;
