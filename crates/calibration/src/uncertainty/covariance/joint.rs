//! Joint covariance of the errors of parameters and measured initial states, computed from the noise of the
//! residuals.

use crate::uncertainty::covariance::matrix::Factors;
use crate::uncertainty::covariance::noise::{Noise, NoiseModel};
use crate::uncertainty::joint_errors::{JointErrors, VarianceEstimate, satterthwaite};
use nalgebra::DMatrix;

/// Joint covariance of the errors of the p free parameters, in the coordinates of the search, and of k
/// measured initial states.
pub(crate) struct JointMatrices {
    pub(crate) covariance: DMatrix<f64>,
    pub(crate) slopes: Vec<DMatrix<f64>>,
    pub(crate) uncertainty: DMatrix<f64>,
}

impl JointMatrices {
    /// Computes the joint covariance for a noise model. The residuals `r + J d` are minimal at `d = -G U'r`,
    /// and r changes with the error of a start.
    pub(crate) fn new(factors: &Factors, noise: &Noise, model: &NoiseModel) -> Self {
        let (p, k, g) = (factors.inverse.nrows(), noise.starts.len(), &factors.inverse);
        let embedded = |inner: &DMatrix<f64>| {
            let mut matrix = DMatrix::zeros(p + k, p + k);
            matrix.view_mut((0, 0), (p, p)).copy_from(&(g * inner * g.transpose()));
            matrix
        };
        let mut slopes: Vec<DMatrix<f64>> = model.slopes.iter().map(embedded).collect();
        for (s, start) in noise.starts.iter().enumerate() {
            let (slope, variance) = (&mut slopes[start.group], model.variances[start.group]);
            let with = -(g * &start.along) * (variance * start.scale);
            slope.view_mut((0, p + s), (p, 1)).copy_from(&with);
            slope.view_mut((p + s, 0), (1, p)).copy_from(&with.transpose());
            slope[(p + s, p + s)] = variance * start.scale * start.scale;
        }
        let n = model.variances.len();
        let covariance = slopes[..n].iter().fold(embedded(&noise.of_priors), |sum, slope| sum + slope);
        Self { covariance, slopes, uncertainty: model.uncertainty.clone() }
    }

    /// Returns the errors of all n parameters in the user's units. The errors of parameters that are not free
    /// or not determined are zero. The `per_unit` are the derivatives of the free parameters with respect to
    /// their coordinates.
    pub(crate) fn of_all(
        &self,
        n: usize,
        (free, per_unit, is_open): (&[usize], &[f64], &[bool]),
        starts: &[(usize, String)],
        outputs: Vec<(usize, f64)>,
    ) -> JointErrors {
        let (p, k) = (free.len(), starts.len());
        let place = |a: usize| if a < p { free[a] } else { n + a - p };
        let unit = |a: usize| match (a < p, is_open.get(a)) {
            (true, Some(true)) => 0.0,
            (true, _) => per_unit[a],
            (false, _) => 1.0,
        };
        let whole = |matrix: &DMatrix<f64>| {
            let mut all = vec![0.0; (n + k) * (n + k)];
            for a in 0..p + k {
                for b in 0..p + k {
                    let scale = unit(a) * unit(b);
                    all[place(a) * (n + k) + place(b)] =
                        if scale == 0.0 { 0.0 } else { matrix[(a, b)] * scale };
                }
            }
            all
        };
        JointErrors {
            starts: starts.to_vec(),
            covariance: whole(&self.covariance),
            slopes: self.slopes.iter().map(whole).collect(),
            uncertainty: self.uncertainty.as_slice().to_vec(),
            outputs,
        }
    }

    /// Returns the degrees of freedom of the variance of an error.
    pub(crate) fn degrees_of_freedom(&self, i: usize) -> f64 {
        let slopes = self.slopes.iter().map(|slope| slope[(i, i)]).collect();
        satterthwaite(&VarianceEstimate { value: self.covariance[(i, i)], slopes }, &self.uncertainty)
    }

    /// Scales the errors so that no variance is below the variance of another estimate. This is necessary if
    /// an autoregression describes a misfit. It then leaves almost no variance for a parameter whose effect
    /// changes sign from row to row.
    pub(crate) fn raise_to(&mut self, least: &Self) {
        for k in 0..self.covariance.nrows() {
            let factor = (least.covariance[(k, k)] / self.covariance[(k, k)]).sqrt();
            if factor > 1.0 {
                for matrix in self.slopes.iter_mut().chain([&mut self.covariance]) {
                    matrix.row_mut(k).scale_mut(factor);
                    matrix.column_mut(k).scale_mut(factor);
                }
            }
        }
    }
}
