//! Differential evolution: the form of Storn and Price (J. Global Optim. 11, 1997) with its usual variants, and
//! L-SHADE (Tanabe and Fukunaga, CEC 2014), which sets its own factors and shrinks its population.
//!
//! A generation is one batch: all trial vectors are made from the population as it stood, and selected from when all
//! of their costs are known. So the number of workers changes nothing.
//!
//! **Selection.** A trial takes the place of its target when its cost is not above the target's; a failed or given-up
//! trial never does. An evaluation may stop above the target's cost (the cutoff); a failed target sets none.
//!
//! **L-SHADE.** Trials are `x_i + F (x_pbest - x_i) + F (x_r1 - x_r2)` with `x_pbest` among the best `p N`, and
//! `x_r2` from population and archive. `F` and `CR` are drawn around memories of what succeeded, weighted by how
//! much the cost fell; a success over a failed target says nothing about how much, so it enters no memory, and a
//! failed target enters no archive. The population shrinks linearly with the evaluations made, so the budget matters:
//! that of the run, or [`DifferentialEvolution::budget`].

mod adaptation;
mod operators;
mod options;
mod state;

pub use options::{Adaptive, Crossover, DifferentialEvolution, Repair, Scheme, Strategy, Weight};
pub use state::DifferentialEvolutionState;
