//! Errors of the parameters and of measured initial states together, and how well their variances are known.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Fewer degrees of freedom than one are an accident of the estimates.
const FEWEST: f64 = 1.0;

/// A variance whose degrees of freedom are to be found, with its derivatives with respect to the parameters
/// of the noise.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct VarianceEstimate {
    pub(crate) value: f64,
    pub(crate) slopes: Vec<f64>,
}

/// Joint covariance of the errors of the n parameters of a fit, in the user's units, and of k measured
/// initial states, row by row.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct JointErrors {
    /// Experiments of the initial states, counted from 0, and their names.
    pub(crate) starts: Vec<(usize, String)>,
    /// The covariance, (n + k) x (n + k); zero for parameters without a finite standard error.
    pub(crate) covariance: Vec<f64>,
    /// Its derivatives with respect to the parameters of the noise, which begin with the logarithms of its
    /// variances.
    pub(crate) slopes: Vec<Vec<f64>>,
    /// Covariance of these parameters.
    pub(crate) uncertainty: Vec<f64>,
    /// For each output of each experiment: the number of its variance, and the variance of its plain
    /// residuals.
    pub(crate) outputs: Vec<(usize, f64)>,
}

impl JointErrors {
    /// True for a fit of a file that has none.
    pub(crate) fn is_empty(&self) -> bool {
        self.covariance.is_empty()
    }

    /// Number of errors.
    fn len(&self) -> usize {
        self.covariance.len().isqrt()
    }

    /// A matrix of them.
    pub(crate) fn matrix(&self, of: &[f64]) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.len(), self.len(), of)
    }

    /// The variance of one of the errors.
    pub(crate) fn of(&self, i: usize) -> VarianceEstimate {
        let at = i * self.len() + i;
        VarianceEstimate {
            value: self.covariance[at],
            slopes: self.slopes.iter().map(|slope| slope[at]).collect(),
        }
    }

    /// Degrees of freedom of a variance v that is a function of the parameters of the noise:
    /// `2 v^2 / var(v)` (Satterthwaite, Biometrics Bulletin 2, 1946; Kenward and Roger, Biometrics 53, 1997).
    /// Infinite for a variance that is known, NaN for one that is zero.
    pub(crate) fn degrees_of_freedom(&self, of: &VarianceEstimate) -> f64 {
        let n = of.slopes.len();
        let uncertainty = DMatrix::from_row_slice(n, n, &self.uncertainty);
        satterthwaite(of, &uncertainty)
    }

    /// True if the parts fit together, and to n parameters and as many outputs.
    pub(crate) fn is_sound(&self, n: usize, n_outputs: usize) -> bool {
        let (size, m) = ((n + self.starts.len()).pow(2), self.slopes.len());
        self.covariance.len() == size
            && self.slopes.iter().all(|slope| slope.len() == size)
            && self.uncertainty.len() == m * m
            && self.outputs.len() == n_outputs
            && self.outputs.iter().all(|(variance, _)| *variance < m)
    }
}

/// See [`JointErrors::degrees_of_freedom`].
pub(crate) fn satterthwaite(of: &VarianceEstimate, uncertainty: &DMatrix<f64>) -> f64 {
    let slopes = DVector::from_column_slice(&of.slopes);
    let variance = slopes.dot(&(uncertainty * &slopes));
    let found = 2.0 * of.value * of.value / variance;
    if found < FEWEST { FEWEST } else { found }
}
