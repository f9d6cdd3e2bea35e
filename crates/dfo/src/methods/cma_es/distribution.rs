//! The normal distribution from which points are drawn, and its update from the ranked steps of a generation.

use super::weights::{Weights, effective};
use crate::method_interface::rng::Stream;
use crate::methods::shared::dot::dot;
use crate::values::encoding::numbers;
use nalgebra::{DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// Maximum condition number of the covariance matrix with an accurate decomposition (Hansen 2009:
/// ConditionCov).
const LARGEST_CONDITION: f64 = 1e14;

/// If the largest variance leaves the range from 1 / `LARGEST_VARIANCE` to this value, it is moved into the
/// step size.
const LARGEST_VARIANCE: f64 = 1e8;

/// Maximum number of sweeps per eigenvalue. A few are enough.
const MOST_SWEEPS: usize = 1000;

/// Fraction of the step of the mean that is made if individuals were drawn from earlier distributions.
/// Pending individuals have not seen this step. The values 0.4 to 1 were compared on the functions of
/// `benches/lag.rs`. This value works for any lag up to one and a half populations.
const SHARE_OF_EARLIER: f64 = 0.55;

/// Number of parameters from which the step size follows from two individuals instead of the path. The path
/// needs too many generations to shorten a first step that is too long.
pub(super) const TWO_POINTS_FROM: usize = 100;

/// Weight of the current generation in the average lead that determines the step size: Hansen, Atamna and
/// Auger (2014).
const C_LEAD: f64 = 0.3;

/// Returns the maximum length of an injected step of `n` coordinates, in units of the distribution. `times`
/// is 1 for an individual and 2 for the mean: table 1 of Hansen (2011).
fn longest(n: usize, times: f64) -> f64 {
    let n = n as f64;
    (times * n).sqrt() + 2.0 * n / (n + 2.0)
}

/// Mean, step size, covariance matrix and evolution paths. Steps are in units of the sizes of the parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Distribution {
    /// In working coordinates.
    pub(super) mean: Vec<f64>,
    pub(super) sigma: f64,
    /// Row-major, like `axes`. The entries above the diagonal are unused.
    #[serde(with = "numbers")]
    covariance: Vec<f64>,
    /// Eigenvectors of the covariance matrix as columns, from the last decomposition.
    #[serde(with = "numbers")]
    axes: Vec<f64>,
    /// Square roots of the eigenvalues.
    deviations: Vec<f64>,
    path_sigma: Vec<f64>,
    path_c: Vec<f64>,
    /// Last step of the mean, along which the two individuals of the step size are placed. Empty if the path
    /// determines the step size.
    #[serde(default, with = "numbers", skip_serializing_if = "Vec::is_empty")]
    line: Vec<f64>,
    /// Recent lead of the individual ahead of the mean over the individual on the other side, from -1 to 1.
    #[serde(default)]
    lead: f64,
    /// Weighted mean of the better steps of a generation.
    #[serde(skip)]
    shift: Vec<f64>,
    /// Weighted mean along the axes.
    #[serde(skip)]
    along: Vec<f64>,
    /// Number of updates since the start, and since the last decomposition.
    n_updates: u64,
    n_since: u64,
}

impl Distribution {
    pub(super) fn new(mean: Vec<f64>, sigma: f64) -> Self {
        let n = mean.len();
        let identity = || (0..n * n).map(|k| f64::from(k / n == k % n)).collect::<Vec<f64>>();
        Self {
            mean,
            sigma,
            covariance: identity(),
            axes: identity(),
            deviations: vec![1.0; n],
            path_sigma: vec![0.0; n],
            path_c: vec![0.0; n],
            line: Vec::new(),
            lead: 0.0,
            shift: Vec::with_capacity(n),
            along: Vec::with_capacity(n),
            n_updates: 0,
            n_since: 0,
        }
    }

