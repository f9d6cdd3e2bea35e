//! CMA-ES: a normal distribution whose mean, step size and covariance matrix follow the best points of each
//! generation (Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, 2016; equation numbers are
//! those of the tutorial), with negative weights for the worst (Jastrebski and Arnold, CEC 2006) and restarts
//! with other populations (IPOP: Auger and Hansen, CEC 2005; BIPOP: Hansen, GECCO workshop 2009).
//!
//! A generation is one batch. Each individual is drawn from a stream of its own, so the number of workers
//! changes nothing.
//!
//! **Lag.** With a lag `L` an individual is drawn from the distribution after all generations that are known
//! `L` answers before it, so that `L` individuals of later generations can be evaluated while a generation
//! waits for its slowest. When its generation is learnt from, the step of such an individual is the one from
//! the mean as it is by then, and its length is bounded, as is that of the step of the mean (Hansen,
//! "Injecting external solutions into CMA-ES", INRIA RR-7748, 2011). The rule counts answers, not workers.
//! With a lag the population is larger by default, for many short steps in the wrong place do not converge.
//!
//! The distribution is over the working coordinates in units of their sizes, so that
//! parameters of any magnitude are alike.
//!
//! **Step size.** From a hundred parameters on, without a lag, it follows from two individuals ahead of the
//! mean and behind it, along its last step (two-point adaptation: Hansen, Atamna and Auger, PPSN 2014), else
//! from the length of the path of the mean. With the default first step, spheres of 100, 200, 300 parameters
//! took 7264, 13 493, 19 647 evaluations with the first and 12 719, 24 510, more than 30 000 with the second.
//!
//! **Bounds.** No point outside is evaluated, and none is drawn twice: the distribution has no bounds, and a
//! map that is the identity but near the bounds ([`CmaBounds`]) brings what is drawn inside.
//!
//! **Failures.** A failed individual ranks last and enters neither the mean nor the covariance matrix, the
//! negative weights included; the positive weights of those that are left sum to 1. After a generation
//! without any cost the mean goes back to the best point of the run, with half the step size.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, is moved
//! alone first (`shared/size_search.rs`).
//!
//! **Cutoffs**: none, for every rank counts.

mod boundary;
mod distribution;
mod options;
mod restarts;
mod state;
mod weights;

pub use options::{CmaBounds, CmaEs, Restarts};

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::method_interface::rng::draw_seed;
use crate::methods::shared::generations::Generations;
use crate::methods::shared::with_sizes::{NeedsSizes, WithSizes};
use crate::problem::memory;
use crate::problem::option_texts;
pub(crate) use state::CmaRules;

/// A running CMA-ES; made by [`CmaEs`].
pub type CmaEsState = WithSizes<CmaEs>;

/// The problem without bounds that stand for "none".
fn prepared(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds(), ..setup.clone() }
}

impl NeedsSizes for CmaEs {
    const NAME: &'static str = "cma-es";
    type Search = Generations<CmaRules>;

    fn search(&self, setup: Setup) -> Result<Self::Search, Error> {
        let members = self.members(setup.space.n_free())?;
        let seed = setup.seed.unwrap_or_else(draw_seed);
        Ok(CmaRules::begin(self, setup, members, seed))
    }

    fn is_sound(search: &Self::Search, setup: &Setup) -> bool {
        search.is_sound(setup)
    }
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
        let rows = 4 * members + self.lag;
        memory::check("a population of so many members and parameters", &[rows, setup.space.n() + n])?;
        WithSizes::begin(self, prepared(setup))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<CmaEsState, Error> {
        WithSizes::restore(self, prepared(setup), state)
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn describe(&self) -> Vec<(String, String)> {
        // Without a lag the run is that of files that have no such option.
        option_texts::fields(self).into_iter().filter(|(name, _)| self.lag > 0 || name != "lag").collect()
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(5000usize.saturating_mul(n + 1)), None)
    }
}
