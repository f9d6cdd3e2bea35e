//! The covariance of the parameters: from the changes of the residuals, with autocorrelation and measured
//! initial states; and the parameters that the data do not determine.

pub(crate) mod autocorrelation;
pub(crate) mod identifiability;
pub(crate) mod matrix;
pub(crate) mod measured_start;
pub(crate) mod remaining_decrease;