    /// Draws a step `y` of `N(0, C)`, equation 39. Returns the squared length of `C^(-1/2) y`. Overwrites
    /// `normals`.
    pub(super) fn draw(&self, stream: &mut Stream, normals: &mut [f64], step: &mut [f64]) -> f64 {
        normals.iter_mut().for_each(|z| *z = stream.normal(0.0, 1.0));
        let squared = normals.iter().map(|z| z * z).sum();
        normals.iter_mut().zip(&self.deviations).for_each(|(z, d)| *z *= d);
        for (y, row) in step.iter_mut().zip(self.axes.chunks_exact(self.mean.len().max(1))) {
            *y = dot(row, normals);
        }
        squared
    }

    /// True if a last step of the mean is stored, along which the individuals of the step size can be drawn.
    pub(super) fn has_line(&self) -> bool {
        !self.line.is_empty()
    }

    /// Sets a step along the last step of the mean or opposite to it. `squared` is the squared length of
    /// `C^(-1/2) y`. Overwrites `along`.
    pub(super) fn draw_on_line(&self, ahead: bool, squared: f64, step: &mut [f64], along: &mut [f64]) {
        let factor = (squared / self.squared(&self.line, along)).sqrt();
        if factor.is_finite() {
            let factor = if ahead { factor } else { -factor };
            step.iter_mut().zip(&self.line).for_each(|(y, s)| *y = factor * s);
        }
    }

    /// Shortens a step drawn from another distribution if it is too long for this one. Returns the
    /// squared length of `C^(-1/2) y`. Overwrites `along`.
    pub(super) fn inject(&self, step: &mut [f64], along: &mut [f64]) -> f64 {
        let squared = self.squared(step, along);
        let most = longest(self.mean.len(), 1.0).powi(2);
        let factor = (most / squared).min(1.0);
        step.iter_mut().for_each(|y| *y *= factor.sqrt());
        squared * factor
    }

    /// Returns the squared length of `C^(-1/2) y`. Sets `along` to the step along the axes.
    fn squared(&self, step: &[f64], along: &mut [f64]) -> f64 {
        along.fill(0.0);
        for (row, y) in self.axes.chunks_exact(self.mean.len().max(1)).zip(step) {
            along.iter_mut().zip(row).for_each(|(a, b)| *a += b * y);
        }
        along.iter().zip(&self.deviations).map(|(a, d)| (a / d).powi(2)).sum()
    }

    /// Returns the standard deviation along coordinate `k`, in units of its size.
    pub(super) fn deviation(&self, k: usize) -> f64 {
        self.sigma * self.covariance[k * (self.mean.len() + 1)].sqrt()
    }

