//! A genetic algorithm on bit strings (Gedda et al. 2012, section 4.2.2; Goldberg 1989).
//!
//! Each free parameter has a field of bits, in Gray code unless told otherwise, so that neighbouring values differ in
//! one bit. A generation selects pairs, crosses them at one position, flips bits, and evaluates the children as one
//! batch; the best of the old generation stay, unchanged and not evaluated again.
//!
//! **Fitness** for any cost: `f_max - f_i` over the members that have one, plus a thousandth of `f_max - f_min` so
//! that the worst may be chosen too; failed members are never chosen; equal costs are equally fit.
//!
//! No cutoffs: the fitness of every member counts.

mod coding;
mod operators;
mod options;
mod state;

pub use options::{Genetic, Selection};
pub use state::GeneticState;
