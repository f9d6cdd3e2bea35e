//! What a fit is worth: how uncertain its parameters are, which of them the data can tell apart, and what the residuals look like.

use serde::{Deserialize, Serialize};

/// How the covariance of the parameters is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// `(J'J)^-1 J'SJ (J'J)^-1` with one residual variance per output.
    #[default]
    Sandwich,
    /// `s^2 (J'J)^-1` with one variance for all residuals.
    Pooled,
}

/// What a fit is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Worth {
    /// How the covariance was estimated.
    pub estimator: Estimator,
    /// Covariance of the parameters, n x n, row by row, in the user's units. Zero for parameters that are [held](Self::held); infinite on
    /// the diagonal, NaN beside it, for those that the data do not [determine](Self::undetermined).
    pub covariance: Vec<f64>,
    /// Standard errors: the roots of its diagonal.
    pub standard_errors: Vec<f64>,
    /// Correlation of the parameters, n x n, row by row; NaN where a standard error is zero or infinite.
    pub correlation: Vec<f64>,
    /// Standard errors with autocorrelated residuals taken into account; `None` where they are not correlated.
    pub corrected_errors: Option<Vec<f64>>,
    /// The residuals of each output of each experiment, in the order of the residual vector.
    pub residual_checks: Vec<ResidualCheck>,
    /// Parameters that are fixed or lie at a bound, by number: taken as known.
    pub held: Vec<usize>,
    /// Parameters that the data do not determine, by number.
    pub undetermined: Vec<usize>,
    /// Pairs of parameters that move the outputs the same way, with their correlation.
    pub confounded: Vec<(usize, usize, f64)>,
    /// What is to be said of all this, in sentences; empty if nothing is.
    pub verdict: Vec<String>,
    /// The cost with simulations a hundred times more accurate; `None` where they failed.
    pub accurate_cost: Option<f64>,
    /// Derivatives of the residuals by the parameters, m x n, row by row, in the user's units.
    pub jacobian: Vec<f64>,
    /// The residuals, m.
    pub residuals: Vec<f64>,
    /// Simulations that were made to find out.
    pub n_simulations: usize,
}

/// The residuals of one output of one experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ResidualCheck {
    /// The experiment.
    pub experiment: String,
    /// The variable of the model.
    pub variable: String,
    /// How many residuals it has.
    pub n: usize,
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation.
    pub deviation: f64,
    /// Their autocorrelation at lag one; NaN for fewer than three.
    pub autocorrelation: f64,
}
