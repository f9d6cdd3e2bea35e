//! The CMA-ES search that continues another search.

use super::CmaEs;
use super::state::CmaRules;
use crate::error::Error;
use crate::method_interface::interface::{Batch, Method, MethodDetails, Setup};
use crate::methods::shared::generations::Generations;
use crate::methods::shared::with_sizes::NeedsSizes;
use serde::{Deserialize, Serialize};

/// A CMA-ES search from the best point of another search.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct PopulationSearch {
    start: Vec<f64>,
    /// Number of batches and points before this search.
    n_batches: u64,
    n_points: u64,
    pub(crate) search: Generations<CmaRules>,
}

/// Returns the setup of a search from `x`. The space has no parameter that is the sine of its coordinate.
fn starting_at(setup: &Setup, x: &[f64]) -> Setup {
    let space = setup.space.without_sine().starting_at(x);
    let seed = Some(setup.seed.unwrap_or(0));
    Setup { space, seed, start_given: true, prior: Vec::new(), ..setup.clone() }
}

impl PopulationSearch {
    /// Starts from `x`, after the given number of batches and points.
    pub(crate) fn new(setup: &Setup, x: &[f64], (n_batches, n_points): (u64, u64)) -> Result<Self, Error> {
        let search = CmaEs::default().search(starting_at(setup, x))?;
        Ok(Self { start: x.to_vec(), n_batches, n_points, search })
    }

    pub(crate) fn is_sound(&self, setup: &Setup) -> bool {
        let (x, space) = (&self.start, &setup.space);
        x.len() == space.n()
            && x.iter().all(|v| v.is_finite())
            && space.bounds().contains(x)
            && self.search.is_sound(&starting_at(setup, x))
    }

    pub(crate) fn ask(&mut self, batch: &mut Batch) {
        self.search.ask(batch);
        batch.renumber(self.n_batches + batch.index(), self.n_points);
    }

    /// Returns the details of this search. Details that are not known yet come from the preceding search.
    pub(crate) fn details(&self, before: MethodDetails<'static>) -> MethodDetails<'_> {
        let current = self.search.details();
        MethodDetails {
            n_iterations: before.n_iterations + current.n_iterations,
            operation: current.operation.or(before.operation),
            tests: current.tests.or(before.tests),
            roughness: before.roughness,
            handed_over: before.roughness.map(|_| (self.n_points, self.search.name())),
            ..current
        }
    }
}
