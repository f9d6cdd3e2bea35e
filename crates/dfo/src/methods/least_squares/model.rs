//! Regression models of the residuals on many points.

use super::points::norm;
use super::subproblem::{Linear, Room, Subproblem, smallest_singular_value};
use nalgebra::{DMatrix, DVector};

/// Maximum number of steps to the minimum of a quadratic model of the residuals.
const MOST_INNER: usize = 30;

/// Regression around a centre, with points weighted by their distances. Depending on the points, the model is
/// linear, has additional squares, or is quadratic.
pub(super) struct Regression {
    /// Coefficients of 1, the coordinates, their squares and their products. They are rotated to the smallest
    /// possible number of residuals. One column per term.
    coefficients: DMatrix<f64>,
    /// Unit of the coordinates.
    length: f64,
    /// Variance of the residuals explained by the second-degree terms, per term, relative to the remaining
    /// variance. Near 1 for pure noise (the F statistic). `None` if there are too few points.
    pub(super) bent: Option<f64>,
    /// True if the model contains all products of coordinates.
    pub(super) is_quadratic: bool,
    /// Expected increase of the cost at the minimum of the model due to noise in the coefficients.
    pub(super) excess: f64,
}

/// Returns 1, the coordinates, their squares and their products.
fn terms(w: &[f64], length: f64) -> impl Iterator<Item = f64> {
    let square = move |i: usize, j: usize| w[i] / length * (w[j] / length);
    std::iter::once(1.0)
        .chain(w.iter().map(move |w| w / length))
        .chain((0..w.len()).map(move |i| square(i, i)))
        .chain((0..w.len()).flat_map(move |i| (0..i).map(move |j| square(i, j))))
}

impl Regression {
    /// Fits the coefficients. Returns `None` if the points do not determine the first-degree coefficients.
    /// `points` contains displacements from the centre, weights and residuals.
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
        let is_determined = |k: usize| r[(k, k)].abs() > smallest;
        if !(0..=n).all(is_determined) {
            return None;
        }
        // Drop the second-degree terms if the points do not determine them.
        let n_determined = if (n + 1..n_all).all(is_determined) { n_all } else { n + 1 };
        let determined = r.view((0, 0), (n_determined, n_determined));
        let coefficients =
            determined.solve_upper_triangular(&turned.rows(0, n_determined).into_owned())?.transpose();
        if coefficients.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let per = |from: usize, to: usize| turned.rows(from, to - from).norm_squared() / (to - from) as f64;
        let bent = (n_determined > n + 1 && len > n_all).then(|| per(n + 1, n_all) / per(n_all, len));
        let coefficients = if m > n_determined { coefficients.qr().r() } else { coefficients };
        // At the minimum, a fraction n / m of the noise of n_known coefficients from len points affects the
        // cost.
        let excess = if len > n_determined {
            per(n_determined, len) * (n.min(m) as f64 / m as f64) * (n_determined as f64 / len as f64)
        } else {
            f64::INFINITY
        };
        Some(Self { coefficients, length, bent, is_quadratic: n_determined == kinds[0], excess })
    }

    /// Returns the rotated residuals at a displacement.
    fn residuals(&self, w: &[f64]) -> DVector<f64> {
        let values = DVector::from_iterator(
            self.coefficients.ncols(),
            terms(w, self.length).take(self.coefficients.ncols()),
        );
        &self.coefficients * values
    }

    /// Returns the model linearised at a displacement.
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

    /// Returns a bound on the distance between the minimum of the cost and the minimum of the model, which is
    /// at `w`. Within this distance, noise hides the increase of the cost along the direction of least
    /// curvature.
    pub(super) fn uncertainty(&self, w: &[f64]) -> f64 {
        let smallest = smallest_singular_value(&self.linear(w).factor);
        if smallest > 0.0 { self.excess.sqrt() / smallest } else { f64::INFINITY }
    }

    /// Returns the displacement within a ball and a room that minimises the model, and the decrease from the
    /// centre.
    pub(super) fn minimise(&self, radius: f64, room: &Room) -> (Vec<f64>, f64) {
        let n = room.lower.len();
        let first = self.residuals(&vec![0.0; n]).norm_squared();
        let (mut best, mut cost, mut reach) = (vec![0.0; n], first, radius);
        for _ in 0..MOST_INNER {
            let linear = self.linear(&best);
            let room = room.after(&best);
            let (step, _) = Subproblem { linear: &linear, radius: reach, room: &room }.solve();
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

    #[test]
    fn regression_reproduces_a_linear_function() {
        let points = [vec![0.1, 0.3], vec![-0.2, 0.1], vec![0.3, -0.2], vec![0.0, 0.0]];
        let values: Vec<Vec<f64>> = points.iter().map(|z| residuals(z)).collect();
        let all: Vec<(Vec<f64>, f64, &[f64])> =
            points.iter().zip(&values).map(|(z, v)| (z.clone(), 0.7, v.as_slice())).collect();
        let Linear { factor, reached } = Regression::new(&all).unwrap().linear(&[0.0, 0.0]);
        let square = |z: &[f64]| residuals(z).iter().map(|r| r * r).sum::<f64>();
        let cost = |z: &[f64]| (&reached + &factor * DVector::from_column_slice(z)).norm_squared();
        let constant = square(&[0.0, 0.0]) - cost(&[0.0, 0.0]);
        assert!((square(&[0.7, -2.0]) - cost(&[0.7, -2.0]) - constant).abs() < 1e-12);
    }
}
