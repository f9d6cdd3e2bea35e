//! The part of the cost that one more step of least squares takes away, as simulations of that step tell.

use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::loaded::budget::Extra;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::parameter::{Parameter, inner, outer};
use crate::uncertainty::covariance::matrix::Factors;
use crate::uncertainty::row_blocks::along;
use nalgebra::DVector;

/// A step of least squares that takes away less than this part of the cost, or is shorter than a standard
/// error, is none.
const LEAST_GAIN: f64 = 0.01;

/// Nor is one that moves no parameter by this part of its size: the default `x_tol` of a fit.
const SHORTEST: f64 = 1e-4;

/// Parts of the step that are simulated, one after the other, until one gains: along a curved valley the
/// first ones lead out of it.
const PARTS: [f64; 3] = [1.0, 0.25, 1.0 / 16.0];

/// What is left to gain at a point.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Gain {
    /// Part of the cost, as simulated, or as predicted where no part of the step can be simulated.
    pub(crate) part: f64,
    /// No part of the step can be simulated.
    pub(crate) is_at_failures: bool,
}

/// A point with what its free parameters do to its cost.
pub(crate) struct At<'a> {
    pub(crate) parameters: &'a [Parameter],
    pub(crate) x: &'a [f64],
    pub(crate) free: &'a [usize],
    /// Sizes of these parameters, as the search knows them.
    pub(crate) sizes: &'a [f64],
    pub(crate) factors: &'a Factors,
    /// The residuals that the factors are of.
    pub(crate) residuals: &'a [f64],
}

impl At<'_> {
    /// The part of the cost that the step to the minimum of the linear model takes away: predicted, and where
    /// that is more than noise, simulated; what the budget leaves out of the shorter ones is no gain. A gain
    /// that no simulation confirms is none.
    pub(crate) fn left_to_gain(
        &self,
        cost: &dyn Fn(&[f64]) -> f64,
        known_cost: f64,
        simulations: &mut Simulations<'_>,
    ) -> Result<Gain, CalibrationError> {
        let along = along(&self.factors.base, self.residuals, &simulations.context)?;
        let (all, gained) = (sum_of_squares(self.residuals), along.norm_squared());
        let degrees = self.residuals.len().saturating_sub(self.factors.base.ncols()) as f64;
        let is_step = gained > LEAST_GAIN * all && gained * degrees > (all - gained).max(0.0);
        let step = -(&self.factors.inverse * along);
        let is_long = step.iter().zip(self.sizes).any(|(step, size)| step.abs() > SHORTEST * size);
        if !(is_step && is_long) {
            return Ok(Gain::default());
        }
        let mut is_at_failures = true;
        for part in PARTS {
            let point = [Point::new(self.moved(&step, part))];
            let found = match is_at_failures {
                true => Some(simulations.beside(&point)?),
                false => simulations.extra(Extra::ShorterSteps, &point)?,
            };
            let Some(mut found) = found else { return Ok(Gain::default()) };
            let Ok(residuals) = found.swap_remove(0) else { continue };
            is_at_failures = false;
            let part = (known_cost - cost(&residuals)) / known_cost.abs().max(f64::MIN_POSITIVE);
            if part > LEAST_GAIN {
                return Ok(Gain { part, is_at_failures });
            }
        }
        let part = if is_at_failures { (gained / all).min(1.0) } else { 0.0 };
        Ok(Gain { part, is_at_failures })
    }

    /// The point at a part of a step in the coordinates of the search, inside of the bounds.
    fn moved(&self, step: &DVector<f64>, part: f64) -> Vec<f64> {
        let mut x = self.x.to_vec();
        for (k, &i) in self.free.iter().enumerate() {
            let p = &self.parameters[i];
            x[i] = outer(p, inner(p, x[i]) + part * step[k]).clamp(p.lower(), p.upper());
        }
        x
    }
}
