//! Quadratic interpolation with fewer points than coefficients. Among all models through the points, the
//! result is the closest to the previous model.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Weight of a change of the gradient relative to a change of the Hessian, see [`Interpolation`].
pub(super) const GRADIENT_WEIGHT: f64 = 1e3;
/// Relative shifts of the diagonal that are tried if the set of points is nearly degenerate.
pub(super) const SHIFTS: [f64; 5] = [0.0, 1e-14, 1e-12, 1e-10, 1e-8];

/// `g's + s'Bs/2`, the change of the cost at the displacement `s` relative to the base point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Quadratic {
    pub(super) gradient: Vec<f64>,
    /// Symmetric, row-major.
    pub(super) hessian: Vec<f64>,
}

impl Quadratic {
    pub(super) fn zero(n: usize) -> Self {
        Self { gradient: vec![0.0; n], hessian: vec![0.0; n * n] }
    }

    pub(super) fn is_sound(&self, n: usize) -> bool {
        self.gradient.len() == n && self.hessian.len() == n * n
    }

    fn is_finite(&self) -> bool {
        self.gradient.iter().chain(&self.hessian).all(|v| v.is_finite())
    }

    pub(super) fn value(&self, s: &[f64]) -> f64 {
        let rows = self.hessian.chunks_exact(s.len().max(1));
        let terms = rows.zip(s).zip(&self.gradient).map(|((row, s_k), g)| s_k * (g + 0.5 * dot(row, s)));
        terms.sum()
    }

    /// Returns the gradient at a displacement.
    pub(super) fn slope(&self, s: &[f64]) -> Vec<f64> {
        let rows = self.hessian.chunks_exact(s.len().max(1));
        rows.zip(&self.gradient).map(|(row, g)| g + dot(row, s)).collect()
    }

