//! CMA-ES: a normal distribution whose mean, step size and covariance matrix follow the best points of each
//! generation (Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772, 2016). Equation numbers
//! refer to the tutorial. The worst points have negative weights (Jastrebski and Arnold, CEC 2006). Restarts
//! use other population sizes (IPOP: Auger and Hansen, CEC 2005; BIPOP: Hansen, GECCO workshop 2009).
//!
//! Each generation is one batch. Each individual is drawn from a separate random stream, so the result does
//! not depend on the number of workers.
//!
//! **Lag.** With a lag `L`, an individual is drawn from the distribution after all generations known `L`
//! answers before it. Thus `L` individuals of later generations can be evaluated while a generation waits for
//! its slowest individual. When the distribution is updated, the step of such an individual is measured from
//! the current mean. The length of this step is bounded, as is the step of the mean (Hansen, "Injecting
//! external solutions into CMA-ES", INRIA RR-7748, 2011). The rule counts answers, not workers. With a lag,
//! the default population is larger, because many short steps in the wrong place do not converge.
//!
//! The distribution is defined over the working coordinates in units of their sizes. Parameters of any
//! magnitude are thus treated alike.
//!
//! **Step size.** From a hundred parameters on, without a lag, two individuals determine the step size. They
//! are on both sides of the mean, along its last step (two-point adaptation: Hansen, Atamna and Auger, PPSN
//! 2014). Otherwise the step size follows from the length of the path of the mean. With the default first
//! step, spheres of 100, 200 and 300 parameters took 7264, 13 493 and 19 647 evaluations with two-point
//! adaptation. With the path length, they took 12 719, 24 510 and more than 30 000.
//!
//! **Bounds.** Points outside the bounds are never evaluated, and no point is redrawn. The distribution is
//! unbounded, and a map ([`CmaBounds`]) moves drawn points inside. The map is the identity except near the
//! bounds.
//!
//! **Constraints.** Individuals rank by the cost with additional terms, see `lagrangian.rs`.
//!
//! **Failures.** A failed individual ranks last. It is not used to update the mean or the covariance matrix,
//! not even with a negative weight. The positive weights of the remaining individuals sum to 1. After a
//! generation without any cost, the mean returns to the best point of the run, and the step size is halved.
//!
//! **Integers** are rounded coordinates. Their deviations have a lower limit, and the integers of the better
//! individuals are centred (`integers.rs`). The tests compare the individuals with the integers of the best
//! one, and end the search only after other integers have been tried.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, is first
//! varied alone (`shared/size_search.rs`).
//!
//! **Cutoffs**: none, because every rank counts.

mod boundary;
mod continuation;
mod distribution;
mod integers;
mod lagrangian;
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
pub(crate) use continuation::PopulationSearch;
pub(crate) use state::CmaRules;

/// A running CMA-ES search, created by [`CmaEs`].
pub type CmaEsState = WithSizes<CmaEs>;

/// Returns the setup without bounds that mean "unbounded".
fn prepared(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds(), ..setup.clone() }
}

impl NeedsSizes for CmaEs {
    const NAME: &'static str = "cma-es";
    type Search = Generations<CmaRules>;

    fn search(&self, setup: Setup) -> Result<Self::Search, Error> {
        let members = self.members(&setup.space)?;
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
        setup.space.forbid_categorical("cma-es")?;
        let n = setup.space.n_free();
        let members = self.members(&setup.space)?;
        // Population, candidates and batch on two scales, the steps, the matrix, its axes, and the
        // decomposition workspace.
        memory::check("a covariance matrix for this many parameters", &[4, n, n])?;
        let rows = 4 * members + self.lag;
        memory::check("a population with this many members and parameters", &[rows, setup.space.n() + n])?;
        WithSizes::begin(self, prepared(setup))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<CmaEsState, Error> {
        WithSizes::restore(self, prepared(setup), state)
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

    fn describe(&self) -> Vec<(String, String)> {
        // Options at their defaults are omitted, so that runs match files from versions without them.
        let is_given = |name: &str| match name {
            "lag" => self.lag > 0,
            "patience" => self.patience.is_some(),
            _ => true,
        };
        option_texts::fields(self).into_iter().filter(|(name, _)| is_given(name)).collect()
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        (Some(5000usize.saturating_mul(n + 1)), None)
    }
}
