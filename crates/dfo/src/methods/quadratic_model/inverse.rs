//! Inverse of the matrix of the interpolation conditions, for models of many parameters. An exchange of
//! points updates the inverse with O((m + n)^2) operations. Solving the conditions takes O(m^3).

use super::model::{GRADIENT_WEIGHT, SHIFTS};
use crate::methods::shared::dot::dot;
use nalgebra::{Cholesky, DMatrix};
use serde::{Deserialize, Serialize};

/// Inverse of the interpolation matrix. The matrix `W` has the rows `[-D, X; X', A]` with `X_j = (1, y_j)`,
/// `A_ij = (y_i'y_j)^2 / 2` for displacements `y_j` of the points from an origin. Its inverse `H` contains
/// the Lagrange polynomials of the points. Column `j` contains the value and the gradient at the origin. The
/// weights of the `y_k y_k'` in the Hessian follow (Powell, Math. Program. 100, 2004, section 2). With `D =
/// 0`, the models change by the least Frobenius norm. The small `D` of [`super::model::Interpolation`] makes
/// `W` regular for any number of points.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Inverse {
    n: usize,
    /// Slot of each point.
    pub(super) slots: Vec<usize>,
    /// Displacements in units of `scale`, one row per point.
    y: Vec<f64>,
    pub(super) scale: f64,
    /// Row-major. The points follow the 1 + n coefficients.
    h: Vec<f64>,
    /// Weights of the `y_k y_k'` in the Hessian of the model. The model itself stores the remaining part.
    weights: Vec<f64>,
    n_exchanged: usize,
}

/// Fraction of exchanged points after which the accuracy is checked. The cost of a rebuild is then small.
const LOOKED_AFTER: f64 = 0.25;

/// A displacement from a point of the interpolation, with the data for an exchange.
pub(super) struct Step {
    /// Coefficients and values of the Lagrange polynomials at the end of the step: `H w`.
    hw: Vec<f64>,
    beta: f64,
    end: Vec<f64>,
}

/// Returns the upper median, or 0 if there are no values.
pub(super) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

fn add(to: &mut [f64], weight: f64, v: &[f64]) {
    to.iter_mut().zip(v).for_each(|(a, v)| *a += weight * v);
}

impl Inverse {
    /// Builds the inverse from the concatenated displacements of the slots from the origin. Returns `None` if
    /// numbers overflow.
    pub(super) fn new(slots: Vec<usize>, displacements: &[f64], n: usize) -> Option<Self> {
        let m = slots.len();
        let scale = median(displacements.chunks_exact(n).map(|y| dot(y, y).sqrt()));
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let y: Vec<f64> = displacements.iter().map(|y| y / scale).collect();
        let rows = DMatrix::from_row_slice(m, n, &y);
        let mut k = &rows * rows.transpose();
        k.apply(|v| *v = *v * (0.5 * *v + GRADIENT_WEIGHT) + GRADIENT_WEIGHT);
        let d: Vec<f64> = (0..m).map(|j| k[(j, j)].sqrt().recip()).collect();
        let normalise = |k: &mut DMatrix<f64>| {
            (0..m).for_each(|j| (0..m).for_each(|i| k[(i, j)] *= d[i] * d[j]));
        };
        normalise(&mut k);
        let mut omega = SHIFTS.into_iter().find_map(|shift| {
            let mut shifted = k.clone();
            (0..m).for_each(|j| shifted[(j, j)] += shift);
            Cholesky::new(shifted).map(|c| c.inverse())
        })?;
        normalise(&mut omega);
        // The other parts of H from the rows of W H = 1, with -D = -1 / GRADIENT_WEIGHT.
        let x = rows.insert_column(0, 1.0) * GRADIENT_WEIGHT;
        let xi = x.tr_mul(&omega);
        let upsilon = &xi * x - DMatrix::from_diagonal_element(n + 1, n + 1, GRADIENT_WEIGHT);
        let p = n + 1;
        let of = |i: usize, j: usize| match (i < p, j < p) {
            (true, true) => upsilon[(i, j)],
            (true, false) => xi[(i, j - p)],
            (false, true) => xi[(j, i - p)],
            (false, false) => omega[(i - p, j - p)],
        };
        let size = p + m;
        let h: Vec<f64> = (0..size * size).map(|k| of(k / size, k % size)).collect();
        let weights = vec![0.0; m];
        let whole = Self { n, slots, y, scale, h, weights, n_exchanged: 0 };
        whole.h.iter().all(|v| v.is_finite()).then_some(whole)
    }

