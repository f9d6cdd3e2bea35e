//! Models of the residuals: linear interpolation on n + 1 points, linear regression on more.

use super::points::norm;
use super::subproblem::{Cancelled, Linear, Subproblem};
use nalgebra::linalg::LU;
use nalgebra::{DMatrix, DVector, Dyn, SVD};

/// Steps to the minimum of a quadratic model of the residuals.
const MOST_INNER: usize = 30;

/// Linear interpolation around a base point.
#[derive(Debug, Clone)]
pub(super) struct Interpolation {
    pub(super) linear: Linear,
    /// Of the rows of distances from the base point, each divided by its length.
    distances: LU<f64, Dyn, Dyn>,
    lengths: Vec<f64>,
}

impl Interpolation {
    /// Interpolates; `None` where the points lie in a plane up to rounding. `others`: displacements from the base point, and
    /// residuals, of the n other points. `cancelled` is asked now and then where there are many residuals.
    pub(super) fn new(
        base: &[f64],
        others: &[(Vec<f64>, &[f64])],
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<Option<Self>, Cancelled> {
        let n = others.len();
        let lengths: Vec<f64> = others.iter().map(|(w, _)| norm(w)).collect();
        if lengths.iter().any(|length| !(*length > 0.0 && length.is_finite())) {
            return Ok(None);
        }
        let distances = DMatrix::from_fn(n, n, |k, j| others[k].0[j] / lengths[k]).lu();
        let u = distances.u();
        if (0..n).any(|k| u[(k, k)].abs() < 1e-12) {
            return Ok(None);
        }
        // J W' = D: the differences D are turned first, so that only n of their rows are left to solve for.
        let difference = |i: usize, k: usize| (others[k].1[i] - base[i]) / lengths[k];
        let Linear { factor, reached } = Linear::new((base.len(), n), |i| base[i], difference, cancelled)?;
        let Some(factor) = distances.solve(&factor.transpose()).map(|factor| factor.transpose()) else {
            return Ok(None);
        };
        let finite = factor.iter().chain(reached.iter()).all(|v| v.is_finite());
        Ok(finite.then_some(Self { linear: Linear { factor, reached }, distances, lengths }))
    }

    /// The values of the Lagrange polynomials of the other points at a displacement from the base point.
    pub(super) fn lagrange(&self, step: &[f64]) -> Vec<f64> {
        // W' v = s with W = P^-1 L U.
        let mut v = DVector::from_column_slice(step);
        let (l, u) = (self.distances.l(), self.distances.u());
        u.tr_solve_upper_triangular_mut(&mut v);
        l.tr_solve_lower_triangular_mut(&mut v);
        self.distances.p().inv_permute_rows(&mut v);
        v.iter().zip(&self.lengths).map(|(v, length)| v / length).collect()
    }

    /// The gradient of the Lagrange polynomial of one of the other points.
    pub(super) fn gradient(&self, other: usize) -> Vec<f64> {
        let mut e = DVector::zeros(self.lengths.len());
        e[other] = 1.0 / self.lengths[other];
        if !self.distances.solve_mut(&mut e) {
            e.fill(0.0);
        }
        e.iter().copied().collect()
    }
}

/// Regression around a centre, the points weighted by their distances: linear, with squares, or quadratic, as the points allow.
pub(super) struct Regression {
    /// What multiplies 1, the coordinates, their squares, their products; turned so that as few numbers as possible are left
    /// of the residuals. One column for each.
    coefficients: DMatrix<f64>,
    /// The unit of the coordinates.
    length: f64,
    /// The variance of the residuals about the model that the terms of second degree explain, per term, in units of what
    /// they leave: near 1 for noise alone (the F statistic). `None`: too few points to tell.
    pub(super) bent: Option<f64>,
    /// Whether all products of coordinates are part of the model.
    pub(super) is_quadratic: bool,
    /// What noise in the coefficients adds to the cost at the model's minimum, as expected.
    pub(super) excess: f64,
}

/// 1, the coordinates, their squares, their products.
fn terms(w: &[f64], length: f64) -> impl Iterator<Item = f64> {
    let square = move |i: usize, j: usize| w[i] / length * (w[j] / length);
    std::iter::once(1.0)
        .chain(w.iter().map(move |w| w / length))
        .chain((0..w.len()).map(move |i| square(i, i)))
        .chain((0..w.len()).flat_map(move |i| (0..i).map(move |j| square(i, j))))
}

impl Regression {
    /// Fits the coefficients; `None` where the points do not determine those of first degree. `points`: displacements from the
    /// centre, weights, residuals.
    pub(super) fn new(points: &[(Vec<f64>, f64, &[f64])]) -> Option<Self> {
        let (w, _, first) = points.first()?;
        let (n, m, len) = (w.len(), first.len(), points.len());
        let length = points.iter().map(|(w, ..)| norm(w)).fold(0.0, f64::max);
        if len <= n || !(length > 0.0 && length.is_finite()) {
            return None;
        }
        let kinds = [1 + 2 * n + n * (n - 1) / 2, 1 + 2 * n, 1 + n];
        let n_all = kinds.into_iter().find(|terms| 2 * len >= 3 * terms).unwrap_or(1 + n);
        let mut design = DMatrix::zeros(len, n_all);
        for (k, (w, weight, _)) in points.iter().enumerate() {
            design.row_mut(k).iter_mut().zip(terms(w, length)).for_each(|(d, term)| *d = weight * term);
        }
        let mut turned = DMatrix::from_fn(len, m, |k, i| points[k].1 * points[k].2[i]);
        let qr = design.qr();
        let r = qr.r();
        qr.q_tr_mul(&mut turned);
        let smallest = 1e-6 * (0..=n).map(|k| r[(k, k)].abs()).fold(0.0, f64::max);
        let is_known = |k: usize| r[(k, k)].abs() > smallest;
        if !(0..=n).all(is_known) {
            return None;
        }
        // Terms of second degree that the points do not determine are left out.
        let n_known = if (n + 1..n_all).all(is_known) { n_all } else { n + 1 };
        let of_known = r.view((0, 0), (n_known, n_known));
        let coefficients =
            of_known.solve_upper_triangular(&turned.rows(0, n_known).into_owned())?.transpose();
        if coefficients.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let per = |from: usize, to: usize| turned.rows(from, to - from).norm_squared() / (to - from) as f64;
        let bent = (n_known > n + 1 && len > n_all).then(|| per(n + 1, n_all) / per(n_all, len));
        let coefficients = if m > n_known { coefficients.qr().r() } else { coefficients };
        // The residuals at the minimum are off by a share n / m of the noise of n_known coefficients from len points.
        let excess = if len > n_known {
            per(n_known, len) * (n.min(m) as f64 / m as f64) * (n_known as f64 / len as f64)
        } else {
            f64::INFINITY
        };
        Some(Self { coefficients, length, bent, is_quadratic: n_known == kinds[0], excess })
    }