    /// Updates the distribution from the better steps of a generation. `ranked` contains the steps of
    /// individuals that did not fail, best first, with the squared lengths returned by [`draw`](Self::draw)
    /// or [`inject`](Self::inject). `size` returns the size of a coordinate. `is_current` is true if all
    /// steps were drawn from this distribution. `lead` is the difference in rank between the individuals on
    /// both sides of the mean, if it determines the step size.
    pub(super) fn update<'a, I>(
        &mut self,
        weights: &Weights,
        ranked: I,
        is_current: bool,
        lead: Option<f64>,
        size: impl Fn(usize) -> f64,
    ) where
        I: Iterator<Item = (&'a [f64], f64)> + Clone,
    {
        let n = self.mean.len();
        let n_parents = weights.n_parents.min(ranked.clone().count());
        let positive = &weights.of_rank[..n_parents];
        let sum: f64 = positive.iter().sum();
        // Equations 41 and 42: the mean.
        let mut shift = std::mem::take(&mut self.shift);
        shift.clear();
        shift.resize(n, 0.0);
        for (w, (y, _)) in positive.iter().zip(ranked.clone()) {
            shift.iter_mut().zip(y).for_each(|(s, y)| *s += w / sum * y);
        }
        let share = if is_current { 1.0 } else { SHARE_OF_EARLIER };
        for (k, (mean, s)) in self.mean.iter_mut().zip(&shift).enumerate() {
            let moved = *mean + share * self.sigma * size(k) * s;
            *mean = if moved.is_finite() { moved } else { *mean };
        }
        // Equations 43 and 44: the step size, from C^(-1/2) = B D^-1 B^T.
        let mu_eff = effective(positive);
        let Weights { c_sigma, d_sigma, c_c, c_1, c_mu, chi, .. } = *weights;
        let factor = (c_sigma * (2.0 - c_sigma) * mu_eff).sqrt();
        let mut along = std::mem::take(&mut self.along);
        along.clear();
        along.resize(n, 0.0);
        let squared = self.squared(&shift, &mut along);
        if !is_current {
            let factor = (longest(n, 2.0) / (mu_eff * squared).sqrt()).min(1.0);
            along.iter_mut().chain(&mut shift).for_each(|s| *s *= factor);
        }
        for (p, row) in self.path_sigma.iter_mut().zip(self.axes.chunks_exact(n.max(1))) {
            *p *= 1.0 - c_sigma;
            row.iter().zip(&along).zip(&self.deviations).for_each(|((b, a), d)| *p += factor * b * a / d);
        }
        self.along = along;
        self.n_updates += 1;
        let length = self.path_sigma.iter().map(|p| p * p).sum::<f64>().sqrt();
        self.sigma *= match lead {
            None => (c_sigma / d_sigma * (length / chi - 1.0)).min(1.0).exp(),
            // Two-point adaptation: Hansen, Atamna and Auger, "How to assess step-size adaptation mechanisms in
            // randomised search" (PPSN 2014), section 3.
            Some(lead) => {
                self.lead += if self.has_line() { C_LEAD * (lead - self.lead) } else { 0.0 };
                self.line.clone_from(&shift);
                (self.lead / (n as f64).sqrt()).exp()
            }
        };
        // Equations 45 to 47: the covariance matrix.
        let settled = 1.0 - (1.0 - c_sigma).powf(2.0 * self.n_updates as f64);
        let moves = length / settled.sqrt() < (1.4 + 2.0 / (n as f64 + 1.0)) * chi;
        let factor = if moves { (c_c * (2.0 - c_c) * mu_eff).sqrt() } else { 0.0 };
        for (p, s) in self.path_c.iter_mut().zip(&shift) {
            *p = (1.0 - c_c) * *p + factor * s;
        }
        let missing = if moves { 0.0 } else { c_1 * c_c * (2.0 - c_c) };
        let in_use = |rank: usize, w: f64| match rank {
            _ if rank < n_parents => w / sum,
            // Without failures, these ranks would be parents.
            _ => w.min(0.0),
        };
        let of_all: f64 =
            ranked.clone().zip(&weights.of_rank).enumerate().map(|(rank, (_, w))| in_use(rank, *w)).sum();
        let kept = 1.0 + missing - c_1 - c_mu * of_all;
        let scaled = |(rank, ((y, squared), w)): (usize, ((&'a [f64], f64), &f64))| {
            let w = in_use(rank, *w);
            // Long bad steps must not make the matrix indefinite.
            (y, c_mu * if w >= 0.0 || squared <= 0.0 { w } else { w * n as f64 / squared })
        };
        // One pass over the matrix, row by row. Only the lower half of a symmetric matrix is read.
        for (i, row) in self.covariance.chunks_exact_mut(n.max(1)).enumerate() {
            let row = &mut row[..=i];
            row.iter_mut().zip(&self.path_c).for_each(|(c, p)| *c = kept * *c + c_1 * (self.path_c[i] * p));
            for (y, w) in ranked.clone().zip(&weights.of_rank).enumerate().map(scaled) {
                row.iter_mut().zip(y).for_each(|(c, y_k)| *c += w * (y[i] * y_k));
            }
        }
        self.n_since += 1;
        self.shift = shift;
    }

    /// Returns to a point with half the step size, after a generation without any cost.
    pub(super) fn retreat(&mut self, to: &[f64]) {
        self.mean.copy_from_slice(to);
        self.sigma *= 0.5;
    }

    /// Decomposes the covariance matrix if it is due. Returns false if floating-point numbers cannot resolve
    /// the extent of the distribution.
    pub(super) fn refresh(&mut self, weights: &Weights) -> bool {
        if self.n_since >= weights.interval {
            self.n_since = 0;
            if !self.decompose() {
                return false;
            }
        }
        self.sigma.is_normal() && self.sigma > 0.0
    }

    fn decompose(&mut self) -> bool {
        let n = self.mean.len();
        if !self.covariance.iter().all(|c| c.is_finite()) {
            return false;
        }
        let widest = (0..n).map(|k| self.covariance[k * (n + 1)]).fold(0.0, f64::max);
        if !(1.0 / LARGEST_VARIANCE..=LARGEST_VARIANCE).contains(&widest) && widest > 0.0 {
            // Rescale the distribution so that its numbers are in the middle of their range.
            let unit = widest.sqrt();
            self.sigma *= unit;
            self.path_c.iter_mut().for_each(|p| *p /= unit);
            self.covariance.iter_mut().for_each(|c| *c /= widest);
        }
        let matrix = DMatrix::from_row_slice(n, n, &self.covariance);
        let Some(eigen) = SymmetricEigen::try_new(matrix, f64::EPSILON, MOST_SWEEPS * n) else {
            return false;
        };
        let (low, high) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
        if !(high > 0.0 && eigen.eigenvectors.iter().all(|v| v.is_finite())) {
            return false;
        }
        // Adding a multiple of the identity reduces the condition number.
        let lift = (high / LARGEST_CONDITION - low).max(0.0);
        (0..n).for_each(|k| self.covariance[k * (n + 1)] += lift);
        for (d, value) in self.deviations.iter_mut().zip(&eigen.eigenvalues) {
            *d = (value + lift).sqrt();
        }
        for (row, from) in self.axes.chunks_exact_mut(n).zip(eigen.eigenvectors.row_iter()) {
            row.iter_mut().zip(&from).for_each(|(b, v)| *b = *v);
        }
        true
    }

    pub(super) fn is_sound(&self, n: usize) -> bool {
        self.mean.len() == n
            && [&self.covariance, &self.axes].iter().all(|m| m.len() == n * n)
            && [&self.deviations, &self.path_sigma, &self.path_c].iter().all(|v| v.len() == n)
            && (self.line.is_empty() || self.line.len() == n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inject_limits_the_length_of_steps() {
        let mut d = Distribution::new(vec![0.0; 2], 1.0);
        d.deviations = vec![10.0, 0.5];
        // The limit is sqrt(2) + 1 along an axis, from Hansen's table.
        for (mut step, squared, kept) in [
            ([3.0, -0.5], 1.09, [3.0, -0.5]),
            ([0.0, 5.0], 3.0 + 2.0 * 2f64.sqrt(), [0.0, 0.5 * (1.0 + 2f64.sqrt())]),
        ] {
            assert!((d.inject(&mut step, &mut [0.0; 2]) - squared).abs() < 1e-14);
            assert!(step.iter().zip(kept).all(|(y, k)| (y - k).abs() < 1e-15), "{step:?}");
        }
        assert_eq!(d.inject(&mut [0.0; 2], &mut [0.0; 2]), 0.0);
    }

    #[test]
    fn decompose_returns_accurate_axes_for_many_parameters() {
        let n = 760;
        let mut d = Distribution::new(vec![0.0; n], 1.0);
        // The eigenvalues are between 1 and 2, except for one larger value.
        for (k, c) in d.covariance.iter_mut().enumerate() {
            *c += f64::from(k / n == k % n) * (k % n) as f64 / n as f64 + 0.01;
        }
        assert!(d.decompose());
        let (least, most) = d.deviations.iter().fold((2.0f64, 0.0f64), |m, d| (m.0.min(*d), m.1.max(*d)));
        let trace: f64 = d.deviations.iter().map(|d| d * d).sum();
        assert!((trace / (1.51 * n as f64 - 0.5) - 1.0).abs() < 1e-10, "{trace}");
        assert!((1.0..1.01).contains(&least) && (3.0..3.1).contains(&most), "{least} {most}");
        // The axes reproduce the matrix.
        let of = |i: usize, j: usize| -> f64 {
            (0..n).map(|k| d.axes[i * n + k] * d.axes[j * n + k] * d.deviations[k].powi(2)).sum()
        };
        for (i, j) in [(0, 0), (3, 700), (759, 759), (400, 401)] {
            assert!((of(i, j) - d.covariance[i * n + j]).abs() < 1e-10, "{i} {j}");
        }
    }
}
