//! Derivative-free optimisation with parallel evaluation, for objectives that are slow, noisy, or sometimes
//! fail.
//!
//! ```
//! let report = dfo::minimize(|x: &[f64]| (x[0] - 1.0).powi(2) + (x[1] + 0.5).powi(2))
//!     .start(&[0.0, 0.0])
//!     .bounds(&[-1.0, -1.0], &[2.0, 2.0])?
//!     .workers(2)
//!     .run()?;
//! assert!((report.x[0] - 1.0).abs() < 1e-4);
//! # Ok::<(), dfo::Error>(())
//! ```
//!
//! | method | for | options |
//! |---|---|---|
//! | `least-squares` | a cost that is a sum of squares of residuals: [`least_squares`] | [`LeastSquares`] |
//! | `nelder-mead` | smooth or not, few parameters, with or without bounds | [`NelderMead`] |
//! | `quadratic-model` | smooth, with or without bounds: the fewest evaluations | [`QuadraticModel`] |
//! | `barrier` | the same, strictly inside of bounds: needs at least one | [`Barrier`] |
//! | `de` (`differential-evolution`), `de-classic` | many minima in a box; integers | [`DifferentialEvolution`] |
//! | `cma-es` | badly scaled and turned valleys, noise; with restarts many minima in a box | [`CmaEs`] |
//! | `multistart` | the same by local searches from several starts: least squares or Nelder-Mead; reports all minima found | [`Multistart`] |
//! | `pattern-search` | kinks and jumps, not smooth costs; few parameters, with or without bounds | [`PatternSearch`] |
//! | `ga` (`genetic`) | integers and choices next to numbers, in a box | [`Genetic`] |
//!
//! [`AnyMethod`] has them by name; [`Optimizer`] (ask/tell) leaves the evaluations to the caller, an
//! [`Evaluator`] of one's own ([`minimize_by`]) to a cluster, for example.
//!
//! The *path* of a run is the sequence of the points whose outcomes its decisions depend on: those that a run
//! with one worker would evaluate. What other workers evaluate ahead of need is *speculative*.
//!
//! Properties of every method:
//!
//! - **The same bits for any number of workers.** Outcomes are taken in request order, random numbers come
//!   from one stream per generation and individual. How many points are evaluated ahead of need is an option
//!   of the method ([`Lookahead`]) and changes neither path nor counts: what was evaluated ahead means
//!   nothing before the path comes to it.
//! - **A run can go on**: after a kill, an interrupt or with a larger budget, from a [`Checkpoint`], bit for
//!   bit.
//! - **A failure is a state, not a number.** NaN, infinities, errors and panics rank behind every finite
//!   cost, are counted with their reasons, and enter no mean.
//! - **Budgets are exact**: they count the evaluations of the path, also inside of a batch. The best point
//!   seen is in the [`Report`] however a run ends.
//! - **Cutoffs** tell an objective above which cost its value no longer matters; using them or not changes no
//!   decision.
//! - **A method never calls the objective**: it is a state machine that is asked and told ([`Method`]), so
//!   that a run can be driven by hand.
//! - Points are in the user's units everywhere outside; bounds may be one-sided, equal bounds fix a
//!   parameter, and positive parameters can be searched by their logarithm ([`Transform`]).
#![forbid(unsafe_code)]

mod error;
mod evaluation;
mod method_interface;
mod methods;
mod outcome;
mod problem;
mod run;
mod values;

pub use base::RunContext;
pub use error::{Error, NothingFound};
pub use evaluation::{BatchView, CutoffUse, Evaluator, Polled, Wait};
pub use method_interface::interface::{
    AnswersSoFar, BarrierStage, Batch, Lookahead, Method, MethodDetails, MethodOptions, Operation, Optimum,
    ProblemClass, Roughness, Setup, Simplex, SimplexView, Status,
};
pub use method_interface::linear_model::{Covariance, LinearModel};
pub use method_interface::sampling::Sampling;
pub use method_interface::tolerances::{Limits, TestedSet, ToleranceTests, Tolerances};
pub use methods::{
    Adaptive, AnyMethod, Auto, Barrier, BarrierState, BoxedMethod, CmaBounds, CmaEs, CmaEsState,
    Coefficients, Crossover, DifferentialEvolution, DifferentialEvolutionState, DifferentialWeight, Genetic,
    GeneticState, InitialSimplex, LeastSquares, LeastSquaresState, Multistart, MultistartState, NelderMead,
    NelderMeadState, PatternSearch, PatternSearchState, Polish, QuadraticModel, QuadraticModelState, Repair,
    Restarts, Scheme, Selection, StepPlan, Strategy,
};
pub use outcome::answer::{Answer, Answers, Failure, FailureKind, Outcome, Want};
pub use outcome::termination::{Cause, Termination};
pub use outcome::trace::{Trace, TraceEntry};
pub use problem::loss::{Loss, RobustLoss};
pub use problem::m_estimator::MeanScore;
pub use problem::objective::{
    ByRef, Fallible, Objective, Query, ResidualFunction, Residuals, WithQuery, fallible, residuals,
    with_query,
};
pub use problem::space::{Bounds, Space, typical_size};
pub use run::checkpoint::{Checkpoint, Resume};
pub use run::minimize::{
    ByHand, ByRun, Minimize, by_hand, least_squares, minimize, minimize_batches, minimize_by,
};
pub use run::optimizer::{Optimizer, Point};
pub use run::options::{KnownPoint, RunOptions};
pub use run::progress::Progress;
pub use run::report::{Report, Resumed};
pub use run::requested::RequestedRun;
pub use values::choices::{BoundsHandling, ParameterKind, Search, StopRule, ToleranceMeasure, Transform};
pub use values::fields::{field_names, read_known, read_part, read_record};
pub use values::record::{Record, RecordError, Value};