    /// The turned residuals at a displacement.
    fn residuals(&self, w: &[f64]) -> DVector<f64> {
        let values = DVector::from_iterator(
            self.coefficients.ncols(),
            terms(w, self.length).take(self.coefficients.ncols()),
        );
        &self.coefficients * values
    }

    /// The model as seen from a displacement.
    fn linear(&self, w: &[f64]) -> Linear {
        let n = w.len();
        let mut jacobian = self.coefficients.columns(1, n).into_owned();
        let mut add = |k: usize, column: usize, factor: f64| {
            jacobian.column_mut(k).axpy(factor, &self.coefficients.column(column), 1.0);
        };
        let squares = (0..n).map(|i| (i, i)).chain((0..n).flat_map(|i| (0..i).map(move |j| (i, j))));
        for ((i, j), column) in squares.zip(n + 1..self.coefficients.ncols()) {
            add(i, column, w[j] / self.length);
            add(j, column, w[i] / self.length);
        }
        Linear::turned(self.residuals(w), jacobian / self.length)
    }

    /// How far the minimum of the cost may lie from that of the model, which is at this displacement: where noise hides the rise of
    /// the cost along the direction of least curvature.
    pub(super) fn uncertainty(&self, w: &[f64]) -> f64 {
        let factor = self.linear(w).factor;
        let svd = SVD::try_new(factor, false, false, f64::EPSILON, 1000);
        let smallest = svd.map_or(0.0, |svd| svd.singular_values.min());
        if smallest > 0.0 { self.excess.sqrt() / smallest } else { f64::INFINITY }
    }

