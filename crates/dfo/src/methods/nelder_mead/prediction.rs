//! Costs ahead of the path, predicted from known costs. The prediction is an interpolation by cubic radial
//! basis functions with a linear tail (Powell, in Advances in Numerical Analysis II, Oxford 1992, 105). Its
//! error is estimated by leaving one point out (Rippa, Adv. Comput. Math. 11, 1999, 193).

use crate::methods::shared::ranked_points::RankedPoints;
use nalgebra::{DMatrix, DVector};

/// Maximum number of rows of the system of equations. Larger systems take longer than short evaluations.
/// Above 34 parameters, too few points would remain.
const MOST_ROWS: usize = 72;

/// A known or predicted cost, with its mean and standard deviation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub(super) mean: f64,
    deviation: f64,
}

impl Estimate {
    pub(super) fn exact(cost: f64) -> Self {
        Self { mean: cost, deviation: 0.0 }
    }

    pub(super) fn is_exact(self) -> bool {
        self.deviation == 0.0
    }

    /// Returns the probability that this cost is lower than `other`.
    pub(super) fn below(self, other: Self) -> f64 {
        let (difference, deviation) = (other.mean - self.mean, self.deviation.hypot(other.deviation));
        if deviation > 0.0 && difference.is_finite() {
            // Logistic distribution nearest to the normal distribution.
            1.0 / (1.0 + (-1.702 * difference / deviation).exp())
        } else {
            f64::from(u8::from(other.mean > self.mean))
        }
    }
}

/// The last points of the path, and the interpolation through them.
#[derive(Debug, Clone, Default)]
pub(super) struct Prediction {
    /// Concatenated coordinates of the points, and their costs. `next` is the index to be written next.
    points: Vec<f64>,
    costs: Vec<f64>,
    next: usize,
    /// Centre and size of the simplex for which the interpolation was made.
    centre: Vec<f64>,
    size: f64,
    /// Coefficients of the basis functions, the constant and the coordinates. `None` without an
    /// interpolation.
    coefficients: Option<DVector<f64>>,
    deviation: f64,
    is_new: bool,
}

impl Prediction {
    /// Returns the number of points in the interpolation, or zero if there is none.
    fn capacity(n: usize) -> usize {
        let most = MOST_ROWS.saturating_sub(n + 1);
        if n == 0 || most < n + 2 { 0 } else { ((n + 1) * (n + 2) / 2 + n + 1).min(most) }
    }

    /// Adds a point of the path with its cost. An infinite cost means that the cost is only known to be high.
    pub(super) fn enter(&mut self, u: &[f64], cost: f64) {
        let n = u.len();
        let capacity = Self::capacity(n);
        if capacity == 0 {
            return;
        }
        if self.costs.is_empty() {
            self.points.reserve_exact(capacity * n);
            self.costs.reserve_exact(capacity);
        }
        if self.costs.len() < capacity {
            self.points.extend_from_slice(u);
            self.costs.push(cost);
        } else {
            self.points[self.next * n..(self.next + 1) * n].copy_from_slice(u);
            self.costs[self.next] = cost;
        }
        self.next = (self.next + 1) % capacity;
        self.is_new = true;
    }

    /// Updates the interpolation for a simplex, if points have been added since the last update. Allocates
    /// memory.
    pub(super) fn update(&mut self, simplex: &RankedPoints) {
        if !std::mem::take(&mut self.is_new) {
            return;
        }
        self.coefficients = self.interpolation(simplex);
    }

