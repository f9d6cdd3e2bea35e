//! Linear interpolation of residual vectors on n + 1 points.

use nalgebra::linalg::LU;
use nalgebra::{DMatrix, DVector, Dyn};

/// The model around a base point: residuals there, their Jacobian, and what each other point contributes.
pub(super) struct Model {
    pub(super) jacobian: DMatrix<f64>,
    /// Of the rows of distances from the base point, each divided by its length.
    distances: LU<f64, Dyn, Dyn>,
    lengths: Vec<f64>,
}

impl Model {
    /// Interpolates; `None` where the points lie in a plane up to rounding. `others`: displacements from the base point, and
    /// residuals, of the n other points.
    pub(super) fn interpolate<'a>(
        n: usize,
        base: &[f64],
        others: impl Iterator<Item = (Vec<f64>, &'a [f64])> + Clone,
    ) -> Option<Self> {
        let lengths: Vec<f64> =
            others.clone().map(|(w, _)| w.iter().map(|w| w * w).sum::<f64>().sqrt()).collect();
        if lengths.iter().any(|length| !(*length > 0.0 && length.is_finite())) {
            return None;
        }
        let mut w = DMatrix::zeros(n, n);
        let mut d = DMatrix::zeros(n, base.len());
        for (k, (displacement, residuals)) in others.enumerate() {
            for j in 0..n {
                w[(k, j)] = displacement[j] / lengths[k];
            }
            for (i, (r, r_0)) in residuals.iter().zip(base).enumerate() {
                d[(k, i)] = (r - r_0) / lengths[k];
            }
        }
        let distances = w.lu();
        let u = distances.u();
        if (0..n).any(|k| u[(k, k)].abs() < 1e-12) {
            return None;
        }
        let jacobian = distances.solve(&d)?.transpose();
        jacobian.iter().all(|j| j.is_finite()).then_some(Self { jacobian, distances, lengths })
    }

    /// The values of the Lagrange polynomials of the other points at a displacement from the base point.
    pub(super) fn lagrange(&self, step: &[f64]) -> Vec<f64> {
        let n = step.len();
        // W' v = s with W = P^-1 L U.
        let mut v = DVector::from_column_slice(step);
        let (l, u) = (self.distances.l(), self.distances.u());
        u.tr_solve_upper_triangular_mut(&mut v);
        l.tr_solve_lower_triangular_mut(&mut v);
        self.distances.p().inv_permute_rows(&mut v);
        (0..n).map(|k| v[k] / self.lengths[k]).collect()
    }

    /// The gradient of the Lagrange polynomial of one of the other points.
    pub(super) fn gradient(&self, other: usize) -> Vec<f64> {
        let n = self.lengths.len();
        let mut e = DVector::zeros(n);
        e[other] = 1.0 / self.lengths[other];
        match self.distances.solve(&e) {
            Some(gradient) => gradient.iter().copied().collect(),
            None => vec![0.0; n],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_function_is_its_own_model() {
        let r = |z: &[f64]| vec![1.0 + 2.0 * z[0] - z[1], 3.0 * z[1], 0.5];
        let points = [vec![0.1, 0.3], vec![-0.2, 0.1]];
        let values: Vec<Vec<f64>> = points.iter().map(|z| r(z)).collect();
        let base = r(&[0.0, 0.0]);
        let others = points.iter().cloned().zip(values.iter().map(Vec::as_slice));
        let model = Model::interpolate(2, &base, others).unwrap();
        let expected = DMatrix::from_row_slice(3, 2, &[2.0, -1.0, 0.0, 3.0, 0.0, 0.0]);
        assert!((&model.jacobian - expected).norm() < 1e-13);
        for (k, z) in points.iter().enumerate() {
            let values = model.lagrange(z);
            assert!((values[k] - 1.0).abs() < 1e-13 && values[1 - k].abs() < 1e-13, "{values:?}");
            let gradient = model.gradient(k);
            let at = |z: &[f64]| gradient[0] * z[0] + gradient[1] * z[1];
            assert!((at(z) - 1.0).abs() < 1e-13 && at(&points[1 - k]).abs() < 1e-13);
        }
    }
}
