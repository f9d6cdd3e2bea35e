//! CMA-ES: a normal distribution whose mean, step size and covariance matrix follow the best points of each generation
//! (Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, 2016; equation numbers are those of the tutorial),
//! with negative weights for the worst (Jastrebski and Arnold, CEC 2006) and restarts with other populations (IPOP: Auger
//! and Hansen, CEC 2005; BIPOP: Hansen, GECCO workshop 2009).
//!
//! A generation is one batch. Each individual is drawn from a stream of its own, so the number of workers changes nothing.
//! The distribution is over the working coordinates in units of their sizes, so that parameters of any magnitude are alike.
//!
//! **Bounds.** No point outside is evaluated. By default the distribution is over angles
//! ([`BoundsHandling::Sine`](crate::BoundsHandling::Sine)), which have no bounds: a cost that goes down towards a bound has a
//! smooth minimum there. Mirrored or clamped, the point is brought inside for its evaluation, and the distribution learns
//! from the step as it was drawn.
//!
//! **Failures.** A failed individual ranks last and enters neither the mean nor the covariance matrix, the negative weights
//! included; the positive weights of those that are left sum to 1. After a generation without any cost the mean goes back to
//! the best point of the run, with half the step size.
//!
//! **Cutoffs**: none, for every rank counts.

mod distribution;
mod options;
mod restarts;
mod state;
mod weights;

pub use options::{CmaEs, Restarts};
pub use state::CmaEsState;

use crate::choices::BoundsHandling;
use crate::error::Error;
use crate::memory;
use crate::method::{MethodOptions, Setup};
use crate::methods::shared::generations::Generations;
use crate::option_texts;
use crate::rng::draw_seed;
use state::CmaRules;

/// The problem as the distribution sees it: without bounds that stand for "none", over angles, if so wished.
fn prepared(handling: BoundsHandling, setup: &Setup) -> Setup {
    let space = setup.space.without_far_bounds();
    let space = if handling == BoundsHandling::Sine { space.with_sine() } else { space };
    Setup { space, ..setup.clone() }
}

impl MethodOptions for CmaEs {
    type Method = CmaEsState;

    fn begin(&self, setup: &Setup) -> Result<CmaEsState, Error> {
        setup.tolerances.check()?;
        setup.space.require_continuous("cma-es")?;
        let n = setup.space.n_free();
        let members = self.members(n)?;
        // Population, candidates and batch on two scales, the steps; the matrix, its axes, and what decomposing it needs.
        memory::check("a covariance matrix of so many parameters", &[4, n, n])?;
        memory::check("a population of so many members and parameters", &[4 * members, setup.space.n() + n])?;
        let setup = prepared(self.bounds_handling, setup);
        let seed = setup.seed.unwrap_or_else(draw_seed);
        Ok(CmaRules::begin(self, setup, members, seed))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<CmaEsState, Error> {
        Generations::restore(&prepared(self.bounds_handling, setup), state)
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(5000usize.saturating_mul(n + 1)), None)
    }
}
