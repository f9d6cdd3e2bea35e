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
//! | method | use for | options |
//! |---|---|---|
//! | `least-squares` | costs that are sums of squares of residuals, see [`least_squares`] | [`LeastSquares`] |
//! | `nelder-mead` | smooth or nonsmooth costs, few parameters, with or without bounds | [`NelderMead`] |
//! | `quadratic-model` | smooth costs, with or without bounds; fewest evaluations | [`QuadraticModel`] |
//! | `barrier` | smooth costs with at least one bound; points stay strictly inside the bounds | [`Barrier`] |
//! | `de` (`differential-evolution`), `de-classic` | many minima in a box; integers | [`DifferentialEvolution`] |
//! | `cma-es` | badly scaled and rotated valleys, noise, steps, integers; with restarts, many minima in a box | [`CmaEs`] |
//! | `multistart` | many minima in a box, by least squares or Nelder-Mead from several starts; reports all minima found | [`Multistart`] |
//! | `pattern-search` | costs with kinks, such as largest errors; few parameters, with or without bounds | [`PatternSearch`] |
//! | `ga` (`genetic`) | integer and categorical parameters combined with continuous ones, in a box | [`Genetic`] |
//!
//! [`pareto`] minimises several criteria at once. [`EnsembleSampler`] samples a probability density.
//! [`SensitivityDesign`] estimates the effect of each parameter over its whole range.
//!
//! [`AnyMethod`] selects a method by name. [`Optimizer`] (ask/tell) leaves the evaluations to the caller.
//! [`minimize_by`] sends them to your own [`Evaluator`], for example a cluster.
//!
//! The *path* of a run is the sequence of points whose outcomes its decisions depend on. A run with one
//! worker would evaluate exactly these points. Points that other workers evaluate speculatively are
//! *speculative*.
//!
//! Properties of every method:
//!
//! - **The result is bit-for-bit identical for any number of workers.** Outcomes are processed in request
//!   order. Random numbers come from one stream per generation and individual. The number of points evaluated
//!   speculatively is an option of the method ([`Lookahead`]). It changes neither path nor counts, because a
//!   speculative outcome is unused until the path reaches its point.
//! - **A run can be continued** from a [`Checkpoint`] after a kill, after an interrupt or with a larger
//!   budget. The continued run is bit-for-bit identical to an uninterrupted one.
//! - **A failure is a state, not a number.** NaN, infinities, errors and panics rank behind every finite
//!   cost. They are counted with their reasons and do not enter any mean.
//! - **Budgets are exact.** They count the evaluations of the path, also within a batch. The [`Report`]
//!   contains the best point seen, however a run ends.
//! - **Cutoffs** inform an objective of the cost above which its value no longer matters. An objective may
//!   use or ignore them; no decision changes.
//! - **A method never calls the objective.** A [`Method`] is a state machine with an ask/tell interface, so a
//!   run can also be driven by hand.
//! - Points are in the user's units in the whole public interface. Bounds may be one-sided, and equal bounds
//!   fix a parameter. Positive parameters can be searched on a logarithmic scale ([`Transform`]).
#![forbid(unsafe_code)]

mod error;
mod evaluation;
mod method_interface;
mod methods;
mod outcome;
mod problem;
mod run;
mod sampler;
mod sensitivity;
mod values;

pub use base::RunContext;
pub use error::{Error, NothingFound};
pub use evaluation::{BatchView, CutoffUse, Evaluator, PollResult, Wait};
pub use method_interface::interface::{
    AnswersSoFar, BarrierStage, Batch, Lookahead, Method, MethodDetails, MethodOptions, Operation, Optimum,
    ProblemClass, Roughness, Setup, Simplex, SimplexView, Status,
};
pub use method_interface::linear_model::{Covariance, Dependence, LinearModel};
pub use method_interface::rng::draw_seed;
pub use method_interface::sampling::Sampling;
pub use method_interface::tolerances::{Limits, TestedSet, ToleranceTests, Tolerances};
pub use methods::{
    Adaptive, AnyMethod, Auto, Barrier, BarrierState, BoxedMethod, CmaBounds, CmaEs, CmaEsState,
    Coefficients, Crossover, DifferentialEvolution, DifferentialEvolutionState, DifferentialWeight, Genetic,
    GeneticState, InitialSimplex, LeastSquares, LeastSquaresState, Multistart, MultistartState, NelderMead,
    NelderMeadState, Nsga2, Nsga2State, PatternSearch, PatternSearchState, Polish, QuadraticModel,
    QuadraticModelState, Repair, Restarts, Scheme, Selection, StepPlan, Strategy,
};
pub use outcome::answer::{Answer, Answers, EvaluationKind, Failure, FailureKind, Outcome};
pub use outcome::pareto_front::{ParetoFront, ParetoPoint, hypervolume};
pub use outcome::termination::{Cause, Termination};
pub use outcome::trace::{Trace, TraceEntry};
pub use problem::constraints::{ActiveConstraint, Constraints, LinearConstraint, NonlinearConstraint};
pub use problem::loss::{Loss, RobustLoss};
pub use problem::m_estimator::MeanScore;
pub use problem::objective::{
    ByRef, Constrained, Fallible, Objective, Query, ResidualFunction, Residuals, WithQuery, constrained,
    fallible, residuals, with_query,
};
pub use problem::space::{Bounds, Space, typical_size};
pub use run::checkpoint::{Checkpoint, Resume};
pub use run::minimize::{
    ByHand, ByRun, Minimize, by_hand, least_squares, minimize, minimize_batches, minimize_by, pareto,
};
pub use run::optimizer::{Optimizer, Point};
pub use run::options::{EvaluatedPoint, RunOptions};
pub use run::progress::Progress;
pub use run::report::{Report, Resumed};
pub use run::requested::RequestedRun;
pub use sampler::{EnsembleSampler, autocorrelation_time, split_r_hat, standard_normals, uniforms};
pub use sensitivity::{
    Effects, Evaluations, IntervalOptions, ListedPoints, MorrisEffects, OutputEffects, Sensitivity,
    SensitivityDesign, SensitivityMethod, SobolIndices,
};
pub use values::choices::{BoundsHandling, ParameterKind, Search, StopRule, ToleranceMeasure, Transform};
pub use values::fields::{field_names, read_part, read_record, read_strict};
pub use values::record::{Record, RecordError, Value};
