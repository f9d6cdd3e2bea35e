//! The normal distribution that points are drawn from, and how it follows the ranked steps of a generation.

use super::weights::{Weights, effective};
use crate::rng::Stream;
use nalgebra::{DMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

/// A larger condition number of the covariance matrix has no accurate decomposition (Hansen 2009: ConditionCov).
const LARGEST_CONDITION: f64 = 1e14;

/// Beyond this and its inverse the largest variance goes over into the step size.
const LARGEST_VARIANCE: f64 = 1e8;

/// Mean, step size, covariance matrix and evolution paths. Steps are in units of the sizes of the parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Distribution {
    /// In working coordinates.
    pub(super) mean: Vec<f64>,
    pub(super) sigma: f64,
    /// Row by row, as `axes`.
    covariance: Vec<f64>,
    /// The eigenvectors of the covariance matrix as columns, as of the last decomposition.
    axes: Vec<f64>,
    /// The roots of the eigenvalues.
    deviations: Vec<f64>,
    path_sigma: Vec<f64>,
    path_c: Vec<f64>,
    /// The weighted mean of the better steps of a generation.
    #[serde(skip)]
    shift: Vec<f64>,
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
            shift: Vec::with_capacity(n),
            n_updates: 0,
            n_since: 0,
        }
    }

    /// Draws a step `y` of `N(0, C)`, equation 39; returns the squared length of `C^(-1/2) y`. `normals` is overwritten.
    pub(super) fn draw(&self, stream: &mut Stream, normals: &mut [f64], step: &mut [f64]) -> f64 {
        normals.iter_mut().for_each(|z| *z = stream.normal(0.0, 1.0));
        let squared = normals.iter().map(|z| z * z).sum();
        normals.iter_mut().zip(&self.deviations).for_each(|(z, d)| *z *= d);
        for (y, row) in step.iter_mut().zip(self.axes.chunks_exact(self.mean.len().max(1))) {
            *y = row.iter().zip(&*normals).map(|(b, z)| b * z).sum();
        }
        squared
    }

    /// Standard deviation along coordinate `k`, in units of its size.
    pub(super) fn deviation(&self, k: usize) -> f64 {
        self.sigma * self.covariance[k * (self.mean.len() + 1)].sqrt()
    }

    /// Moves towards the better steps, given best first with the squared lengths that [`draw`](Self::draw) returned; `size`
    /// is that of a coordinate. Steps of failed individuals are not among them.
    pub(super) fn update<'a, I>(&mut self, weights: &Weights, ranked: I, size: impl Fn(usize) -> f64)
    where
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
        for (k, (mean, s)) in self.mean.iter_mut().zip(&shift).enumerate() {
            let moved = *mean + self.sigma * size(k) * s;
            *mean = if moved.is_finite() { moved } else { *mean };
        }
        // Equations 43 and 44: the step size, from C^(-1/2) = B D^-1 B^T.
        let mu_eff = effective(positive);
        let Weights { c_sigma, d_sigma, c_c, c_1, c_mu, chi, .. } = *weights;
        let factor = (c_sigma * (2.0 - c_sigma) * mu_eff).sqrt();
        self.path_sigma.iter_mut().for_each(|p| *p *= 1.0 - c_sigma);
        for (j, d) in self.deviations.iter().enumerate() {
            let along: f64 = (0..n).map(|i| self.axes[i * n + j] * shift[i]).sum();
            for (i, p) in self.path_sigma.iter_mut().enumerate() {
                *p += factor * self.axes[i * n + j] * along / d;
            }
        }
        self.n_updates += 1;
        let length = self.path_sigma.iter().map(|p| p * p).sum::<f64>().sqrt();
        self.sigma *= (c_sigma / d_sigma * (length / chi - 1.0)).min(1.0).exp();
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
        self.covariance.iter_mut().for_each(|c| *c *= kept);
        add_outer(&mut self.covariance, c_1, &self.path_c);
        for (rank, ((y, squared), w)) in ranked.zip(&weights.of_rank).enumerate() {
            let w = in_use(rank, *w);
            // Long bad steps must not turn the matrix indefinite.
            let scaled = if w >= 0.0 || squared <= 0.0 { w } else { w * n as f64 / squared };
            add_outer(&mut self.covariance, c_mu * scaled, y);
        }
        self.n_since += 1;
        self.shift = shift;
    }

    /// Goes back to a point with half the step size: nothing was learnt.
    pub(super) fn retreat(&mut self, to: &[f64]) {
        self.mean.copy_from_slice(to);
        self.sigma *= 0.5;
    }

    /// Decomposes the covariance matrix if it is time to. False: the distribution has no extent that numbers could resolve.
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
        let Some(eigen) = SymmetricEigen::try_new(matrix, f64::EPSILON, 1000) else { return false };
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
    }
}

/// Adds `w v v^T`.
fn add_outer(matrix: &mut [f64], w: f64, v: &[f64]) {
    for (row, a) in matrix.chunks_exact_mut(v.len().max(1)).zip(v) {
        row.iter_mut().zip(v).for_each(|(c, b)| *c += w * (a * b));
    }
}
