//! Bounded Nelder-Mead with batches: the n+1 vertices at once, a shrink at once, and the four trial points of an
//! iteration ahead of need.
//!
//! The rules are those of Lagarias, Reeds, Wright and Wright (SIAM J. Optim. 9, 1998, section 2), ties included: a
//! vertex that comes later ranks behind older ones of the same cost. For five and more dimensions the coefficients
//! are those of Gao and Han (Comput. Optim. Appl. 51, 2012). Bounds: see [`BoundsHandling`](crate::BoundsHandling).
//!
//! **Failures.** A failed vertex ranks behind every vertex with a cost; among failed ones the youngest ranks last.
//! The last vertex is replaced as always, but the centroid is that of the finite ones among the other vertices
//! (at least the best is finite). The centroid still lies in the plane through the vertices that stay, so the new
//! simplex has volume whenever the old one had. A failed trial point is treated like one that is too bad.
//!
//! **Plans.** Every plan runs the same decisions; plans differ in what is asked before it is known to be needed:
//!
//! | plan | first round of an iteration | further rounds |
//! |---|---|---|
//! | serial | reflection | the one point that is needed, if any |
//! | two | reflection, inside contraction | expansion or outside contraction, if needed |
//! | four | reflection, expansion, both contractions | none |
//! | two-ahead | the same, and the four points of the next iteration after each of them | none; often the next iteration needs none either |
//!
//! Half of all iterations accept the reflection and a quarter need the inside contraction, so the second plan
//! rarely needs a second round.
//!
//! The two-ahead plan guesses that a contracted point will not be the worst again. Where it guesses wrong, or something
//! cannot be foreseen, points are asked anew.
//!
//! One further plan, `lee-wiswall`, takes **another path**: it moves the n/2 worst vertices at once and comes down to
//! the serial method when that stops paying. It is never chosen automatically, and its name is in the report.
//!
//! **Restarts.** When the tests pass although the simplex has become flat (as in McKinnon's example, SIAM J. Optim. 9,
//! 1998), a new one with edges along the axes is built around its best vertex, each edge pointing to where the costs
//! seen say that it goes down (Kelley, SIAM J. Optim. 10, 1999). A simplex that is flat because it lies on a bound is
//! left alone.
//!
//! **Cutoffs** (where they change no decision): reflection and inside contraction: the worst cost; expansion: the
//! cost of the reflection, ahead of need the best cost; outside contraction: the cost of the reflection, ahead of
//! need the worst cost; for the next iteration: the worst cost. None while the worst vertex has failed, and none for starting and shrinking vertices.

mod initial;
mod lee_wiswall;
mod lookahead;
mod options;
mod restart;
mod simplex;
mod state;
mod trial;

pub use options::{BatchPlan, Coefficients, InitialSimplex, NelderMead};
pub use state::NelderMeadState;
