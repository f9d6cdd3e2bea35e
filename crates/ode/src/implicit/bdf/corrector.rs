//! The equation of the corrector.

use super::left_side::LeftSide;
use crate::control::scaled_norm;
use crate::implicit::newton::Iteration;
use crate::lu::Lu;
use crate::stepper::Equations;
use crate::system::{CallResult, HybridSystem};

/// The equation of the corrector, `G(e) = 0`.
pub(super) struct Corrector<'a> {
    pub(super) lu: &'a Lu<f64>,
    pub(super) left: &'a LeftSide,
    /// The prediction.
    pub(super) z: &'a [Vec<f64>],
    pub(super) end: f64,
    pub(super) gamma: f64,
    pub(super) share: f64,
    pub(super) relaxation: f64,
    pub(super) inverse: &'a [f64],
    pub(super) x: &'a mut [f64],
    pub(super) slopes: &'a mut [f64],
    pub(super) rhs: &'a mut [f64],
    pub(super) increment: &'a mut [f64],
    pub(super) correction: &'a mut [f64],
}

impl Iteration for Corrector<'_> {
    fn solve<S: HybridSystem + ?Sized>(
        &mut self,
        equations: &mut Equations<'_, S>,
        is_first: bool,
    ) -> CallResult<f64> {
        equations.stats.linear_algebra += self.lu.operations().1;
        let Self { gamma, share, .. } = *self;
        if !is_first {
            for (i, x) in self.x.iter_mut().enumerate() {
                *x = self.z[0][i] + self.correction[i];
                self.slopes[i] = (share * self.z[1][i] + self.correction[i]) / gamma;
            }
            self.left.defect(equations, (self.end, self.x, self.slopes), self.rhs)?;
        }
        let is_identity = self.left.is_identity();
        for (i, b) in self.increment.iter_mut().enumerate() {
            *b = gamma * self.rhs[i];
            if is_identity {
                *b = *b - share * self.z[1][i] - self.correction[i];
            }
        }
        self.lu.solve(self.increment);
        if self.relaxation != 1.0 {
            self.increment.iter_mut().for_each(|v| *v *= self.relaxation);
        }
        Ok(scaled_norm(self.increment, self.inverse))
    }

    fn advance(&mut self) {
        self.correction.iter_mut().zip(&*self.increment).for_each(|(e, d)| *e += d);
    }
}
