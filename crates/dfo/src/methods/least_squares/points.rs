//! Evaluated points with their residuals, and the selection of points for a model.

use crate::values::encoding::numbers;
use serde::{Deserialize, Serialize};

/// Minimum relative distance from the plane of the previously chosen points at which a point adds enough
/// information.
const INDEPENDENT: f64 = 0.03;
/// Minimum relative distance from the plane if no better point is available.
pub(super) const BARELY_INDEPENDENT: f64 = 1e-7;

/// A point with a cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Evaluated {
    /// Displacement from the start, in units of the parameter sizes.
    pub(super) z: Vec<f64>,
    /// Values in the user's units.
    pub(super) x: Vec<f64>,
    /// Sum of the squares of the residuals. The cost of the objective may be another increasing function of
    /// it.
    pub(super) cost: f64,
    #[serde(with = "numbers")]
    pub(super) residuals: Vec<f64>,
}

pub(super) fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

pub(super) fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

pub(super) fn norm(v: &[f64]) -> f64 {
    v.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Number of partial sums that can be added in parallel.
const LANES: usize = 8;

/// Returns the dot product.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (blocks_a, blocks_b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = blocks_a.remainder().iter().zip(blocks_b.remainder()).map(|(a, b)| a * b).sum::<f64>();
    let mut sums = [0.0; LANES];
    for (a, b) in blocks_a.zip(blocks_b) {
        (0..LANES).for_each(|k| sums[k] += a[k] * b[k]);
    }
    sums.iter().sum::<f64>() + rest
}

/// `y += share x`.
pub(super) fn axpy(share: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += share * x);
}

/// Returns the sum of squares, added from the first to the last, as [`RobustLoss::cost`] adds them.
///
/// [`RobustLoss::cost`]: crate::RobustLoss::cost
pub(super) fn sum_of_squares(residuals: &[f64]) -> f64 {
    residuals.iter().fold(0.0, |sum, r| sum + r * r)
}

pub(super) fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Points chosen one by one, each outside the plane of the previous ones.
pub(super) struct Selection {
    /// Indices of the points.
    pub(super) chosen: Vec<usize>,
    /// Orthonormal basis of the directions to the points.
    basis: Vec<Vec<f64>>,
}

impl Selection {
    pub(super) fn new() -> Self {
        Self { chosen: Vec::new(), basis: Vec::new() }
    }

    /// Returns the part of `v` that is orthogonal to all directions in the basis.
    fn rest(&self, v: &[f64]) -> Vec<f64> {
        let mut rest = v.to_vec();
        // Orthogonalise twice to reduce rounding errors.
        for _ in 0..2 {
            for b in &self.basis {
                let along: f64 = rest.iter().zip(b).map(|(r, b)| r * b).sum();
                rest.iter_mut().zip(b).for_each(|(r, b)| *r -= along * b);
            }
        }
        rest
    }

    /// Adds a direction if its new part exceeds the threshold.
    pub(super) fn add(&mut self, v: &[f64], threshold: f64) -> bool {
        let (rest, length) = (self.rest(v), norm(v));
        let new = norm(&rest);
        let added = new > threshold * length && new > 0.0;
        if added {
            self.basis.push(rest.iter().map(|r| r / new).collect());
        }
        added
    }

    /// Selects up to `most` independent points nearest to `centre`, excluding `centre` itself.
    pub(super) fn nearest(points: &[Evaluated], centre: &[f64], most: usize) -> Self {
        let mut near: Vec<(usize, f64)> = points
            .iter()
            .enumerate()
            .map(|(k, p)| (k, distance(&p.z, centre)))
            .filter(|(_, d)| *d > 0.0)
            .collect();
        near.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        let mut selection = Self::new();
        for threshold in [INDEPENDENT, BARELY_INDEPENDENT] {
            for (k, _) in &near {
                if selection.chosen.len() >= most {
                    return selection;
                }
                if !selection.chosen.contains(k)
                    && selection.add(&difference(&points[*k].z, centre), threshold)
                {
                    selection.chosen.push(*k);
                }
            }
        }
        selection
    }

    /// Selects these directions.
    pub(super) fn of<'a>(directions: impl Iterator<Item = &'a [f64]>) -> Self {
        let mut selection = Self::new();
        for direction in directions {
            selection.add(direction, BARELY_INDEPENDENT);
        }
        selection
    }

    /// Returns unit vectors that complete the directions. They are coordinate directions if these are
    /// independent.
    pub(super) fn missing(mut self, n: usize) -> Vec<Vec<f64>> {
        let n_present = self.basis.len();
        while self.basis.len() < n {
            // Coordinate with the largest missing part.
            let unit = |k: usize| (0..n).map(|j| if j == k { 1.0 } else { 0.0 }).collect::<Vec<f64>>();
            let most = (0..n).map(|k| (k, norm(&self.rest(&unit(k)))));
            let (k, _) = most.fold((0, -1.0), |best, new| if new.1 > best.1 { new } else { best });
            if !self.add(&unit(k), 0.0) {
                break;
            }
        }
        self.basis.split_off(n_present)
    }
}
