//! Joint errors of the parameters and of measured initial states, and the precision of their variances.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Smallest number of degrees of freedom; smaller values are artefacts of the estimates.
const FEWEST: f64 = 1.0;

/// Estimate of a variance, with its derivatives with respect to the noise parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct VarianceEstimate {
    pub(crate) value: f64,
    pub(crate) slopes: Vec<f64>,
}

/// Joint covariance of the errors of the n parameters of a fit and of k measured initial states, in the
/// user's units, row by row.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct JointErrors {
    /// Experiments of the initial states, counted from 0, and names of the states.
    pub(crate) starts: Vec<(usize, String)>,
    /// The covariance, (n + k) x (n + k); zero for parameters without a finite standard error.
    pub(crate) covariance: Vec<f64>,
    /// Derivatives of the covariance with respect to the noise parameters, the first of which are the
    /// logarithms of the noise variances.
    pub(crate) slopes: Vec<Vec<f64>>,
    /// Covariance of the noise parameters.
    pub(crate) uncertainty: Vec<f64>,
    /// For each output of each experiment, the index of its variance and the variance of its plain residuals.
    pub(crate) outputs: Vec<(usize, f64)>,
}

impl JointErrors {
    /// True for a fit loaded from a file without joint errors.
    pub(crate) fn is_empty(&self) -> bool {
        self.covariance.is_empty()
    }

    /// Returns the number of errors.
    fn len(&self) -> usize {
        self.covariance.len().isqrt()
    }

    /// Returns the matrix with these entries.
    pub(crate) fn matrix(&self, of: &[f64]) -> DMatrix<f64> {
        DMatrix::from_row_slice(self.len(), self.len(), of)
    }

    /// Returns the variance of one of the errors.
    pub(crate) fn of(&self, i: usize) -> VarianceEstimate {
        let at = i * self.len() + i;
        VarianceEstimate {
            value: self.covariance[at],
            slopes: self.slopes.iter().map(|slope| slope[at]).collect(),
        }
    }

    /// Returns the degrees of freedom of a variance v that is a function of the noise parameters: `2 v^2 /
    /// var(v)` (Satterthwaite, Biometrics Bulletin 2, 1946; Kenward and Roger, Biometrics 53, 1997). The
    /// result is infinite for a known variance and NaN for a zero variance.
    pub(crate) fn degrees_of_freedom(&self, of: &VarianceEstimate) -> f64 {
        let n = of.slopes.len();
        let uncertainty = DMatrix::from_row_slice(n, n, &self.uncertainty);
        satterthwaite(of, &uncertainty)
    }

    /// True if the sizes are consistent with each other, with n parameters and with `n_outputs` outputs.
    pub(crate) fn is_sound(&self, n: usize, n_outputs: usize) -> bool {
        let (size, m) = ((n + self.starts.len()).pow(2), self.slopes.len());
        self.covariance.len() == size
            && self.slopes.iter().all(|slope| slope.len() == size)
            && self.uncertainty.len() == m * m
            && self.outputs.len() == n_outputs
            && self.outputs.iter().all(|(variance, _)| *variance < m)
    }
}

/// Returns the degrees of freedom; see [`JointErrors::degrees_of_freedom`].
pub(crate) fn satterthwaite(of: &VarianceEstimate, uncertainty: &DMatrix<f64>) -> f64 {
    let slopes = DVector::from_column_slice(&of.slopes);
    let variance = slopes.dot(&(uncertainty * &slopes));
    let found = 2.0 * of.value * of.value / variance;
    if found < FEWEST { FEWEST } else { found }
}
