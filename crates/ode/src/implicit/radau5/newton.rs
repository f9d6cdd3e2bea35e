//! The equations of the stages: a first guess, and simplified Newton iterations on the transformed stages.

use super::coefficients::{ALPHA, BETA, C1, C2, GAMMA, T, T_INVERSE};
use super::{KEEP_JACOBIAN, Radau5, U};
use crate::control::scaled_norm;
use crate::stepper::{Equations, Trial};
use crate::system::{CallError, CallResult, HybridSystem};
use nalgebra::Complex;

/// Iterations before a step is given up.
pub(super) const MAX_NEWTON: u32 = 7;

/// How Newton's method ended.
pub(super) enum Newton {
    Converged,
    /// With a fresh Jacobian the step should be this share of its size.
    Failed(f64),
}

impl Radau5 {
    /// Stage increments extrapolated from the last step, or zero.
    fn guess_stages(&mut self, h: f64) {
        let inside = std::mem::take(&mut self.is_repetition);
        if !self.can_extrapolate && !inside {
            self.z.iter_mut().chain(&mut self.w).for_each(|v| v.fill(0.0));
            return;
        }
        // Counted from the end of the last step, or from the end of the longer step from the same point.
        let (from, before) = if inside { (&self.trial, 1.0) } else { (&self.last, 0.0) };
        let ratio = h / from.h();
        let s = [C1 * ratio, C2 * ratio, ratio].map(|s| s - before);
        for i in 0..self.f.len() {
            let start = if inside { from.value(i, -1.0) } else { 0.0 };
            let z = s.map(|s| from.value(i, s) - start);
            for r in 0..3 {
                self.z[r][i] = z[r];
                self.w[r][i] = T_INVERSE[r][0] * z[0] + T_INVERSE[r][1] * z[1] + T_INVERSE[r][2] * z[2];
            }
        }
    }

    /// Simplified Newton iterations on the transformed stages.
    pub(super) fn newton<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        Trial { t, end, h, x }: Trial<'_>,
        tolerance: f64,
    ) -> CallResult<Newton> {
        let n = x.len();
        self.guess_stages(h);
        self.fac_convergence = self.fac_convergence.max(U).powf(0.8);
        self.theta = KEEP_JACOBIAN;
        let (mut last_norm, mut last_quotient) = (0.0, 0.0);
        for count in 1..=MAX_NEWTON {
            equations.stats.newton_iterations += 1;
            equations.stats.linear_algebra += self.real.operations().1 + self.complex.operations().1;
            for (r, time) in [t + C1 * h, t + C2 * h, end].into_iter().enumerate() {
                for ((p, x), z) in self.stage_x.iter_mut().zip(x).zip(&self.z[r]) {
                    *p = x + z;
                }
                equations.derivatives(time, &self.stage_x, &mut self.stage_f[r])?;
            }
            self.solve_for_increment(h);
            let sum: f64 =
                self.stage_f.iter().map(|v| scaled_norm(v, &self.inverse)).map(|norm| norm * norm).sum();
            let norm = (sum / 3.0).sqrt();
            if !norm.is_finite() {
                return Err(CallError::Discard);
            }
            if count > 1 {
                let quotient: f64 = norm / last_norm;
                self.theta = if count == 2 { quotient } else { (quotient * last_quotient).sqrt() };
                last_quotient = quotient;
                if self.theta >= 0.99 {
                    return Ok(Newton::Failed(0.5));
                }
                self.fac_convergence = self.theta / (1.0 - self.theta);
                let left = (MAX_NEWTON - count) as i32;
                let predicted = self.fac_convergence * norm * self.theta.powi(left) / tolerance;
                if predicted >= 1.0 && self.fac_convergence * norm > tolerance {
                    let excess = predicted.clamp(1e-4, 20.0);
                    return Ok(Newton::Failed(0.8 * excess.powf(-1.0 / f64::from(4 + left))));
                }
            }
            last_norm = norm.max(U);
            for i in 0..n {
                let w: [f64; 3] = std::array::from_fn(|r| self.w[r][i] + self.stage_f[r][i]);
                for r in 0..3 {
                    self.w[r][i] = w[r];
                    self.z[r][i] = T[r][0] * w[0] + T[r][1] * w[1] + T[r][2] * w[2];
                }
            }
            if self.fac_convergence * norm <= tolerance {
                self.newton_count = count;
                return Ok(Newton::Converged);
            }
        }
        Ok(Newton::Failed(0.5))
    }

    /// Turns the right-hand sides of the stages into the increments of `w`, in place.
    fn solve_for_increment(&mut self, h: f64) {
        let n = self.f.len();
        let (gamma, alpha, beta) = (GAMMA / h, ALPHA / h, BETA / h);
        for i in 0..n {
            let f: [f64; 3] = std::array::from_fn(|r| self.stage_f[r][i]);
            for (r, stage) in self.stage_f.iter_mut().enumerate() {
                stage[i] = T_INVERSE[r][0] * f[0] + T_INVERSE[r][1] * f[1] + T_INVERSE[r][2] * f[2];
            }
        }
        for i in 0..n {
            let [w0, w1, w2] = self.mass_times_w(i);
            self.stage_f[0][i] -= gamma * w0;
            self.complex_rhs[i] = Complex::new(
                self.stage_f[1][i] - (alpha * w1 - beta * w2),
                self.stage_f[2][i] - (alpha * w2 + beta * w1),
            );
        }
        self.real.solve(&mut self.stage_f[0]);
        self.complex.solve(&mut self.complex_rhs);
        for i in 0..n {
            self.stage_f[1][i] = self.complex_rhs[i].re;
            self.stage_f[2][i] = self.complex_rhs[i].im;
        }
    }

    fn mass_times_w(&self, i: usize) -> [f64; 3] {
        match &self.mass {
            None => std::array::from_fn(|r| self.w[r][i]),
            Some(m) => {
                let n = self.f.len();
                std::array::from_fn(|r| (0..n).map(|k| m[i + n * k] * self.w[r][k]).sum())
            }
        }
    }
}
