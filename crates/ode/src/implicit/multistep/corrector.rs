//! The equation of the corrector.

use super::left_side::LeftSide;
use crate::error_norm::scaled_norm;
use crate::implicit::newton::Iteration;
use crate::lu::Lu;
use crate::stepper::{Equations, Point};
use crate::system::CallResult;

/// Current iterate of the corrector.
#[derive(Debug, Default)]
pub(super) struct Iterate {
    /// The sum of the corrections, `e`.
    pub(super) correction: Vec<f64>,
    /// States and slopes with the correction, and the residual there.
    pub(super) x: Vec<f64>,
    pub(super) slopes: Vec<f64>,
    pub(super) rhs: Vec<f64>,
    pub(super) increment: Vec<f64>,
}

impl Iterate {
    pub(super) fn vectors(&mut self) -> [&mut Vec<f64>; 5] {
        let Self { correction, x, slopes, rhs, increment } = self;
        [correction, x, slopes, rhs, increment]
    }
}

/// The equation of the corrector, `G(e) = 0`.
pub(super) struct Corrector<'a> {
    /// The decomposed matrix; `None` if the increment is the residual.
    pub(super) lu: Option<&'a Lu<f64>>,
    pub(super) left: &'a LeftSide,
    /// The prediction.
    pub(super) z: &'a [Vec<f64>],
    pub(super) end: f64,
    pub(super) gamma: f64,
    pub(super) share: f64,
    pub(super) relaxation: f64,
    pub(super) inverse: &'a [f64],
    pub(super) iterate: &'a mut Iterate,
}

impl Iteration for Corrector<'_> {
    fn solve(&mut self, equations: &mut Equations<'_>, is_first: bool) -> CallResult<f64> {
        equations.stats.linear_algebra += self.lu.map_or(0, |lu| lu.operations().1);
        let Self { gamma, share, .. } = *self;
        let Iterate { correction, x, slopes, rhs, increment } = &mut *self.iterate;
        let is_identity = self.left.is_identity();
        if !is_first {
            for (i, e) in correction.iter().enumerate() {
                x[i] = self.z[0][i] + e;
                if !is_identity {
                    slopes[i] = (share * self.z[1][i] + e) / gamma;
                }
            }
            self.left.defect(equations, Point { t: self.end, x, slopes }, rhs)?;
        }
        for (i, b) in increment.iter_mut().enumerate() {
            *b = gamma * rhs[i];
            if is_identity {
                *b = *b - share * self.z[1][i] - correction[i];
            }
        }
        if let Some(lu) = self.lu {
            lu.solve(increment);
        }
        if self.relaxation != 1.0 {
            increment.iter_mut().for_each(|v| *v *= self.relaxation);
        }
        Ok(scaled_norm(increment, self.inverse))
    }

    fn advance(&mut self) {
        let Iterate { correction, increment, .. } = &mut *self.iterate;
        correction.iter_mut().zip(increment).for_each(|(e, d)| *e += *d);
    }
}
