//! Detection of noise and kinks in the model, and the hand-over to a simplex search.

use super::inverse::median;
use super::iteration::{FAR, MOST_REFUSED, norm};
use super::state::{ModelSearch, Phase};
use crate::method_interface::interface::Roughness;
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

    /// Starts a simplex search from the best point. Returns false if this is not possible.
    pub(super) fn hand_over(&mut self) -> bool {
        let best = self.points.best();
        let (start, cost) = (self.points.x(best).to_vec(), self.points.cost(best));
        let (n_batches, n_points) = self.rounds.counts();
        let simplex = SimplexSearch::new(&NelderMead::default(), &self.setup, &start, n_batches, n_points);
        let (Ok(mut simplex), Cost::Value(cost)) = (simplex, cost) else { return false };
        simplex.state.set_start_cost(cost, self.f_0);
        simplex.state.expect_kinks();
        (self.simplex, self.phase) = (Some(simplex), Phase::HandedOver);
        true
    }
}
