//! The simplex search that continues if a model is not usable.

use super::{NelderMead, NelderMeadState};
use crate::error::Error;
use crate::method_interface::interface::{Batch, Method, MethodDetails, MethodOptions, Setup};
use serde::{Deserialize, Serialize};

/// A simplex search that continues another search.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SimplexSearch {
    /// Start point of the simplex search.
    pub(crate) start: Vec<f64>,
    /// Number of batches and points before the simplex search.
    n_batches: u64,
    n_points: u64,
    pub(crate) state: NelderMeadState,
}

impl SimplexSearch {
    pub(crate) fn new(
        method: &NelderMead,
        setup: &Setup,
        start: &[f64],
        n_batches: u64,
        n_points: u64,
    ) -> Result<Self, Error> {
        let state = method.begin(&starting_at(setup, start))?;
        Ok(Self { start: start.to_vec(), n_batches, n_points, state })
    }

    pub(crate) fn is_sound(&self, method: &NelderMead, setup: &Setup) -> bool {
        let space = &setup.space;
        self.start.len() == space.n()
            && self.start.iter().all(|v| v.is_finite())
            && space.bounds().contains(&self.start)
            && self.state.is_sound(&method.prepared(&starting_at(setup, &self.start)))
    }

    pub(crate) fn ask(&mut self, batch: &mut Batch) {
        self.state.ask(batch);
        batch.renumber(self.n_batches + batch.index(), self.n_points);
    }

    /// Returns the details of the simplex search. Details that are not known yet come from the preceding
    /// search.
    pub(crate) fn details(&self, before: MethodDetails<'static>) -> MethodDetails<'_> {
        let of_simplex = self.state.details();
        MethodDetails {
            n_iterations: before.n_iterations + of_simplex.n_iterations,
            operation: of_simplex.operation.or(before.operation),
            tests: of_simplex.tests.or(before.tests),
            roughness: before.roughness,
            handed_over: before.roughness.map(|_| (self.n_points, self.state.name())),
            ..of_simplex
        }
    }
}

/// Returns the setup with another start point.
fn starting_at(setup: &Setup, x: &[f64]) -> Setup {
    Setup { space: setup.space.starting_at(x), ..setup.clone() }
}
