//! Covariance of the parameters: the noise of the residuals, with autocorrelation and measured initial
//! states, its propagation to the parameters, and undetermined parameters.

pub(crate) mod achievable_decrease;
pub(crate) mod identifiability;
pub(crate) mod joint;
pub(crate) mod matrix;
pub(crate) mod measured_start;
pub(crate) mod moments;
pub(crate) mod noise;
