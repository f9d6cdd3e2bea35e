//! Pattern search: a mesh adaptive direct search that polls along orthogonal directions (Audet and Dennis,
//! SIAM J. Optim. 17, 2006; Abramson, Audet, Dennis and Le Digabel, SIAM J. Optim. 20, 2009: OrthoMADS).
//!
//! The method is intended for costs with kinks or failures, and few parameters. It is inefficient for
//! smooth costs, because its directions do not use the curvature. In a narrow valley, it needs several times
//! the evaluations of [`QuadraticModel`](crate::QuadraticModel). Within 100 (n + 1) evaluations, it solves 57
//! % of the 53 smooth problems of Moré and Wild. Quadratic models solve 92 % (`benches/dfo`). Noise and steps
//! of the cost stop it early, because its polls compare single costs. [`CmaEs`](crate::CmaEs) then solves
//! more problems (`benches/choice.rs`).
//!
//! A poll evaluates the `2 n` points of a frame around the best point, in both directions along `n`
//! orthogonal axes. The points are rounded to a mesh that becomes finer than the frame as the frame shrinks.
//! The first better point in poll order is accepted. The step to this point is doubled as long as the cost
//! decreases. Three doublings double the frame. After a poll without a better point, the frame is halved.
//!
//! **Directions.** A Householder reflection aligns one of the coordinate axes with the displacement of the
//! best point since the frame last shrank. The polls start with the directions nearest to this displacement
//! (Rosenbrock, Comput. J. 3, 1960, rotates his axes for the same reason: steps along a valley). If the best
//! point has not moved, the reflection uses the next point of Halton's sequence, as in OrthoMADS. The
//! directions then become dense on the sphere. With the first frame, the axes are not rotated. The search is
//! deterministic.
//!
//! **Kinks.** At an intersection of several kinks, only few directions lead down. The frame may shrink before
//! one is found. Passed tests alone are therefore not evidence of a minimum. Discrete gradients around the
//! best point then search for a descent direction (`discrete_gradients.rs`). Their steps range from the
//! length of the first frame to the last one. The search has converged only if they find no descent
//! direction.
//!
//! **Restarts.** The search then continues with the first frame and new directions until this gains nothing.
//!
//! **Bounds.** A point outside the bounds is moved onto the bound.
//!
//! **Linear constraints.** A point outside moves to the nearest feasible point. Near constraints, a poll also
//! has the directions that generate the cone of feasible directions (Lewis and Torczon, SIAM J. Optim. 10,
//! 2000, 917).
//!
//! Nonlinear constraints are not supported. With them as a barrier, the search ended beside the minimum on a
//! curved constraint although its tests had passed.
//!
//! **Failures.** A failed point counts as a point that is not better. If the start has failed, the first poll
//! must find a cost. If points next to the best one have failed, CMA-ES searches for a lower cost between
//! them (`failure_check.rs`). The search has converged only after that.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, is first
//! varied alone (`shared/size_search.rs`).
//!
//! **Plan.** The path processes one point after the other. Ahead of need, the next points of the poll are
//! evaluated, then the points of the next poll ([`Lookahead`]). **Cutoff**: the cost of the best point.
//! Discrete gradients have no cutoff.
//!
//! **Tests.** The x test measures the frame of a poll that failed. The f test measures the decrease during
//! the last four frames.

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

/// A running pattern search, created by [`PatternSearch`].
pub type PatternSearchState = WithSizes<PatternSearch>;

/// Returns the setup without bounds that mean "unbounded".
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
            "the directions for this many parameters",
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

    fn supports_linear(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    /// Caches points, because the points of a mesh recur.
    fn default_cache(&self) -> usize {
        1000
    }
}
