//! Where noise and kinks show in the model, and what follows from them.

use super::state::{Phase, QuadraticModelState};
use crate::error::Error;
use crate::method::interface::Roughness;
use crate::methods::nelder_mead::{NelderMead, SimplexSearch};
use crate::methods::shared::cost::Cost;

/// Resolutions in a row at which steps failed: then there is noise, or a kink.
pub(super) const MOST_REFUSED: usize = 4;
/// The curvature is compared with that of so many resolutions before.
const RESOLUTIONS: usize = 2;
/// The least power of 1/rho with which it grows at a kink (there it is 1, at noise 2, where the cost is
/// smooth 0). Like the number of resolutions chosen with `benches/choice.rs` at seed 0, and looked at with
/// seeds 1 and 2.
const GROWTH: f64 = 0.5;
/// Least change of the cost by the curvature within rho that counts, as a share of the cost.
const VISIBLE: f64 = 1e3 * f64::EPSILON;

impl QuadraticModelState {
    /// A simplex search from the start where nothing tells the size of a parameter: it looks for sizes.
    pub(super) fn begin_with_simplex(&mut self) -> Result<(), Error> {
        let space = &self.setup.space;
        if self.hand_over && (0..space.n_free()).any(|k| space.size_is_unknown(k)) {
            self.simplex = Some(SimplexSearch::new(&NelderMead::default(), &self.setup, space.x0(), (0, 0))?);
            self.phase = Phase::HandedOver;
        }
        Ok(())
    }

    /// Looks for noise and kinks when a resolution is exhausted. Where the cost has kinks the model bends as
    /// much as the slope changes within its region, so that its curvature grows with 1/rho; what noise adds
    /// to it grows with 1/rho^2.
    pub(super) fn look_for_roughness(&mut self) {
        let curvature = self.model.hessian.iter().map(|h| h * h).sum::<f64>().sqrt();
        self.curvatures.push((self.rho, curvature));
        let refused = self.n_refused >= MOST_REFUSED;
        // Where nothing is seen within the radius the tests mean nothing.
        self.roughness = (refused || self.is_flat()).then_some(Roughness::RefusedSteps);
        let Some(before) = self.curvatures.len().checked_sub(RESOLUTIONS + 1) else { return };
        let (rho, least) = self.curvatures[before];
        let f = self.points.cost(self.points.best()).value().map_or(0.0, f64::abs);
        let grown = curvature > least * (rho / self.rho).powf(GROWTH);
        if grown && least > 0.0 && curvature * self.rho * self.rho > VISIBLE * f {
            self.roughness = Some(Roughness::Curvature);
        }
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
        let simplex = SimplexSearch::new(&NelderMead::default(), &self.setup, &start, self.rounds.counts());
        let (Ok(mut simplex), Cost::Value(cost)) = (simplex, cost) else { return false };
        simplex.state.set_start_cost(cost);
        (self.simplex, self.phase) = (Some(simplex), Phase::HandedOver);
        true
    }
}
