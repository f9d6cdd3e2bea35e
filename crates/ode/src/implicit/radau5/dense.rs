//! Dense output of a step of Radau5, and its error.
//!
//! The collocation polynomial `p` of degree 3 passes through the stages, so its error can be written down.
//! `M(theta)` is the product of the distances to the abscissae, and `e_i` are the errors of the stages. The
//! error is `(h^4 x'''' / 24) theta M(theta)` plus the cubic through `e_i` at the abscissae and 0 at the
//! start of the step (for `x' = lambda x + g(t)`; equal to leading order for other systems). Two terms
//! correct it.
//!
//! *Defect.* `q(theta) d`, where `q` is the integral of `M` with slope 1 at 0. `d` is the difference between
//! the slope at the start and the slope of `p`, filtered like the error estimate. If the system is not stiff,
//! this is the whole error. If it is stiff, `d` vanishes, because stiff components follow their slow path for
//! any step size. The stages are then exact but the polynomial between them is not, and no value inside the
//! step shows this.
//!
//! *Bend.* `c theta M(theta)` does not change the ends and the stages. `c` follows from the point where the
//! previous step began, through which the solution passed. Both terms together are of order 4, stiff or not.
//!
//! The bend measures the difference between the two orders, and thus the accuracy inside the step.

use super::coefficients::{C1, C2};
use crate::error_norm::scaled_norm;

/// Maximum of `|theta M(theta)|` within a step.
const LARGEST_BEND: f64 = 0.018_25;
/// Maximum of `|q(theta)|` within a step.
const LARGEST_CORRECTION: f64 = 0.067_8;

/// The collocation polynomial of a step of size `h`: `end + s (p0 + (s - C2 + 1) (p1 + (s - C1 + 1) p2))`
/// with `s = theta - 1`.
#[derive(Debug, Default)]
pub(super) struct Collocation {
    p: [Vec<f64>; 3],
    h: f64,
}

impl Collocation {
    /// Allocates the work space for `n` states.
    pub(super) fn begin(&mut self, n: usize) {
        for p in &mut self.p {
            p.clear();
            p.resize(n, 0.0);
        }
    }

    /// Sets the polynomial of a step of size `h` with these stage increments.
    pub(super) fn set(&mut self, h: f64, [z1, z2, z3]: &[Vec<f64>; 3]) {
        self.h = h;
        for i in 0..z1.len() {
            let p0 = (z3[i] - z2[i]) / (1.0 - C2);
            let d12 = (z2[i] - z1[i]) / (C2 - C1);
            let p1 = (p0 - d12) / (1.0 - C1);
            self.p[0][i] = p0;
            self.p[1][i] = p1;
            self.p[2][i] = p1 - (d12 - z1[i] / C1) / C2;
        }
    }

    /// Size of the step.
    pub(super) fn h(&self) -> f64 {
        self.h
    }

    /// Returns state `i` at `s = theta - 1`, minus its value at the end of the step.
    pub(super) fn value(&self, i: usize, s: f64) -> f64 {
        s * (self.p[0][i] + (s + 1.0 - C2) * (self.p[1][i] + (s + 1.0 - C1) * self.p[2][i]))
    }
}

/// The correction terms of the collocation polynomial.
#[derive(Debug, Default)]
pub(super) struct Terms {
    /// The filtered difference of slopes at the start of the step.
    pub(super) defect: Vec<f64>,
    bend: Vec<f64>,
}

impl Terms {
    /// Allocates the work space for `n` states.
    pub(super) fn begin(&mut self, n: usize) {
        for v in [&mut self.defect, &mut self.bend] {
            v.clear();
            v.resize(n, 0.0);
        }
    }

    /// Computes the bend of the step `trial` from the previous step, `last`. Returns the norm, with these
    /// inverse weights, of the uncertainty inside the step.
    pub(super) fn bend(&mut self, trial: &Collocation, last: Option<&Collocation>, inverse: &[f64]) -> f64 {
        let Some(last) = last else {
            self.bend.fill(0.0);
            return LARGEST_CORRECTION * scaled_norm(&self.defect, inverse);
        };
        let theta = -last.h / trial.h;
        let (q, w) = (correction(theta), theta * nodes(theta));
        for (i, bend) in self.bend.iter_mut().enumerate() {
            // Both values are relative to the point where the steps meet.
            let before = last.value(i, -1.0);
            let continued = trial.value(i, theta - 1.0) - trial.value(i, -1.0) + q * self.defect[i];
            *bend = (before - continued) / w;
        }
        LARGEST_BEND * scaled_norm(&self.bend, inverse)
    }

    /// Returns state `i` at `theta` within the step, minus its value at the end of the step.
    pub(super) fn value(&self, step: &Collocation, theta: f64) -> impl Fn(usize) -> f64 {
        let (q, w) = (correction(theta), theta * nodes(theta));
        move |i| step.value(i, theta - 1.0) + q * self.defect[i] + w * self.bend[i]
    }
}

/// `M`: the product of the distances to the abscissae.
fn nodes(theta: f64) -> f64 {
    (theta - C1) * (theta - C2) * (theta - 1.0)
}

/// `q`: the integral of `M` divided by its value at 0. Zero at 0 and 1, slope 1 at 0, slope 0 at the
/// abscissae.
fn correction(theta: f64) -> f64 {
    theta * (1.0 + theta * (-4.5 + theta * (6.0 - 2.5 * theta)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correction_preserves_ends_and_slopes() {
        let slope = |s: f64| (correction(s + 1e-6) - correction(s - 1e-6)) / 2e-6;
        assert_eq!(correction(0.0), 0.0);
        assert!(correction(1.0).abs() < 1e-15);
        assert!((slope(0.0) - 1.0).abs() < 1e-9);
        for c in [C1, C2, 1.0] {
            assert!(slope(c).abs() < 1e-9);
        }
    }

    #[test]
    fn largest_values_match_constants() {
        let largest =
            |f: &dyn Fn(f64) -> f64| (0..=10_000).map(|k| f(f64::from(k) * 1e-4).abs()).fold(0.0, f64::max);
        assert!((largest(&|s| s * nodes(s)) / LARGEST_BEND - 1.0).abs() < 0.01);
        assert!((largest(&correction) / LARGEST_CORRECTION - 1.0).abs() < 0.01);
    }

    /// With exact stages, as for stiff components, the interpolation is exact for polynomials of degree 4.
    #[test]
    fn quartic_is_interpolated_exactly() {
        let x = |t: f64| 2.0 + t * (1.0 + t * (-3.0 + t * (0.5 + 0.25 * t)));
        let step = |t: f64, h: f64| {
            let mut c = Collocation::default();
            c.begin(1);
            c.set(h, &[C1, C2, 1.0].map(|c| vec![x(t + c * h) - x(t)]));
            c
        };
        let (t, h) = (0.3, 0.7);
        let (last, trial) = (step(t - 0.4, 0.4), step(t, h));
        let mut terms = Terms::default();
        terms.begin(1);
        let uncertain = terms.bend(&trial, Some(&last), &[1.0]);
        assert!((uncertain / (LARGEST_BEND * 0.25 * h.powi(4)) - 1.0).abs() < 1e-9, "{uncertain}");
        for theta in [0.1, 0.35, 0.5, 0.8] {
            let value = x(t + h) + terms.value(&trial, theta)(0);
            assert!((value - x(t + theta * h)).abs() < 1e-13);
        }
    }
}