    /// Adds the quadratic with the coefficients `lambda` of an interpolation.
    fn add(&mut self, points: &Interpolation, lambda: &DVector<f64>) {
        let n = self.gradient.len();
        let r = points.scale;
        for (j, l) in lambda.iter().enumerate() {
            for a in 0..n {
                let term = l * points.y[(j, a)] / r;
                self.gradient[a] += GRADIENT_WEIGHT * term;
                for b in 0..n {
                    self.hessian[a * n + b] += term * points.y[(j, b)] / r;
                }
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Interpolation conditions of a model: displacements `y_j` from the base point. The base point is also
/// interpolated.
///
/// The interpolation chooses the smallest change `D = g's + s'Bs/2` with given values at the `y_j`. This
/// change minimises `|B|_F^2 / 4 + |g|^2 / (2 w)`, with lengths in units of the farthest `y_j`. As `w`
/// approaches infinity, the result approaches the least Frobenius norm update of Powell (Math. Program. 100,
/// 2004, section 3). The term with `g` (Zhang, Math. Program. 146, 2014: Sobolev seminorms) makes the change
/// unique for any number of points. The solution is `g = w sum l_j y_j`, `B = sum l_j y_j y_j'` with `K l =
/// values`, `K_ij = (y_i'y_j)^2 / 2 + w y_i'y_j`. The matrix `K` is positive definite if no two points
/// coincide.
#[derive(Debug, Clone)]
pub(super) struct Interpolation {
    /// Slots of the points, and their displacements in units of `scale`, one row per point.
    pub(super) slots: Vec<usize>,
    y: DMatrix<f64>,
    scale: f64,
    inverse: DMatrix<f64>,
}

impl Interpolation {
    /// Creates the conditions for the base point and these slots, with concatenated displacements. Returns
    /// `None` if numbers overflow.
    pub(super) fn new(n: usize, slots: Vec<usize>, displacements: &[f64]) -> Option<Self> {
        let m = slots.len();
        let lengths = displacements.chunks_exact(n.max(1)).map(|y| dot(y, y));
        let scale = lengths.fold(0.0, f64::max).sqrt();
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let y = DMatrix::from_row_slice(m, n, displacements) / scale;
        let mut k = &y * y.transpose();
        k.apply(|v| *v = kernel(*v));
        let d: Vec<f64> = (0..m).map(|j| k[(j, j)].sqrt().recip()).collect();
        for (i, d_i) in d.iter().enumerate() {
            for (j, d_j) in d.iter().enumerate() {
                k[(i, j)] *= d_i * d_j;
            }
        }
        let mut inverse = SHIFTS.into_iter().find_map(|shift| {
            let mut shifted = k.clone();
            (0..m).for_each(|j| shifted[(j, j)] += shift);
            Cholesky::new(shifted).map(|c| c.inverse())
        })?;
        for (i, d_i) in d.iter().enumerate() {
            for (j, d_j) in d.iter().enumerate() {
                inverse[(i, j)] *= d_i * d_j;
            }
        }
        inverse.iter().all(|v| v.is_finite()).then_some(Self { slots, y, scale, inverse })
    }

    /// Applies the smallest change that gives a model these values at the points. Returns true if the result
    /// is finite.
    pub(super) fn update(&self, model: &mut Quadratic, values: &[f64]) -> bool {
        let n = self.y.ncols();
        let mut s = vec![0.0; n];
        for _ in 0..2 {
            let rest = DVector::from_iterator(
                values.len(),
                values.iter().enumerate().map(|(j, value)| {
                    (0..n).for_each(|k| s[k] = self.y[(j, k)] * self.scale);
                    value - model.value(&s)
                }),
            );
            model.add(self, &(&self.inverse * rest));
        }
        model.is_finite()
    }

    fn products(&self, step: &[f64]) -> (DVector<f64>, f64) {
        let s = DVector::from_column_slice(step) / self.scale;
        let mut k = &self.y * &s;
        k.apply(|v| *v = kernel(*v));
        (k, kernel(s.norm_squared()))
    }

    /// Returns the values of the Lagrange polynomials of the slots at a displacement, with the base point
    /// last. Also returns the growth factor of the determinant of the interpolation equations if the point is
    /// replaced by this one (Powell 2004, equation 2.12).
    pub(super) fn lagrange(&self, step: &[f64]) -> impl Iterator<Item = (f64, f64)> {
        let (k, square) = self.products(step);
        let values = &self.inverse * &k;
        let beta = (square - k.dot(&values)).max(0.0);
        let of_base = (1.0 - values.sum(), self.inverse.sum());
        let of_slots = (0..values.len()).map(move |j| (values[j], self.inverse[(j, j)])).collect::<Vec<_>>();
        of_slots.into_iter().chain([of_base]).map(move |(value, alpha)| (value, alpha * beta + value * value))
    }
}

fn kernel(product: f64) -> f64 {
    product * (0.5 * product + GRADIENT_WEIGHT)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(s: &[f64]) -> f64 {
        3.0 * s[0] - s[1] + 2.0 * s[0] * s[0] + 0.5 * s[0] * s[1] + s[1] * s[1]
    }

    const POINTS: [f64; 10] = [0.1, 0.0, 0.0, 0.1, -0.1, 0.0, 0.0, -0.1, 0.07, 0.08];

    #[test]
    fn update_reproduces_a_quadratic_when_points_determine_all_coefficients() {
        let points = Interpolation::new(2, (1..6).collect(), &POINTS).unwrap();
        let values: Vec<f64> = POINTS.chunks_exact(2).map(cost).collect();
        let mut model = Quadratic::zero(2);
        assert!(points.update(&mut model, &values));
        for (a, b) in model.gradient.iter().zip([3.0, -1.0]) {
            assert!((a - b).abs() < 1e-9, "{model:?}");
        }
        for (a, b) in model.hessian.iter().zip([4.0, 0.5, 0.5, 2.0]) {
            assert!((a - b).abs() < 1e-7, "{model:?}");
        }
        assert!((model.slope(&[1.0, 2.0])[0] - 8.0).abs() < 1e-7);
        // A second update changes nothing.
        let before = model.clone();
        assert!(points.update(&mut model, &values));
        assert!(model.hessian.iter().zip(&before.hessian).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn lagrange_polynomials_are_one_at_their_points() {
        let points = Interpolation::new(2, (1..5).collect(), &POINTS[..8]).unwrap();
        for (j, y) in POINTS[..8].chunks_exact(2).chain([&[0.0, 0.0][..]]).enumerate() {
            for (k, (value, factor)) in points.lagrange(y).enumerate() {
                let expected = if k == j { 1.0 } else { 0.0 };
                assert!(
                    (value - expected).abs() < 1e-9 && (factor - expected).abs() < 1e-6,
                    "{j} {k}: {value} {factor}"
                );
            }
        }
    }

    #[test]
    fn interpolation_handles_coincident_and_non_finite_points() {
        let twice = Interpolation::new(1, vec![1, 2], &[0.5, 0.5]).unwrap();
        let mut model = Quadratic::zero(1);
        assert!(twice.update(&mut model, &[1.0, 1.0]) && (model.value(&[0.5]) - 1.0).abs() < 0.1);
        for bad in [[0.0, 0.0], [f64::NAN, 1.0], [f64::INFINITY, 1.0]] {
            assert!(Interpolation::new(1, vec![1, 2], &bad).is_none(), "{bad:?}");
        }
        assert!(!twice.update(&mut model, &[f64::INFINITY, 0.0]));
    }
}
