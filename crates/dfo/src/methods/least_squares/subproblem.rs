//! The step of a Gauss-Newton model within a ball and a box.

use nalgebra::{DMatrix, DVector, SVD};

/// Newton steps for the multiplier of the ball: from a good bracket it takes three or four.
const MOST_STEPS: usize = 60;
/// Singular values below this share of the largest are rounding: differences of residuals have lost some digits.
const RANK: f64 = 1e-13;
/// Sweeps for singular values: a few for each are enough.
const MOST_SWEEPS: usize = 1000;
/// Numbers of a Jacobian that are turned at once: they fit into a cache.
const AT_ONCE: usize = 1 << 18;

/// The run was interrupted.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cancelled;

/// Residuals as a linear function of the displacement `s` from a base point, turned so that only n numbers are left of them:
/// `|r + J s|^2 = |c + F s|^2 + constant`, with `F` and `c` from the QR factorisation of `J`.
#[derive(Debug, Clone)]
pub(super) struct Linear {
    pub(super) factor: DMatrix<f64>,
    pub(super) reached: DVector<f64>,
}

impl Linear {
    /// Turns residuals and their Jacobian, m x n, block of rows by block of rows: each with the triangle that those before it have left
    /// (Demmel, Grigori, Hoemmen and Langou, SIAM J. Sci. Comput. 34, 2012, A206). `cancelled` is asked before each block but the first.
    pub(super) fn new(
        (m, n): (usize, usize),
        residual: impl Fn(usize) -> f64,
        jacobian: impl Fn(usize, usize) -> f64,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<Self, Cancelled> {
        let rows = (AT_ONCE / n.max(1)).max(4 * n);
        let (mut factor, mut reached) = (DMatrix::zeros(0, n), DVector::zeros(0));
        let mut from = 0;
        while from < m {
            if from > 0 && cancelled() {
                return Err(Cancelled);
            }
            let to = if m - from < 2 * rows { m } else { from + rows };
            let above = factor.nrows();
            let row = |i: usize| i - above + from;
            let stacked = DMatrix::from_fn(above + to - from, n, |i, j| {
                if i < above { factor[(i, j)] } else { jacobian(row(i), j) }
            });
            let turned =
                DVector::from_fn(
                    stacked.nrows(),
                    |i, _| if i < above { reached[i] } else { residual(row(i)) },
                );
            Self { factor, reached } = Self::turned(turned, stacked);
            from = to;
        }
        Ok(Self { factor, reached })
    }

    /// Turns residuals and a Jacobian that are at hand.
    pub(super) fn turned(mut residuals: DVector<f64>, jacobian: DMatrix<f64>) -> Self {
        let (m, n) = jacobian.shape();
        if m <= n {
            return Self { factor: jacobian, reached: residuals };
        }
        let qr = jacobian.qr();
        qr.q_tr_mul(&mut residuals);
        Self { factor: qr.r(), reached: residuals.rows(0, n).into_owned() }
    }
}

/// A step from the best point: `|s| <= radius` and `lower <= s <= upper`, such that `|r + J s|` is (nearly) smallest.
///
/// The problem in the ball alone is solved exactly by the singular values of `J` (Moré and Sorensen 1983, with `J'J` in place of the
/// Hessian). Where the solution leaves the box, the coordinate that reaches its bound first is set there, and the rest is solved again.
pub(super) struct Subproblem<'a> {
    pub(super) linear: &'a Linear,
    pub(super) radius: f64,
    pub(super) lower: &'a [f64],
    pub(super) upper: &'a [f64],
}

impl Subproblem<'_> {
    /// The step, and the decrease of the sum of squares that the model predicts.
    pub(super) fn solve(&self) -> (Vec<f64>, f64) {
        let Linear { factor, reached } = self.linear;
        let n = factor.ncols();
        let gradient = factor.tr_mul(reached);
        let mut step = vec![0.0; n];
        // At a bound with the descent leading out.
        let blocked = |k: usize| {
            (self.lower[k] >= 0.0 && gradient[k] > 0.0) || (self.upper[k] <= 0.0 && gradient[k] < 0.0)
        };
        let mut free: Vec<usize> = (0..n).filter(|&k| !blocked(k)).collect();
        let mut left = self.radius * self.radius;
        let mut rest = reached.clone();
        while !free.is_empty() && left > 0.0 {
            let part = within_ball(factor.select_columns(&free), &rest, left.sqrt());
            let share = |(place, &k): (usize, &usize)| {
                let s = part[place];
                let bound = if s > 0.0 { self.upper[k] } else { self.lower[k] };
                if s != 0.0 && (bound / s) < 1.0 { bound / s } else { 1.0 }
            };
            let shares: Vec<f64> = free.iter().enumerate().map(share).collect();
            let first = shares.iter().copied().fold(1.0, f64::min);
            if first >= 1.0 {
                free.iter().enumerate().for_each(|(place, &k)| step[k] = part[place]);
                break;
            }
            let mut still = Vec::with_capacity(free.len());
            for (place, &k) in free.iter().enumerate() {
                if shares[place] > first {
                    still.push(k);
                    continue;
                }
                step[k] = if part[place] > 0.0 { self.upper[k] } else { self.lower[k] };
                left -= step[k] * step[k];
                rest += factor.column(k) * step[k];
            }
            free = still;
        }
        let after = reached + factor * DVector::from_column_slice(&step);
        (step, reached.norm_squared() - after.norm_squared())
    }
}