    /// The displacement within a ball and a box at which the model is smallest, and the decrease from the centre.
    pub(super) fn minimise(&self, radius: f64, lower: &[f64], upper: &[f64]) -> (Vec<f64>, f64) {
        let n = lower.len();
        let first = self.residuals(&vec![0.0; n]).norm_squared();
        let (mut best, mut cost, mut reach) = (vec![0.0; n], first, radius);
        for _ in 0..MOST_INNER {
            let ends = |ends: &[f64]| ends.iter().zip(&best).map(|(end, w)| end - w).collect::<Vec<f64>>();
            let (lower, upper) = (ends(lower), ends(upper));
            let linear = self.linear(&best);
            let (step, _) =
                Subproblem { linear: &linear, radius: reach, lower: &lower, upper: &upper }.solve();
            let mut next: Vec<f64> = best.iter().zip(&step).map(|(w, s)| w + s).collect();
            let length = norm(&next);
            if length > radius {
                next.iter_mut().for_each(|w| *w *= radius / length);
            }
            let new = self.residuals(&next).norm_squared();
            if new < cost {
                let little = cost - new <= 1e-3 * (first - new);
                (best, cost) = (next, new);
                reach = (2.0 * reach).min(radius);
                if little {
                    break;
                }
            } else {
                reach = 0.25 * norm(&step);
            }
        }
        (best, first - cost)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn residuals(z: &[f64]) -> Vec<f64> {
        vec![1.0 + 2.0 * z[0] - z[1], 3.0 * z[1], 0.5]
    }

    /// The sum of squares by the model, but for its constant.
    fn cost(linear: &Linear, z: &[f64]) -> f64 {
        (&linear.reached + &linear.factor * DVector::from_column_slice(z)).norm_squared()
    }

    #[test]
    fn a_linear_function_is_its_own_model() {
        let points = [vec![0.1, 0.3], vec![-0.2, 0.1], vec![0.3, -0.2], vec![0.0, 0.0]];
        let values: Vec<Vec<f64>> = points.iter().map(|z| residuals(z)).collect();
        let base = residuals(&[0.0, 0.0]);
        let others: Vec<(Vec<f64>, &[f64])> =
            points.iter().cloned().zip(values.iter().map(Vec::as_slice)).take(2).collect();
        let model = Interpolation::new(&base, &others, &mut || false).unwrap().unwrap();
        let all: Vec<(Vec<f64>, f64, &[f64])> =
            points.iter().zip(&values).map(|(z, v)| (z.clone(), 0.7, v.as_slice())).collect();
        let regression = Regression::new(&all).unwrap();
        let square = |z: &[f64]| residuals(z).iter().map(|r| r * r).sum::<f64>();
        for linear in [&model.linear, &regression.linear(&[0.0, 0.0])] {
            let constant = square(&[0.0, 0.0]) - cost(linear, &[0.0, 0.0]);
            assert!((square(&[0.7, -2.0]) - cost(linear, &[0.7, -2.0]) - constant).abs() < 1e-12);
        }
        for (k, z) in points[..2].iter().enumerate() {
            let values = model.lagrange(z);
            assert!((values[k] - 1.0).abs() < 1e-13 && values[1 - k].abs() < 1e-13, "{values:?}");
            let gradient = model.gradient(k);
            let at = |z: &[f64]| gradient[0] * z[0] + gradient[1] * z[1];
            assert!((at(z) - 1.0).abs() < 1e-13 && at(&points[1 - k]).abs() < 1e-13);
        }
    }
}
