//! A genetic algorithm on bit strings (Gedda et al. 2012, section 4.2.2; Goldberg 1989).
//!
//! Each free parameter is encoded in a field of bits. The default is Gray code, in which neighbouring values
//! differ in one bit. A generation selects pairs, crosses them at one position, flips bits, and evaluates the
//! children as one batch. The best members of the old generation survive unchanged and are not evaluated
//! again.
//!
//! **Fitness** is defined for any cost as the difference between the 70 % quantile of the costs and the cost.
//! A thousandth of the largest difference is added, so that the worst member can also be selected. Failed
//! members are never selected. Members with equal costs have equal fitness.
//!
//! **Constraints.** A string that means a point outside linear constraints is evaluated at the nearest
//! feasible point. With infeasible members, the fitness follows from the ranks by the rules of Deb (2000).
//!
//! **Cutoffs**: none, because the fitness of every member counts.

mod coding;
mod operators;
mod options;
mod state;

pub use options::{Genetic, Selection};
pub use state::GeneticState;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::method_interface::rng::draw_seed;
use crate::methods::shared::generations::Generations;
use crate::problem::option_texts;
use coding::Coding;
use state::GeneticRules;

impl MethodOptions for Genetic {
    type Method = GeneticState;

    fn begin(&self, setup: &Setup) -> Result<GeneticState, Error> {
        setup.tolerances.check()?;
        let space = &setup.space;
        space.require_box("ga")?;
        let n = space.n_free();
        let members = self.population.unwrap_or((10 * n).max(50));
        self.check(members)?;
        let coding = Coding::new(space, &self.resolution, self.gray)?;
        let members = if n == 0 { 1 } else { members };
        GeneticRules::begin(self, setup.clone(), coding, members, setup.seed.unwrap_or_else(draw_seed))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<GeneticState, Error> {
        let restored: GeneticState = Generations::restore(setup, state)?;
        match restored.rules().is_of(self) {
            true => Ok(restored),
            false => Err(Error::State { message: "it was created with other options".to_owned() }),
        }
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn supports_linear(&self) -> bool {
        true
    }

    fn supports_nonlinear(&self) -> bool {
        true
    }

    /// Returns false: ranking by violation first practically never satisfies an equality.
    fn supports_equalities(&self) -> bool {
        false
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(5000usize.saturating_mul(n + 1)), None)
    }

    /// Caches many points, because children are often identical to a parent.
    fn default_cache(&self) -> usize {
        10_000
    }
}