/// The step that makes `|r + A s|` smallest, where `A` tells of all directions.
fn unlimited(a: &DMatrix<f64>, r: &DVector<f64>) -> Option<DVector<f64>> {
    let (m, n) = a.shape();
    if m < n {
        return None;
    }
    let qr = a.clone().qr();
    let upper = qr.r();
    let (least, most) = (0..n).fold((f64::INFINITY, 0.0f64), |(least, most), k| {
        (least.min(upper[(k, k)].abs()), most.max(upper[(k, k)].abs()))
    });
    // Near the rounding of its entries a matrix has no inverse.
    if least <= 1e-10 * most {
        return None;
    }
    let mut turned = r.clone();
    qr.q_tr_mul(&mut turned);
    upper.solve_upper_triangular(&-turned.rows(0, n)).filter(|step| step.iter().all(|s| s.is_finite()))
}

/// The shortest of the steps that make `|r + A s|` smallest within `|s| <= radius`.
fn within_ball(a: DMatrix<f64>, r: &DVector<f64>, radius: f64) -> DVector<f64> {
    let n = a.ncols();
    if let Some(step) = unlimited(&a, r).filter(|step| step.norm() <= radius) {
        return step;
    }
    // Numbers near the largest there are may have none.
    let svd = SVD::try_new(a, true, true, f64::EPSILON, MOST_SWEEPS);
    let Some(SVD { u: Some(u), v_t: Some(v_t), singular_values: sigma }) = &svd else {
        return DVector::zeros(n);
    };
    let c = u.tr_mul(r);
    let largest = sigma.max();
    let at = |multiplier: f64| {
        DVector::from_iterator(
            sigma.len(),
            sigma
                .iter()
                .zip(c.iter())
                .map(|(s, c)| if *s <= RANK * largest { 0.0 } else { -s * c / (s * s + multiplier) }),
        )
    };
    let mut part = at(0.0);
    if part.norm() > radius {
        // 1 / |s| is nearly linear in the multiplier; Newton's method from below ends from below.
        let gradient = DVector::from_iterator(sigma.len(), sigma.iter().zip(c.iter()).map(|(s, c)| s * c));
        let (mut low, mut high) = (0.0f64, gradient.norm() / radius);
        let mut multiplier = 0.0;
        for _ in 0..MOST_STEPS {
            part = at(multiplier);
            let norm = part.norm();
            if (norm / radius - 1.0).abs() < 1e-6 {
                break;
            }
            if norm > radius {
                low = multiplier
            } else {
                high = multiplier
            }
            let slope: f64 = part
                .iter()
                .zip(sigma.iter())
                .filter(|(p, _)| **p != 0.0)
                .map(|(p, s)| p * p / (s * s + multiplier))
                .sum();
            let next = multiplier + (norm / radius - 1.0) * norm * norm / slope;
            multiplier = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        let norm = part.norm();
        if norm > radius {
            part *= radius / norm;
        }
    }
    v_t.tr_mul(&part)
}

/// The point of a ball and a box where `|g s|` is largest: along `g` or against it, coordinates that reach their bounds set there.
/// `other`: on the other side.
pub(super) fn longest(g: &[f64], radius: f64, (lower, upper): (&[f64], &[f64]), other: bool) -> Vec<f64> {
    let along = |sign: f64| {
        let mut step = vec![0.0; g.len()];
        let mut free: Vec<usize> = (0..g.len()).filter(|&k| g[k] != 0.0).collect();
        let mut left = radius * radius;
        while !free.is_empty() && left > 0.0 {
            let norm = free.iter().map(|&k| g[k] * g[k]).sum::<f64>().sqrt();
            let wanted = |k: usize| sign * g[k] / norm * left.sqrt();
            let set: Vec<usize> =
                free.iter().copied().filter(|&k| !(lower[k]..=upper[k]).contains(&wanted(k))).collect();
            if set.is_empty() {
                free.iter().for_each(|&k| step[k] = wanted(k));
                break;
            }
            for k in set {
                step[k] = wanted(k).clamp(lower[k], upper[k]);
                free.retain(|&other| other != k);
            }
            left = radius * radius - step.iter().map(|s| s * s).sum::<f64>();
        }
        step
    };
    let value = |step: &[f64]| g.iter().zip(step).map(|(g, s)| g * s).sum::<f64>().abs();
    let (forth, back) = (along(1.0), along(-1.0));
    if (value(&back) > value(&forth)) != other { back } else { forth }
}
