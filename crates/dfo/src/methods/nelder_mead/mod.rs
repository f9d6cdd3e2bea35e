//! Bounded Nelder-Mead with batches: the n+1 vertices at once, a shrink at once, and the points of this
//! iteration and the next ones ahead of need.
//!
//! The rules are those of Lagarias, Reeds, Wright and Wright (SIAM J. Optim. 9, 1998, section 2), ties
//! included: a vertex that comes later ranks behind older ones of the same cost. For five and more dimensions
//! the coefficients are those of Gao and Han (Comput. Optim. Appl. 51, 2012). Bounds: see
//! [`BoundsHandling`](crate::BoundsHandling).
//!
//! **Failures.** A failed vertex ranks behind every vertex with a cost; among failed ones the youngest ranks
//! last. The last vertex is replaced as always, but the centroid is that of the finite ones among the other
//! vertices (at least the best is finite). The centroid still lies in the plane through the vertices that
//! stay, so the new simplex has volume whenever the old one had. A failed trial point is treated like one
//! that is too bad.
//!
//! **Plans.** An iteration needs its points one after the other: the reflection, then perhaps one more. A
//! plan says how many points are evaluated at once ([`Lookahead`]). The others are guessed: half of all
//! iterations accept the reflection as it is, a quarter contract inside and a quarter try an expansion, so
//! the most probable next point is the reflection of the next iteration. Every plan takes the same path: the
//! method is told what it would have been told one point at a time.
//!
//! **Restarts.** When the tests pass although the simplex has become flat (as in McKinnon's example, SIAM J.
//! Optim. 9, 1998), a new one with edges along the axes is built around its best vertex, each edge pointing
//! to where the costs seen say that it goes down (Kelley, SIAM J. Optim. 10, 1999). The same where the
//! simplex lies on a kink, on which it may collapse away from any minimum: there the costs of its vertices
//! differ in proportion to its size, where they are smooth to the square of it. Of 250 piecewise linear
//! functions of 2 to 6 parameters in rotated axes 97 % are solved then, 53 % without. A simplex that lies on
//! a bound is left alone.
//!
//! Beside points that failed a simplex collapses, too: it is built anew as on a kink. When that gains
//! nothing, CMA-ES looks for a lower cost between the points that failed (`failure_check.rs`); where it finds
//! none the search has converged.
//!
//! **Unknown sizes.** A parameter that starts at zero, without a nominal size and without a box, says nothing
//! about its magnitude. Before the first simplex is built each is moved alone, by steps of powers of ten, to
//! where the cost is least along it. When the tests pass such steps are made once more from the best vertex;
//! where one finds a lower cost, a new simplex is built from it.
//!
//! **Cutoffs** (where they change no decision): reflection and inside contraction: the worst cost; expansion
//! and outside contraction: the cost of the reflection. Ahead of need: the worst cost, for the expansion of
//! this iteration the best. None while the worst vertex has failed, and none for starting and shrinking
//! vertices. Steps that look for sizes: twice the cost they start from, or the lowest found along the
//! parameter.

mod initial;
mod iteration;
mod options;
mod prediction;
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
        // The vertices on two scales, and those of a batch.
        memory::check("a simplex of so many parameters", &[n + 1, n + 2 * n_user])?;
        let mut simplex = initial::simplex(&setup.space.without_far_bounds(), &self.initial)?;
        let setup = self.prepared(setup);
        simplex.rewrite(&setup.space);
        let unknown = (0..setup.space.n_free()).any(|k| setup.space.size_is_unknown(k));
        let sizing = unknown && self.initial == InitialSimplex::Auto;
        Ok(NelderMeadState::new(setup, self.batch, numbers, self.bounds, simplex, self.restarts, sizing))
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<NelderMeadState, Error> {
        let setup = self.prepared(setup);
        restored(state, |s: &NelderMeadState| s.is_sound(&setup))
    }
}