    pub(super) fn is_sound(&self, n: usize, len: usize) -> bool {
        let (m, size) = (self.slots.len(), self.slots.len() + n + 1);
        self.n == n
            && self.slots.iter().all(|slot| *slot < len)
            && (self.y.len(), self.h.len(), self.weights.len()) == (m * n, size * size, m)
            && self.scale > 0.0
            && self.scale.is_finite()
    }

    fn row(&self, k: usize) -> &[f64] {
        let size = self.n + 1 + self.slots.len();
        &self.h[k * size..(k + 1) * size]
    }

    /// Returns the coefficients and weights of the Lagrange polynomial of point `k`.
    fn polynomial(&self, k: usize) -> (&[f64], &[f64]) {
        self.row(self.n + 1 + k).split_at(self.n + 1)
    }

    fn points(&self) -> impl Iterator<Item = &[f64]> {
        self.y.chunks_exact(self.n)
    }

    /// Returns the index of a slot.
    pub(super) fn place_of(&self, slot: usize) -> Option<usize> {
        self.slots.iter().position(|s| *s == slot)
    }

    /// Returns the displacement of a point from the origin, in units of the scale.
    pub(super) fn point(&self, place: usize) -> &[f64] {
        &self.y[place * self.n..(place + 1) * self.n]
    }

    /// Returns the distance of a point from the origin.
    pub(super) fn distance(&self, place: usize) -> f64 {
        dot(self.point(place), self.point(place)).sqrt() * self.scale
    }

    /// Returns a displacement from the point `from`. The computation uses the difference of `w` from its
    /// value at this point, where `H w` is a unit vector by definition (Powell, report DAMTP 2004/NA08,
    /// section 4).
    pub(super) fn step(&self, from: usize, displacement: &[f64]) -> Step {
        let base = self.point(from);
        let d: Vec<f64> = displacement.iter().map(|d| d / self.scale).collect();
        let mut w = vec![0.0];
        w.extend(&d);
        w.extend(self.points().map(|y| {
            let along = dot(&d, y);
            along * (0.5 * along + dot(base, y))
        }));
        let mut hw: Vec<f64> = (0..w.len()).map(|k| dot(self.row(k), &w)).collect();
        let (p, q, e) = (dot(base, &d), dot(base, base), dot(&d, &d));
        let beta = p * p + e * (q + 2.0 * p + 0.5 * e) - dot(&w, &hw);
        hw[self.n + 1 + from] += 1.0;
        let end = base.iter().zip(&d).map(|(base, d)| base + d).collect();
        Step { hw, beta, end }
    }

    /// Returns the factors by which the determinant of `W` grows if each point is replaced by the end of a
    /// step: Powell 2004, equation 2.12.
    pub(super) fn factors(&self, step: &Step) -> Vec<f64> {
        let of = |(k, tau): (usize, &f64)| self.row(self.n + 1 + k)[self.n + 1 + k] * step.beta + tau * tau;
        step.hw[self.n + 1..].iter().enumerate().map(of).collect()
    }

    /// True if the accuracy must be checked.
    pub(super) fn is_due(&self) -> bool {
        self.n_exchanged > 0 && self.n_exchanged.is_multiple_of(self.interval())
    }

    fn interval(&self) -> usize {
        ((LOOKED_AFTER * self.slots.len() as f64) as usize).max(1)
    }

    /// True if the values of the Lagrange polynomials at a point are still 0 and 1.
    pub(super) fn is_accurate(&self, from: usize, tolerance: f64) -> bool {
        let at = self.n_exchanged / self.interval() % self.slots.len().max(1);
        let d = self.point(from).iter().zip(self.point(at)).map(|(base, y)| (y - base) * self.scale);
        let d: Vec<f64> = d.collect();
        let values = &self.step(from, &d).hw[self.n + 1..];
        values.iter().enumerate().all(|(k, v)| (v - f64::from(k == at)).abs() < tolerance)
    }

