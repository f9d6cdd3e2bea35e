//! The normal distribution that points are drawn from, and how it follows the ranked steps of a generation.

use super::weights::{Weights, effective};
use crate::method_interface::rng::Stream;
use crate::methods::shared::dot::dot;
use crate::values::encoding::numbers;
use nalgebra::{DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// A larger condition number of the covariance matrix has no accurate decomposition (Hansen 2009:
/// ConditionCov).
const LARGEST_CONDITION: f64 = 1e14;

/// Beyond this and its inverse the largest variance goes over into the step size.
const LARGEST_VARIANCE: f64 = 1e8;

/// Sweeps for each eigenvalue: a few are enough.
const MOST_SWEEPS: usize = 1000;

/// Share of the step of the mean that is made where individuals were drawn from earlier distributions: those
/// that follow have not seen it. Of 0.4 to 1 the one that is good for any lag up to one and a half
/// populations, on the functions of `benches/lag.rs`.
const SHARE_OF_EARLIER: f64 = 0.55;

/// From so many parameters on the step size follows from two individuals, not from its path, which needs too
/// many generations to shorten a first step that is too long.
pub(super) const TWO_POINTS_FROM: usize = 100;

/// Share of the present generation in the lead that the step size follows: Hansen, Atamna and Auger (2014).
const C_LEAD: f64 = 0.3;

/// Longest step from elsewhere of so many coordinates in units of the distribution, for an individual
/// (`times` 1) and for the mean (2): table 1 of Hansen (2011).
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
    /// Row by row, as `axes`; what stands above the diagonal means nothing.
    #[serde(with = "numbers")]
    covariance: Vec<f64>,
    /// The eigenvectors of the covariance matrix as columns, as of the last decomposition.
    #[serde(with = "numbers")]
    axes: Vec<f64>,
    /// The roots of the eigenvalues.
    deviations: Vec<f64>,
    path_sigma: Vec<f64>,
    path_c: Vec<f64>,
    /// The last step of the mean, which the two individuals of the step size lie along; none where the path
    /// changes it.
    #[serde(default, with = "numbers", skip_serializing_if = "Vec::is_empty")]
    line: Vec<f64>,
    /// By how much the one ahead of the mean was better than the one behind, of late: from -1 to 1.
    #[serde(default)]
    lead: f64,
    /// The weighted mean of the better steps of a generation.
    #[serde(skip)]
    shift: Vec<f64>,
    /// The same along the axes.
    #[serde(skip)]
    along: Vec<f64>,
    /// Updates since the beginning, and since the last decomposition.
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

    /// Draws a step `y` of `N(0, C)`, equation 39; returns the squared length of `C^(-1/2) y`. `normals` is
    /// overwritten.
    pub(super) fn draw(&self, stream: &mut Stream, normals: &mut [f64], step: &mut [f64]) -> f64 {
        normals.iter_mut().for_each(|z| *z = stream.normal(0.0, 1.0));
        let squared = normals.iter().map(|z| z * z).sum();
        normals.iter_mut().zip(&self.deviations).for_each(|(z, d)| *z *= d);
        for (y, row) in step.iter_mut().zip(self.axes.chunks_exact(self.mean.len().max(1))) {
            *y = dot(row, normals);
        }
        squared
    }

    /// True if there is a last step of the mean to draw the individuals of the step size along.
    pub(super) fn has_line(&self) -> bool {
        !self.line.is_empty()
    }

    /// Makes the step of a squared length (of `C^(-1/2) y`) that lies ahead of the mean, along its last step,
    /// or behind it. `along` is overwritten.
    pub(super) fn draw_on_line(&self, ahead: bool, squared: f64, step: &mut [f64], along: &mut [f64]) {
        let factor = (squared / self.squared(&self.line, along)).sqrt();
        if factor.is_finite() {
            let factor = if ahead { factor } else { -factor };
            step.iter_mut().zip(&self.line).for_each(|(y, s)| *y = factor * s);
        }
    }

    /// Shortens a step that was not drawn from this distribution if it is too long for it; returns the
    /// squared length of `C^(-1/2) y`. `along` is overwritten.
    pub(super) fn inject(&self, step: &mut [f64], along: &mut [f64]) -> f64 {
        let squared = self.squared(step, along);
        let most = longest(self.mean.len(), 1.0).powi(2);
        let factor = (most / squared).min(1.0);
        step.iter_mut().for_each(|y| *y *= factor.sqrt());
        squared * factor
    }

    /// The squared length of `C^(-1/2) y`; `along` becomes the step along the axes.
    fn squared(&self, step: &[f64], along: &mut [f64]) -> f64 {
        along.fill(0.0);
        for (row, y) in self.axes.chunks_exact(self.mean.len().max(1)).zip(step) {
            along.iter_mut().zip(row).for_each(|(a, b)| *a += b * y);
        }
        along.iter().zip(&self.deviations).map(|(a, d)| (a / d).powi(2)).sum()
    }

    /// Standard deviation along coordinate `k`, in units of its size.
    pub(super) fn deviation(&self, k: usize) -> f64 {
        self.sigma * self.covariance[k * (self.mean.len() + 1)].sqrt()
    }

    /// Moves towards the better steps, given best first with the squared lengths that [`draw`](Self::draw) or
    /// [`inject`](Self::inject) returned; `size` is that of a coordinate, `is_own`: whether all were drawn
    /// from this distribution. Steps of failed individuals are not among them. `lead`: by how many of the
    /// ranks the individual ahead of the mean was better than the one behind, where the step size follows
    /// from it.
    pub(super) fn update<'a, I>(
        &mut self,
        weights: &Weights,
        ranked: I,
        is_own: bool,
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
        let share = if is_own { 1.0 } else { SHARE_OF_EARLIER };
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
        if !is_own {
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
            // Ranks that would be parents, were there no failures.
            _ => w.min(0.0),
        };
        let of_all: f64 =
            ranked.clone().zip(&weights.of_rank).enumerate().map(|(rank, (_, w))| in_use(rank, *w)).sum();
        let kept = 1.0 + missing - c_1 - c_mu * of_all;
        let scaled = |(rank, ((y, squared), w)): (usize, ((&'a [f64], f64), &f64))| {
            let w = in_use(rank, *w);
            // Long bad steps must not turn the matrix indefinite.
            (y, c_mu * if w >= 0.0 || squared <= 0.0 { w } else { w * n as f64 / squared })
        };
        // Row by row, so that the matrix is gone through once; of a symmetric matrix the lower half is all that is read.
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

    /// Goes back to a point with half the step size: nothing was learnt.
    pub(super) fn retreat(&mut self, to: &[f64]) {
        self.mean.copy_from_slice(to);
        self.sigma *= 0.5;
    }

    /// Decomposes the covariance matrix if it is time to. False: the distribution has no extent that numbers
    /// could resolve.
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
            // The same distribution with numbers in the middle of their range.
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
        // A multiple of the identity brings the condition number down.
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
    fn steps_from_elsewhere_are_no_longer_than_those_of_the_distribution() {
        let mut d = Distribution::new(vec![0.0; 2], 1.0);
        d.deviations = vec![10.0, 0.5];
        // sqrt(2) + 1 along an axis, by Hansen's table.
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
    fn many_parameters_have_axes() {
        let n = 760;
        let mut d = Distribution::new(vec![0.0; n], 1.0);
        // With eigenvalues from 1 to 2, but one that is larger.
        for (k, c) in d.covariance.iter_mut().enumerate() {
            *c += f64::from(k / n == k % n) * (k % n) as f64 / n as f64 + 0.01;
        }
        assert!(d.decompose());
        let (least, most) = d.deviations.iter().fold((2.0f64, 0.0f64), |m, d| (m.0.min(*d), m.1.max(*d)));
        let trace: f64 = d.deviations.iter().map(|d| d * d).sum();
        assert!((trace / (1.51 * n as f64 - 0.5) - 1.0).abs() < 1e-10, "{trace}");
        assert!((1.0..1.01).contains(&least) && (3.0..3.1).contains(&most), "{least} {most}");
        // The matrix is made of its axes.
        let of = |i: usize, j: usize| -> f64 {
            (0..n).map(|k| d.axes[i * n + k] * d.axes[j * n + k] * d.deviations[k].powi(2)).sum()
        };
        for (i, j) in [(0, 0), (3, 700), (759, 759), (400, 401)] {
            assert!((of(i, j) - d.covariance[i * n + j]).abs() < 1e-10, "{i} {j}");
        }
    }
}