    fn interpolation(&mut self, simplex: &RankedPoints) -> Option<DVector<f64>> {
        let (n, m) = (simplex.n, self.costs.len());
        let (best, worst) =
            (simplex.cost(simplex.order()[0]).value()?, simplex.cost(simplex.order()[n]).value()?);
        if m < n + 2 || worst <= best {
            return None;
        }
        self.centre.clear();
        self.centre.extend_from_slice(simplex.u(simplex.order()[0]));
        let centre = &self.centre;
        let distance =
            |slot: usize| simplex.u(slot).iter().zip(centre).map(|(u, c)| (u - c).abs()).fold(0.0, f64::max);
        self.size = (0..=n).map(distance).fold(0.0, f64::max);
        let differences = self.points.chunks_exact(n).flat_map(|point| point.iter().zip(&self.centre));
        let scaled: Vec<f64> = differences.map(|(p, c)| (p - c) / self.size).collect();
        let row = |k: usize| &scaled[k * n..(k + 1) * n];
        // Limit costs to the worst cost plus the range of the simplex. Larger costs only count as high.
        let high = worst + (worst - best);
        let mut matrix = DMatrix::zeros(m + n + 1, m + n + 1);
        let mut right = DVector::zeros(m + n + 1);
        for i in 0..m {
            right[i] = self.costs[i].min(high) - best;
            for j in 0..i {
                let r = row(i).iter().zip(row(j)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                matrix[(i, j)] = r.powi(3);
                matrix[(j, i)] = r.powi(3);
            }
            matrix[(i, m)] = 1.0;
            matrix[(m, i)] = 1.0;
            for (j, &u) in row(i).iter().enumerate() {
                matrix[(i, m + 1 + j)] = u;
                matrix[(m + 1 + j, i)] = u;
            }
        }
        let inverse = matrix.try_inverse()?;
        let mut coefficients = &inverse * right;
        let last = (1..=n + 1).map(|k| (self.next + m - k) % m);
        let errors = last.map(|k| (coefficients[k] / inverse[(k, k)]).powi(2)).sum::<f64>();
        self.deviation = (errors / (n + 1) as f64).sqrt();
        coefficients[m] += best;
        coefficients.iter().all(|c| c.is_finite()).then_some(coefficients)
    }

    /// Returns the predicted cost at a point, or `None` without an interpolation.
    pub(super) fn at(&self, u: &[f64]) -> Option<Estimate> {
        let coefficients = self.coefficients.as_ref()?;
        let (n, m) = (u.len(), self.costs.len());
        let scaled = |k: usize| (u[k] - self.centre[k]) / self.size;
        let tail = coefficients[m] + (0..n).map(|k| coefficients[m + 1 + k] * scaled(k)).sum::<f64>();
        let basis = self.points.chunks_exact(n).zip(coefficients.iter()).map(|(point, c)| {
            let square = point.iter().zip(u).map(|(p, u)| ((p - u) / self.size).powi(2)).sum::<f64>();
            c * square * square.sqrt()
        });
        let mean = tail + basis.sum::<f64>();
        mean.is_finite().then_some(Estimate { mean, deviation: self.deviation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::shared::cost::Cost;
    use crate::problem::space::{Bounds, Space};

    fn quadratic(u: &[f64]) -> f64 {
        3.0 + (u[0] - 1.0).powi(2) + 2.0 * (u[1] + 0.5).powi(2) + u[0] * u[1]
    }

    #[test]
    fn prediction_error_is_within_its_estimate() {
        let space = Space::new(&[0.0, 0.0], Bounds::unbounded(2), &[], &[]).unwrap();
        let mut simplex = RankedPoints::new(&space, 3);
        let mut prediction = Prediction::default();
        for k in 0..9 {
            let u = [0.1 * f64::from(k % 3), 0.1 * f64::from(k / 3)];
            prediction.enter(&u, quadratic(&u));
        }
        for (slot, u) in [[0.1, 0.1], [0.2, 0.1], [0.1, 0.2]].iter().enumerate() {
            simplex.set(slot, u, u);
            simplex.set_cost(slot, Cost::Value(quadratic(u)));
        }
        simplex.sort();
        prediction.update(&simplex);
        for u in [[0.15, 0.15], [0.25, 0.1], [0.05, 0.18]] {
            let estimate = prediction.at(&u).unwrap();
            let error = (estimate.mean - quadratic(&u)).abs();
            assert!(error < 0.01 && error < 3.0 * estimate.deviation, "{error} {}", estimate.deviation);
        }
        // Known points keep their costs. A cost far above the simplex does not distort the interpolation near
        // it.
        let known = prediction.at(&[0.0, 0.1]).unwrap().mean;
        assert!((known - quadratic(&[0.0, 0.1])).abs() < 1e-9, "{known}");
        prediction.enter(&[0.4, 0.4], f64::INFINITY);
        prediction.update(&simplex);
        assert!((prediction.at(&[0.15, 0.15]).unwrap().mean - quadratic(&[0.15, 0.15])).abs() < 0.02);
    }

    #[test]
    fn prediction_is_none_when_points_are_too_few_or_costs_are_equal() {
        let space = Space::new(&[0.0], Bounds::unbounded(1), &[], &[]).unwrap();
        let mut simplex = RankedPoints::new(&space, 2);
        let mut prediction = Prediction::default();
        prediction.enter(&[0.0], 1.0);
        simplex.set_cost(0, Cost::Value(1.0));
        simplex.set_cost(1, Cost::Value(1.0));
        prediction.update(&simplex);
        assert!(prediction.at(&[0.5]).is_none());
        (1..9).for_each(|k| prediction.enter(&[f64::from(k)], 1.0));
        prediction.update(&simplex);
        assert!(prediction.at(&[0.5]).is_none());
    }

    #[test]
    fn probability_follows_the_estimated_error() {
        let about = |mean: f64| Estimate { mean, deviation: 1.0 };
        assert_eq!(about(0.0).below(about(0.0)), 0.5);
        // Normal distribution: Phi(1) = 0.841.
        let one = Estimate::exact(1.0);
        assert!((about(0.0).below(one) - 0.841).abs() < 0.01);
        assert_eq!(Estimate::exact(0.0).below(one), 1.0);
        assert_eq!(about(0.0).below(Estimate::exact(f64::INFINITY)), 1.0);
    }
}
