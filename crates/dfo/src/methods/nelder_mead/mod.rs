//! Bounded Nelder-Mead with batches. The n+1 vertices form one batch, and so do the vertices of a shrink.
//! Points of this iteration and of the next ones can be evaluated speculatively.
//!
//! The rules are from Lagarias, Reeds, Wright and Wright (SIAM J. Optim. 9, 1998, section 2). A newer vertex
//! ranks after older ones of equal cost, as in these rules. In five and more dimensions, the coefficients are
//! from Gao and Han (Comput. Optim. Appl. 51, 2012). For bounds, see
//! [`BoundsHandling`](crate::BoundsHandling).
//!
//! **Linear constraints.** Trial points are mirrored at bounds and at constraints. If a point is then not
//! inside, or is at another vertex, the way from the centroid to it ends at the first constraint that it
//! meets. If this is (nearly) at the centroid, because the other vertices are on the constraint, the point is
//! the middle between the centroid and the worst vertex. The simplex then approaches the constraint without
//! becoming flat on it. A simplex that ends on a constraint is rebuilt as on a kink (below), because it may
//! have collapsed along it. On random convex quadratic programs with 2 to 4 parameters and 1 to 6
//! constraints, one of 6000 runs still reports success away from the minimum
//! (`benches/quadratic_programs.rs`); 48 do if points are moved onto bounds and constraints. Nonlinear
//! constraints are not supported: ranking vertices by feasibility first makes the simplex flat along the
//! constraint, away from the minimum.
//!
//! **Failures.** A failed vertex ranks after every vertex with a cost. Among failed vertices, the newest
//! ranks last. The last vertex is replaced as always, but the centroid includes only the finite ones among
//! the other vertices (at least the best is finite). The centroid is still in the plane through the remaining
//! vertices. Therefore the new simplex has volume if the old one had. A failed trial point is treated like a
//! point with too high a cost.
//!
//! **Plans.** An iteration needs its points one after the other: the reflection, then possibly one more. A
//! plan determines how many points are evaluated at once ([`Lookahead`]). The others are guesses. Half of
//! all iterations accept the reflection unchanged, a quarter contract inside, and a quarter try an expansion.
//! The most probable next point is thus the reflection of the next iteration. Every plan follows the same
//! path, because the method receives the same answers as with one point at a time.
//!
//! **Restarts.** The tests may pass although the simplex has become flat (as in McKinnon's example, SIAM J.
//! Optim. 9, 1998). Then a new simplex with edges along the axes is built around the best vertex. Each edge
//! points in the direction in which the known costs decrease (Kelley, SIAM J. Optim. 10, 1999). The simplex
//! is also rebuilt if it is on a kink, where it may collapse away from any minimum. At a kink, the costs of
//! its vertices differ in proportion to its size. For a smooth cost, they differ in proportion to the square
//! of its size. With restarts, 97 % of 250 piecewise linear functions of 2 to 6 parameters in rotated axes
//! are solved. Without restarts, 53 % are solved. A simplex on a bound is not rebuilt.
//!
//! A simplex also collapses next to failed points, and is rebuilt as on a kink. If this gains nothing, CMA-ES
//! searches for a lower cost between the failed points (`failure_check.rs`). If CMA-ES finds none, the search
//! has converged.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, has unknown
//! magnitude. Before the first simplex is built, each such parameter is varied alone to the lowest cost along
//! it. The steps are powers of ten. When the tests pass, these steps are repeated from the best vertex. If
//! one finds a lower cost, a new simplex is built from it.
//!
//! **Cutoffs** are set only if they do not change a decision. The cutoff is the worst cost for the reflection
//! and the inside contraction. For the expansion and the outside contraction, it is the cost of the
//! reflection. Speculative points use the worst cost, except the expansion of this iteration, which uses
//! the best cost. There is no cutoff while the worst vertex has failed, and none for starting and shrinking
//! vertices. Steps that search for sizes use twice the cost at their start, or the lowest cost found along
//! the parameter.

mod initial;
mod iteration;
mod options;
mod restart;
mod simplex;
mod simplex_search;
mod speculation;
mod state;
mod trial;

pub use options::{Coefficients, InitialSimplex, NelderMead};
pub(crate) use simplex_search::SimplexSearch;
pub use state::NelderMeadState;

use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, Setup, restored};
use crate::problem::memory;
use crate::problem::option_texts;

impl MethodOptions for NelderMead {
    type Method = NelderMeadState;

    fn begin(&self, setup: &Setup) -> Result<NelderMeadState, Error> {
        setup.tolerances.check()?;
        self.batch.check()?;
        setup.space.require_continuous("nelder-mead")?;
        let numbers = self.coefficients.resolve(setup.space.n_free())?;
        let (n, n_user) = (setup.space.n_free(), setup.space.n());
        // Vertices on two scales, and the vertices of a batch.
        memory::check("a simplex for this many parameters", &[n + 1, n + 2 * n_user])?;
        let mut simplex = initial::simplex(&setup.space.without_far_bounds(), &self.initial)?;
        let setup = self.prepared(setup);
        simplex.rewrite(&setup.space);
        let unknown = (0..setup.space.n_free()).any(|k| setup.space.size_is_unknown(k));
        // Steps of powers of ten along a parameter leave the feasible set.
        let sizing = unknown && self.initial == InitialSimplex::Auto && !setup.space.has_linear();
        let handling = self.handling(&setup.space);
        Ok(NelderMeadState::new(setup, self.batch, numbers, handling, simplex, self.restarts, sizing))
    }

    fn supports_linear(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<NelderMeadState, Error> {
        let setup = self.prepared(setup);
        restored(state, |s: &NelderMeadState| s.is_sound(&setup))
    }
}
