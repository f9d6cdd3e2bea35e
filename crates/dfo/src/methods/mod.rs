//! Optimization methods, and their selection at run time.

mod any_method;
mod barrier;
mod boxed;
mod cma_es;
mod differential_evolution;
mod failure_check;
mod genetic;
mod least_squares;
mod multistart;
mod nelder_mead;
mod nsga2;
pub(crate) mod option_names;
mod pattern_search;
mod quadratic_model;
#[cfg(feature = "schema")]
mod schema;
mod shared;

pub use any_method::{AnyMethod, Auto};
pub use barrier::{Barrier, BarrierState};
pub use boxed::BoxedMethod;
pub use cma_es::{CmaBounds, CmaEs, CmaEsState, Restarts};
pub use differential_evolution::{
    Adaptive, Crossover, DifferentialEvolution, DifferentialEvolutionState, DifferentialWeight, Repair,
    Scheme, Strategy,
};
pub use genetic::{Genetic, GeneticState, Selection};
pub use least_squares::{LeastSquares, LeastSquaresState, StepPlan};
pub use multistart::{Multistart, MultistartState, Polish};
pub use nelder_mead::{Coefficients, InitialSimplex, NelderMead, NelderMeadState};
pub use nsga2::{Nsga2, Nsga2State};
pub use pattern_search::{PatternSearch, PatternSearchState};
pub use quadratic_model::{QuadraticModel, QuadraticModelState};
