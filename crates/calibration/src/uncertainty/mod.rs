//! Uncertainty of the parameters: covariance, residual tests, active bounds, and the preflight before a fit.

pub(crate) mod covariance;
pub(crate) mod derived_value;
pub(crate) mod diagnostics;
pub(crate) mod differences;
pub(crate) mod estimate;
pub(crate) mod group;
pub(crate) mod inactive_parameters;
pub(crate) mod joint_errors;
pub(crate) mod preflight;
pub(crate) mod result;
pub(crate) mod robust;
pub(crate) mod row_blocks;
pub(crate) mod scores;