    /// Replaces a point by the end of a step: Powell 2004, equation 2.11. Returns false if the numbers are
    /// too inaccurate: in exact arithmetic, the denominator is at least `tau^2`. The contribution of the
    /// replaced point is added to the Hessian of the model.
    pub(super) fn exchange(&mut self, place: usize, step: &Step, hessian: &mut [f64]) -> bool {
        let t = self.n + 1 + place;
        let column = self.row(t).to_vec();
        let (alpha, tau, beta) = (column[t], step.hw[t], step.beta);
        let sigma = alpha * beta + tau * tau;
        if !(sigma > 0.5 * tau * tau && sigma.is_normal()) {
            return false;
        }
        let mut v: Vec<f64> = step.hw.iter().map(|v| -v).collect();
        v[t] += 1.0;
        for (k, row) in self.h.chunks_exact_mut(v.len()).enumerate() {
            let of_v = (alpha * v[k] + tau * column[k]) / sigma;
            let of_column = (tau * v[k] - beta * column[k]) / sigma;
            row.iter_mut().zip(v.iter().zip(&column)).for_each(|(h, (v, c))| *h += of_v * v + of_column * c);
        }
        self.fold(place, hessian);
        self.y[place * self.n..(place + 1) * self.n].copy_from_slice(&step.end);
        self.n_exchanged += 1;
        true
    }

    /// Moves the weight of a point to the Hessian.
    fn fold(&mut self, place: usize, hessian: &mut [f64]) {
        let weight = std::mem::take(&mut self.weights[place]);
        let y = &self.y[place * self.n..(place + 1) * self.n];
        for (row, a) in hessian.chunks_exact_mut(self.n).zip(y).filter(|_| weight != 0.0) {
            add(row, weight * a, y);
        }
    }

    /// Moves all weights to the Hessian.
    pub(super) fn fold_all(&mut self, hessian: &mut [f64]) {
        (0..self.slots.len()).for_each(|place| self.fold(place, hessian));
    }

    /// Adds the product of a vector with the part of the Hessian represented by the weights.
    pub(super) fn add_product(&self, v: &[f64], product: &mut [f64]) {
        for (y, weight) in self.points().zip(&self.weights).filter(|(_, weight)| **weight != 0.0) {
            add(product, weight * dot(y, v), y);
        }
    }

    /// Adds the quadratic with these values at the points to a model whose gradient is at `base`.
    pub(super) fn add(&mut self, values: &[f64], base: &[f64], gradient: &mut [f64]) {
        let (slope, weights) = self.least_norm(values, base);
        add(gradient, 1.0, &slope);
        add(&mut self.weights, 1.0, &weights);
    }

