//! Where noise and kinks show in the model, and what follows from them.

use super::inverse::median;
use super::iteration::{FAR, MOST_REFUSED, norm};
use super::state::{ModelSearch, Phase};
use crate::method_interface::interface::Roughness;
use crate::methods::nelder_mead::{NelderMead, SimplexSearch};
use crate::methods::shared::cost::Cost;

/// The curvature is compared with that of an extent so many times as large: two reductions of the resolution.
const WIDER: f64 = 25.0;
/// The least power of 1/extent with which it grows at a kink (there it is 1, at noise 2, where the cost is
/// smooth 0). Chosen with `benches/choice.rs` at seed 0, looked at with seeds 1 to 5.
const GROWTH: f64 = 0.5;
/// Of two failed steps in a row the error of the slope, in units of the extent, has grown by this factor.
const GROWN: f64 = 2.0;
/// Least change of the cost by the curvature within rho that counts, as a share of the cost.
const VISIBLE: f64 = 1e3 * f64::EPSILON;

impl ModelSearch {
    /// The median distance of the points of the model from the best one, in units of the sizes: the scale on
    /// which it knows the cost, which may be far above the resolution.
    pub(super) fn extent(&self) -> f64 {
        let (base, points) = (self.points.u(self.base()), &self.points);
        let known = (0..points.len()).filter(|&slot| points.cost(slot).value().is_some());
        median(known.map(|slot| norm(&self.displacement(base, points.u(slot)))))
    }

    /// Counts a step that failed among near points if the error of the model's slope, in units of the extent,
    /// has grown: it falls with the extent where the cost is smooth and grows at kinks and with noise. At a
    /// minimum no step can succeed, and the error alone tells.
    fn judge_refusal(&mut self, extent: f64) {
        let Some(error) = self.refused.filter(|_| extent <= FAR * self.rho) else { return };
        let bend = error / extent;
        self.n_refused += usize::from(bend >= GROWN * self.largest_bend);
        self.largest_bend = self.largest_bend.max(bend);
    }

    /// Looks for noise and kinks when a resolution is exhausted. Where the cost has kinks the model bends as
    /// much as the slope changes among its points, so that its curvature grows with 1/extent; what noise adds
    /// to it grows with 1/extent^2. Steps that fail while the points lie far off say nothing of the cost: the
    /// model need not be right within the resolution.
    pub(super) fn look_for_roughness(&mut self) -> Option<Roughness> {
        let extent = self.extent();
        self.judge_refusal(extent);
        let curvature = self.model.hessian.iter().map(|h| h * h).sum::<f64>().sqrt();
        let refused = self.n_refused >= MOST_REFUSED;
        // Where nothing is seen within the radius the tests mean nothing.
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

    /// All points have one cost: of these none is better than another.
    pub(super) fn is_flat(&self) -> bool {
        let f = self.points.cost(self.points.best()).value();
        (0..self.points.len()).all(|slot| self.points.cost(slot).value() == f)
    }

    /// A simplex search takes over from the best point; false where none can.
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
