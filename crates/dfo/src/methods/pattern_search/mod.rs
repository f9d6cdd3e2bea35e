//! Pattern search: a mesh adaptive direct search that polls along orthogonal directions (Audet and Dennis,
//! SIAM J. Optim. 17, 2006; Abramson, Audet, Dennis and Le Digabel, SIAM J. Optim. 20, 2009: OrthoMADS).
//!
//! It is for costs with kinks, steps or failures, and few parameters. It is not for smooth costs: its
//! directions know nothing of the curvature, and where the cost lies in a narrow valley it needs several
//! times the evaluations of [`QuadraticModel`](crate::QuadraticModel) (of the 53 smooth problems of Moré and
//! Wild it solves 57 % within 100 (n + 1) evaluations, that one 92 %: `benches/dfo`).
//!
//! A poll looks at the `2 n` points of a frame around the best point, along both ways of `n` orthogonal
//! directions, rounded to a mesh that becomes finer than the frame as that shrinks. The first better point in
//! the order of the poll is taken, and the step to it is doubled for as long as that gains; three doublings
//! double the frame. After a poll without a better point the frame has half the size.
//!
//! **Directions.** A Householder reflection turns one of the coordinate axes along the way that the best
//! point has gone since the frame last shrank, and the polls begin with the directions nearest to that way
//! (Rosenbrock, Comput. J. 3, 1960, turns his axes for the same reason: steps along a valley). Where it has
//! not moved, the reflection is that of the next point of Halton's sequence, as in OrthoMADS, so that the
//! directions become dense on the sphere; with the first frame the axes stay as they are. The search is
//! deterministic.
//!
//! **Kinks.** Where several kinks cross, few directions lead down, and the frame may shrink before one is
//! met: passed tests alone tell nothing. Then discrete gradients around the best point either show a way
//! down, or that there is none for steps from the first frame's length to the last one's
//! (`discrete_gradients.rs`). Only where they show none has the search converged.
//!
//! **Restarts.** Then it goes on with the first frame and new directions until that gains nothing any more.
//!
//! **Bounds.** A point outside is moved onto the bound.
//!
//! **Failures** are points that are no better. Where the start has failed, the first poll must find a cost.
//! Where points beside the best one have failed, CMA-ES looks for a lower cost between them before the search
//! has converged (`failure_check.rs`).
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, is moved
//! alone first (`shared/size_search.rs`).
//!
//! **Plan.** The path takes one point after the other. Ahead of need, the points that follow in the poll are
//! evaluated, then those of the next poll ([`Lookahead`]). **Cutoff**: the cost of the best point; none for
//! discrete gradients.
//!
//! **Tests.** The x test measures the frame of a poll that failed, the f test what the last four frames have
//! gained.

mod descent;
mod discrete_gradients;
mod options;
mod poll;
mod state;

pub use options::PatternSearch;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup};
use crate::methods::shared::with_sizes::{NeedsSizes, WithSizes};
use crate::problem::memory;
use crate::problem::option_texts;
use state::Polling;

/// A running pattern search; made by [`PatternSearch`].
pub type PatternSearchState = WithSizes<PatternSearch>;

/// The problem without bounds that stand for "none".
fn prepared(setup: &Setup) -> Setup {
    Setup { space: setup.space.without_far_bounds(), ..setup.clone() }
}

impl NeedsSizes for PatternSearch {
    const NAME: &'static str = "pattern-search";
    type Search = Polling;

    fn search(&self, setup: Setup) -> Result<Polling, Error> {
        Ok(Polling::new(self, setup))
    }

    fn is_sound(search: &Polling, setup: &Setup) -> bool {
        search.is_sound(setup)
    }
}

impl MethodOptions for PatternSearch {
    type Method = PatternSearchState;

    fn begin(&self, setup: &Setup) -> Result<PatternSearchState, Error> {
        setup.tolerances.check()?;
        setup.space.require_continuous("pattern-search")?;
        self.check()?;
        memory::check(
            "the directions of so many parameters",
            &[2, setup.space.n_free(), setup.space.n_free()],
        )?;
        WithSizes::begin(self, prepared(setup))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<PatternSearchState, Error> {
        WithSizes::restore(self, prepared(setup), state)
    }

    fn needs_start(&self) -> bool {
        false
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    /// The points of a mesh come back.
    fn default_cache(&self) -> usize {
        1000
    }
}