    /// Returns the quadratic of least norm with these values at the points. The result contains its gradient
    /// at `base` and the weights in its Hessian.
    pub(super) fn least_norm(&self, values: &[f64], base: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut coefficients = vec![0.0; self.n + 1 + self.slots.len()];
        for (k, value) in values.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            add(&mut coefficients, *value, self.row(self.n + 1 + k));
        }
        let mut slope = self.slope(&coefficients[..self.n + 1], &coefficients[self.n + 1..], base);
        slope.iter_mut().for_each(|g| *g /= self.scale);
        let weights = coefficients[self.n + 1..].iter().map(|w| w / (self.scale * self.scale));
        (slope, weights.collect())
    }

    pub(super) fn set_weights(&mut self, weights: Vec<f64>) {
        self.weights = weights;
    }

    /// Returns the gradient of a polynomial at `base`, in units of the scale.
    fn slope(&self, at_origin: &[f64], weights: &[f64], base: &[f64]) -> Vec<f64> {
        let mut slope = at_origin[1..].to_vec();
        self.points().zip(weights).for_each(|(y, weight)| add(&mut slope, weight * dot(base, y), y));
        slope
    }

    /// Returns a displacement from the point `from` at which the Lagrange polynomial of a point is large. The
    /// displacement has at most the given length, is within the bounds, and is moved into other constraints
    /// by `inside`. It is along the gradient of the
    /// polynomial, or towards another point (BOBYQA's ALTMOV: Powell, report DAMTP 2009/NA06, section 3).
    pub(super) fn far_from_zero(
        &self,
        place: usize,
        from: usize,
        length: f64,
        lower: &[f64],
        upper: &[f64],
        inside: impl Fn(Vec<f64>) -> Vec<f64>,
    ) -> Vec<f64> {
        let polynomial = self.polynomial(place);
        let base = self.point(from);
        let slope = self.slope(polynomial.0, polynomial.1, base);
        let value = |s: &[f64]| {
            let of_weights = self.points().zip(polynomial.1).map(|(y, weight)| weight * dot(y, s).powi(2));
            (dot(&slope, s) / self.scale + 0.5 * of_weights.sum::<f64>() / self.scale.powi(2)).abs()
        };
        let along = |direction: &[f64], length: f64| -> Vec<f64> {
            let share = length / dot(direction, direction).sqrt();
            (0..self.n).map(|k| (share * direction[k]).clamp(lower[k], upper[k])).collect()
        };
        let towards: Vec<f64> = self.point(place).iter().zip(base).map(|(y, base)| y - base).collect();
        let steps =
            [&slope, &towards].into_iter().flat_map(|v| [along(v, length), along(v, -length)]).map(inside);
        let valued = steps.map(|s| (value(&s), s)).filter(|(value, _)| value.is_finite());
        let best = valued.reduce(|best, other| if other.0 > best.0 { other } else { best });
        best.map_or_else(|| vec![0.0; self.n], |(_, s)| s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns pseudo-random numbers from -0.5 to 0.5 (Knuth's MMIX constants).
    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    /// After twice as many exchanges as points, the polynomials still belong to the points. A model updated
    /// with the values of a quadratic interpolates this quadratic.
    #[test]
    fn exchanges_keep_the_lagrange_polynomials() {
        let (n, m, mut state) = (6, 13, 11);
        let mut points: Vec<Vec<f64>> =
            (0..m).map(|_| (0..n).map(|_| random(&mut state)).collect()).collect();
        let mut inverse = Inverse::new((0..m).collect(), &points.concat(), n).unwrap();
        let displacement =
            |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| b - a).collect() };
        let mut hessian = vec![0.0; n * n];
        for exchange in 0..2 * m {
            let (place, from) = (exchange % m, (exchange + 3) % m);
            let end: Vec<f64> = (0..n).map(|_| random(&mut state)).collect();
            let step = inverse.step(from, &displacement(&points[from], &end));
            // The determinant grows at least by the square of the value of the polynomial at the new point.
            assert!(inverse.factors(&step)[place] >= step.hw[n + 1 + place].powi(2) * (1.0 - 1e-9));
            assert!(inverse.exchange(place, &step, &mut hessian));
            points[place] = end;
            for (k, point) in points.iter().enumerate() {
                let values = inverse.step(0, &displacement(&points[0], point)).hw;
                for (j, value) in values[n + 1..].iter().enumerate() {
                    assert!((value - f64::from(j == k)).abs() < 1e-7, "{exchange}: {j} {k} {value}");
                }
            }
        }
        let cost = |x: &[f64]| x.iter().enumerate().map(|(k, x)| (k as f64 - 2.0) * x * x + x).sum::<f64>();
        let values: Vec<f64> = points.iter().map(|x| cost(x) - cost(&points[0])).collect();
        let mut gradient = vec![0.0; n];
        let base = inverse.point(0).to_vec();
        inverse.add(&values, &base, &mut gradient);
        inverse.fold_all(&mut hessian);
        for (point, value) in points.iter().zip(values) {
            let s = displacement(&points[0], point);
            let bent: f64 = (0..n).map(|k| s[k] * dot(&hessian[k * n..(k + 1) * n], &s)).sum();
            assert!((dot(&gradient, &s) + 0.5 * bent - value).abs() < 1e-7, "{value}");
        }
    }
}
