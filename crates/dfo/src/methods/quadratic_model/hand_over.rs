//! Where noise and kinks show in the model, and the simplex search that takes over there.

use super::state::{Phase, QuadraticModelState};
use crate::error::Error;
use crate::method::{Batch, Details, Method, MethodOptions, Roughness, Setup};
use crate::methods::nelder_mead::{NelderMead, NelderMeadState};
use crate::methods::shared::cost::Cost;
use serde::{Deserialize, Serialize};

/// Resolutions in a row at which steps failed: then there is noise, or a kink.
const MOST_REFUSED: usize = 4;
/// The curvature is compared with that of so many resolutions before.
const RESOLUTIONS: usize = 2;
/// The least power of 1/rho with which it grows at a kink (there it is 1, at noise 2, where the cost is smooth 0). Like the number of
/// resolutions chosen with `benches/choice.rs` at seed 0, and looked at with seeds 1 and 2.
const GROWTH: f64 = 0.5;
/// What the curvature changes in the cost within rho is seen only from so many times the rounding of the cost on.
const VISIBLE: f64 = 1e3 * f64::EPSILON;

/// The simplex search that has taken over.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Simplex {
    /// Where it started from.
    start: Vec<f64>,
    /// Batches and points before it.
    n_batches: u64,
    n_points: u64,
    pub(super) state: NelderMeadState,
}

impl Simplex {
    fn new(setup: &Setup, start: &[f64], (n_batches, n_points): (u64, u64)) -> Result<Self, Error> {
        let state = NelderMead::default().begin(&starting_at(setup, start))?;
        Ok(Self { start: start.to_vec(), n_batches, n_points, state })
    }

    pub(super) fn is_sound(&self, setup: &Setup) -> bool {
        let space = &setup.space;
        self.start.len() == space.n()
            && self.start.iter().all(|v| v.is_finite())
            && space.bounds().contains(&self.start)
            && self.state.is_sound(&NelderMead::default().prepared(&starting_at(setup, &self.start)))
    }

    pub(super) fn ask(&mut self, batch: &mut Batch) {
        self.state.ask(batch);
        batch.renumber(self.n_batches + batch.index(), self.n_points);
    }

    /// Where the simplex stands; what it does not know of itself yet comes from the search before.
    pub(super) fn details(&self, before: Details<'static>) -> Details<'_> {
        let own = self.state.details();
        Details {
            n_iterations: before.n_iterations + own.n_iterations,
            operation: own.operation.or(before.operation),
            tests: own.tests.or(before.tests),
            roughness: before.roughness,
            handed_over: before.roughness.map(|_| self.n_points),
            ..own
        }
    }
}

/// The same problem from another start.
fn starting_at(setup: &Setup, x: &[f64]) -> Setup {
    Setup { space: setup.space.starting_at(x), ..setup.clone() }
}

impl QuadraticModelState {
    /// A simplex search from the start where nothing tells the size of a parameter: it looks for sizes.
    pub(super) fn begin_with_simplex(&mut self) -> Result<(), Error> {
        let space = &self.setup.space;
        if self.hand_over && (0..space.n_free()).any(|k| space.size_is_unknown(k)) {
            self.simplex = Some(Simplex::new(&self.setup, space.x0(), (0, 0))?);
            self.phase = Phase::HandedOver;
        }
        Ok(())
    }

    /// Looks for noise and kinks when a resolution is exhausted. Where the cost has kinks the model bends as much as the slope
    /// changes within its region, so that its curvature grows with 1/rho; what noise adds to it grows with 1/rho^2.
    pub(super) fn look_for_roughness(&mut self) {
        let curvature = self.model.hessian.iter().map(|h| h * h).sum::<f64>().sqrt();
        self.curvatures.push((self.rho, curvature));
        self.roughness = (self.n_refused >= MOST_REFUSED).then_some(Roughness::RefusedSteps);
        let Some(before) = self.curvatures.len().checked_sub(RESOLUTIONS + 1) else { return };
        let (rho, least) = self.curvatures[before];
        let f = self.points.cost(self.points.best()).value().map_or(0.0, f64::abs);
        let grown = curvature > least * (rho / self.rho).powf(GROWTH);
        if grown && least > 0.0 && curvature * self.rho * self.rho > VISIBLE * f {
            self.roughness = Some(Roughness::Curvature);
        }
    }

    /// A simplex search takes over from the best point; false where none can.
    pub(super) fn hand_over(&mut self) -> bool {
        let best = self.points.best();
        let (start, cost) = (self.points.x(best).to_vec(), self.points.cost(best));
        let simplex = Simplex::new(&self.setup, &start, self.rounds.counts());
        let (Ok(mut simplex), Cost::Value(cost)) = (simplex, cost) else { return false };
        simplex.state.set_start_cost(cost);
        (self.simplex, self.phase) = (Some(simplex), Phase::HandedOver);
        true
    }
}
