//! Detection of noise and kinks in the model, and the hand-over to a simplex search or to CMA-ES.

use super::inverse::median;
use super::iteration::{FAR, MOST_REFUSED, norm};
use super::state::{ModelSearch, Phase};
use crate::method_interface::interface::Roughness;
use crate::methods::cma_es::{CmaEs, PopulationSearch};
use crate::methods::nelder_mead::{NelderMead, SimplexSearch};
use crate::methods::shared::cost::Cost;

/// Ratio of the larger extent whose curvature is compared: two reductions of the resolution.
const WIDER: f64 = 25.0;
/// Minimum exponent of 1/extent with which the curvature grows at a kink. The exponent is 1 at a kink, 2 for
/// noise and 0 for a smooth cost. Chosen with `benches/choice.rs` at seed 0, checked with seeds 1 to 5.
const GROWTH: f64 = 0.5;
/// Factor by which the slope error, in units of the extent, must have grown between two consecutive failed
/// steps.
const GROWN: f64 = 2.0;
/// Minimum length within which noise hides the curvature if CMA-ES is to continue, in units of the first
/// radius. This and the next two constants were tuned with the sets with kinks and with noise of
/// `benches/choice.rs` at seed 0 and other smooth functions with noise, and checked with seeds 1 to 3.
const HIDDEN: f64 = 0.2;
/// Factor by which the change of slope must exceed all earlier ones to be noise.
const BENT: f64 = 3.0;
/// Number of further resolutions after which a change of slope that has not grown is a kink.
const MOST_UNDECIDED: usize = 2;
/// Minimum significant change of the cost due to curvature within rho, as a fraction of the cost.
const VISIBLE: f64 = 1e3 * f64::EPSILON;

impl ModelSearch {
    /// Returns the median distance of the points of the model from the best one, in units of the parameter
    /// sizes. This is the scale on which the model represents the cost. It may be far above the resolution.
    pub(super) fn extent(&self) -> f64 {
        let (base, points) = (self.points.u(self.base()), &self.points);
        let with_cost = (0..points.len()).filter(|&slot| points.cost(slot).value().is_some());
        median(with_cost.map(|slot| norm(&self.displacement(base, points.u(slot)))))
    }

    /// Counts a failed step among near points if the slope error of the model, in units of the extent, has
    /// grown. The error decreases with the extent for smooth costs, and grows at kinks and with noise. At a
    /// minimum, no step can succeed, so only the error is evidence.
    fn judge_refusal(&mut self, extent: f64) {
        let Some(error) = self.refused.filter(|_| extent <= FAR * self.rho) else { return };
        let bend = error / extent;
        self.n_refused += usize::from(bend >= GROWN * self.largest_bend);
        self.largest_bend = self.largest_bend.max(bend);
    }

    /// Detects noise and kinks when a resolution is exhausted. At a kink, the curvature of the model reflects
    /// the change of slope among its points and grows with 1/extent. The contribution of noise grows with
    /// 1/extent^2. Failed steps are ignored if the points are far away, because the model may then be
    /// inaccurate within the resolution.
    pub(super) fn look_for_roughness(&mut self) -> Option<Roughness> {
        let extent = self.extent();
        self.judge_refusal(extent);
        let curvature = self.model.hessian.iter().map(|h| h * h).sum::<f64>().sqrt();
        let refused = self.n_refused >= MOST_REFUSED;
        // If all costs within the radius are equal, the tests are meaningless.
        let mut found = (refused || self.is_flat()).then_some(Roughness::RefusedSteps);
        let wider = self.curvatures.iter().rev().find(|(wider, _)| *wider >= WIDER * extent).copied();
        if let Some((wider, least)) = wider {
            let f = self.points.cost(self.points.best()).value().map_or(0.0, f64::abs);
            let grown = curvature > least * (wider / extent).powf(GROWTH);
            if grown && least > 0.0 && curvature * self.rho * self.rho > VISIBLE * f {
                found = Some(Roughness::Curvature);
            }
        }
        self.curvatures.push((extent, curvature));
        found
    }

    /// True if all points have the same cost.
    pub(super) fn is_flat(&self) -> bool {
        let f = self.points.cost(self.points.best()).value();
        (0..self.points.len()).all(|slot| self.points.cost(slot).value() == f)
    }

    /// True if noise or steps hide the curvature of the cost, `None` if this is undecided. The change of the
    /// cost by its own curvature, the smallest since the start, exceeds the change by noise only beyond a
    /// length, which must be a large part of the first radius. A kink without curvature has this property,
    /// too. But the change of slope at a kink is independent of the extent, whereas noise changes the slope
    /// with 1/extent. If the change of slope has not grown, two more resolutions decide.
    fn hides_curvature(&self) -> Option<bool> {
        let (&(extent, curvature), before) = self.curvatures.split_last()?;
        if self.is_flat() {
            return Some(true);
        }
        let each = self.curvatures.iter().map(|(_, curvature)| *curvature).filter(|c| *c > 0.0);
        let least = each.fold(f64::INFINITY, f64::min);
        let bend = before.iter().map(|(extent, curvature)| extent * curvature).fold(0.0, f64::max);
        if extent * (curvature / least).sqrt() <= HIDDEN * self.radius {
            Some(false)
        } else if extent * curvature > BENT * bend {
            Some(true)
        } else {
            (self.n_undecided >= MOST_UNDECIDED).then_some(false)
        }
    }

    /// Starts CMA-ES from the best point if the curvature is hidden, otherwise a simplex search. Returns
    /// false if this is not possible or undecided.
    pub(super) fn hand_over(&mut self) -> bool {
        let best = self.points.best();
        let (start, cost) = (self.points.x(best).to_vec(), self.points.cost(best));
        let (n_batches, n_points) = self.rounds.counts();
        let Some(hidden) = self.hides_curvature() else {
            self.n_undecided += 1;
            return false;
        };
        if hidden {
            if !self.is_supported_by(&CmaEs::default()) {
                return false;
            }
            let search = PopulationSearch::new(&self.setup, &start, (n_batches, n_points));
            let Ok(search) = search else { return false };
            (self.population, self.phase) = (Some(Box::new(search)), Phase::HandedOver);
            return true;
        }
        if !self.is_supported_by(&NelderMead::default()) {
            return false;
        }
        let simplex = SimplexSearch::new(&NelderMead::default(), &self.setup, &start, n_batches, n_points);
        let (Ok(mut simplex), Cost::Value(cost)) = (simplex, cost) else { return false };
        simplex.state.set_start_cost(cost, self.f_0);
        simplex.state.expect_kinks();
        (self.simplex, self.phase) = (Some(simplex), Phase::HandedOver);
        true
    }
}
