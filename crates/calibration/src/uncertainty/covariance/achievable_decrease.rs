//! Relative decrease of the cost by one more least-squares step, as confirmed by simulations.

use crate::cost::residual::sum_of_squares;
use crate::error::CalibrationError;
use crate::loaded::budget::Extra;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::parameter::{Parameter, inner, outer};
use crate::uncertainty::covariance::matrix::Factors;
use crate::uncertainty::row_blocks::along;
use nalgebra::DVector;

/// Decrease of the cost below which a least-squares step is negligible. A step shorter than a standard error
/// is negligible too.
const LEAST_GAIN: f64 = 0.01;

/// Step relative to the size of a parameter below which a step is negligible: the default `x_tol` of a fit.
const SHORTEST: f64 = 1e-4;

/// Parts of the step to simulate, in this order, until one decreases the cost. In a curved valley, the first
/// ones lead out of the valley.
const PARTS: [f64; 3] = [1.0, 0.25, 1.0 / 16.0];

/// Possible decrease of the cost at a point.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Gain {
    /// Decrease relative to the cost: as simulated, or as predicted if no part of the step can be simulated.
    pub(crate) part: f64,
    /// True if no part of the step can be simulated.
    pub(crate) is_at_failures: bool,
}

/// A point and the effect of its free parameters on its cost.
pub(crate) struct At<'a> {
    pub(crate) parameters: &'a [Parameter],
    pub(crate) x: &'a [f64],
    pub(crate) free: &'a [usize],
    /// Sizes of the free parameters used by the search.
    pub(crate) sizes: &'a [f64],
    pub(crate) factors: &'a Factors,
    /// Residuals from which the factors were computed.
    pub(crate) residuals: &'a [f64],
}

impl At<'_> {
    /// Returns the relative decrease of the cost by the step to the minimum of the linear model. It is first
    /// predicted and, if it exceeds the noise, simulated. A decrease that no simulation confirms is zero. If
    /// the budget skips the shorter steps, the decrease is zero too.
    pub(crate) fn achievable_decrease(
        &self,
        cost: &dyn Fn(&[f64]) -> f64,
        cost_of_fit: f64,
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
            let part = (cost_of_fit - cost(&residuals)) / cost_of_fit.abs().max(f64::MIN_POSITIVE);
            if part > LEAST_GAIN {
                return Ok(Gain { part, is_at_failures });
            }
        }
        let part = if is_at_failures { (gained / all).min(1.0) } else { 0.0 };
        Ok(Gain { part, is_at_failures })
    }

    /// Returns the point at a part of a step in the coordinates of the search, inside the bounds.
    fn moved(&self, step: &DVector<f64>, part: f64) -> Vec<f64> {
        let mut x = self.x.to_vec();
        for (k, &i) in self.free.iter().enumerate() {
            let p = &self.parameters[i];
            x[i] = outer(p, inner(p, x[i]) + part * step[k]).clamp(p.search_lower(), p.search_upper());
        }
        x
    }
}
