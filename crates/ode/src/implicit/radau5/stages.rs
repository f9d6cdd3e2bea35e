//! The equations of the stages. The transformation by `T` separates them into a real and a complex block of
//! the size of the system.

use super::super::newton::Iteration;
use super::coefficients::{ALPHA, BETA, C1, C2, GAMMA, T, T_INVERSE};
use super::dense::Collocation;
use crate::error_norm::scaled_norm;
use crate::jacobian::Jacobian;
use crate::lu::Lu;
use crate::stats::Stats;
use crate::stepper::{Equations, Trial};
use crate::system::CallResult;
use num_complex::Complex;

/// The increments of the stages and their matrices.
#[derive(Debug, Default)]
pub(super) struct Stages {
    pub(super) mass: Option<Vec<f64>>,
    pub(super) real: Lu<f64>,
    pub(super) complex: Lu<Complex<f64>>,
    pub(super) z: [Vec<f64>; 3],
    pub(super) w: [Vec<f64>; 3],
    pub(super) f: [Vec<f64>; 3],
    pub(super) point: Vec<f64>,
    pub(super) complex_rhs: Vec<Complex<f64>>,
}

impl Stages {
    pub(super) fn decompose(&mut self, jacobian: &Jacobian, h: f64, stats: &mut Stats) -> bool {
        let (j, mass) = (&jacobian.values, self.mass.as_deref());
        let m = |p: usize, on_diagonal: bool| match mass {
            Some(m) => m[p],
            None => f64::from(on_diagonal),
        };
        let (gamma, eigen) = (GAMMA / h, Complex::new(ALPHA / h, BETA / h));
        stats.decompositions += 2;
        stats.linear_algebra += self.real.operations().0 + self.complex.operations().0;
        self.real.decompose(|p, d| gamma * m(p, d) - j[p])
            && self.complex.decompose(|p, d| eigen * m(p, d) - Complex::new(j[p], 0.0))
    }

    /// Fills in the initial stage increments of a step of size `h`. They are extrapolated from the last step,
    /// or from a longer one from this point. Without either, they are zero.
    pub(super) fn guess(&mut self, h: f64, last: Option<&Collocation>, longer: Option<&Collocation>) {
        // Positions are counted from the end of the step used.
        let Some((from, before)) = longer.map(|c| (c, 1.0)).or(last.map(|c| (c, 0.0))) else {
            self.z.iter_mut().chain(&mut self.w).for_each(|v| v.fill(0.0));
            return;
        };
        let ratio = h / from.h();
        let s = [C1 * ratio, C2 * ratio, ratio].map(|s| s - before);
        for i in 0..self.point.len() {
            let start = if longer.is_some() { from.value(i, -1.0) } else { 0.0 };
            let z = s.map(|s| from.value(i, s) - start);
            for r in 0..3 {
                self.z[r][i] = z[r];
                self.w[r][i] = T_INVERSE[r][0] * z[0] + T_INVERSE[r][1] * z[1] + T_INVERSE[r][2] * z[2];
            }
        }
    }

    /// Replaces the right-hand sides of the stages by the increments of `w`, in place.
    fn solve_for_increment(&mut self, h: f64) {
        let n = self.point.len();
        let (gamma, alpha, beta) = (GAMMA / h, ALPHA / h, BETA / h);
        for i in 0..n {
            let f: [f64; 3] = std::array::from_fn(|r| self.f[r][i]);
            for (r, stage) in self.f.iter_mut().enumerate() {
                stage[i] = T_INVERSE[r][0] * f[0] + T_INVERSE[r][1] * f[1] + T_INVERSE[r][2] * f[2];
            }
        }
        for i in 0..n {
            let [w0, w1, w2] = self.mass_times_w(i);
            self.f[0][i] -= gamma * w0;
            self.complex_rhs[i] = Complex::new(
                self.f[1][i] - (alpha * w1 - beta * w2),
                self.f[2][i] - (alpha * w2 + beta * w1),
            );
        }
        self.real.solve(&mut self.f[0]);
        self.complex.solve(&mut self.complex_rhs);
        for i in 0..n {
            self.f[1][i] = self.complex_rhs[i].re;
            self.f[2][i] = self.complex_rhs[i].im;
        }
    }

    fn mass_times_w(&self, i: usize) -> [f64; 3] {
        match &self.mass {
            None => std::array::from_fn(|r| self.w[r][i]),
            Some(m) => {
                let n = self.point.len();
                std::array::from_fn(|r| (0..n).map(|k| m[i + n * k] * self.w[r][k]).sum())
            }
        }
    }
}

/// The equations of a trial, with the inverse weights of its norm.
pub(super) struct StageEquations<'a> {
    pub(super) stages: &'a mut Stages,
    pub(super) trial: Trial<'a>,
    pub(super) inverse: &'a [f64],
}

impl Iteration for StageEquations<'_> {
    fn solve(&mut self, equations: &mut Equations<'_>, _: bool) -> CallResult<f64> {
        let (stages, Trial { t, end, h, x }) = (&mut *self.stages, self.trial);
        equations.stats.linear_algebra += stages.real.operations().1 + stages.complex.operations().1;
        for (r, time) in [t + C1 * h, t + C2 * h, end].into_iter().enumerate() {
            for ((p, x), z) in stages.point.iter_mut().zip(x).zip(&stages.z[r]) {
                *p = x + z;
            }
            equations.derivatives(time, &stages.point, &mut stages.f[r])?;
        }
        stages.solve_for_increment(h);
        let sum: f64 = stages.f.iter().map(|v| scaled_norm(v, self.inverse)).map(|norm| norm * norm).sum();
        Ok((sum / 3.0).sqrt())
    }

    fn advance(&mut self) {
        let Stages { z, w, f, point, .. } = &mut *self.stages;
        for i in 0..point.len() {
            let sum: [f64; 3] = std::array::from_fn(|r| w[r][i] + f[r][i]);
            for r in 0..3 {
                w[r][i] = sum[r];
                z[r][i] = T[r][0] * sum[0] + T[r][1] * sum[1] + T[r][2] * sum[2];
            }
        }
    }
}
