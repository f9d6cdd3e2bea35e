//! Event-aware integration of hybrid ordinary differential equations (state, time, step and input events).
//!
//! [`solve`], [`solve_dae`] and [`solve_second_order`] accept closures and return a stored solution:
//!
//! ```
//! let solution = ode::solve(|_, x, dx| dx[0] = -x[0], 0.0..1.0, &[1.0]).relative_tolerance(1e-9).run()?;
//! assert!((solution.last()[0] - (-1f64).exp()).abs() < 1e-8);
//! # Ok::<(), ode::SolveError>(())
//! ```
//!
//! A [`Driver`] integrates any [`HybridSystem`] and reports samples, steps and events to an [`Observer`].
//!
//! The feature `sparse` (off by default) decomposes large Jacobians with few entries as sparse matrices.
//! Without the feature, all Jacobians are decomposed as dense matrices.
#![forbid(unsafe_code)]

mod auto;
mod driver;
mod error;
mod error_norm;
mod event;
mod explicit_rk;
mod implicit;
mod jacobian;
mod lu;
mod observer;
mod options;
mod sampling;
mod solve;
mod sparsity;
mod stages;
mod stats;
mod step_size;
mod stepper;
mod stopwatch;
mod system;
mod tableau;

pub use base::time_tolerance;
pub use driver::{Driver, EndConditions, Stopped};
pub use error::{ErrorKind, Evaluated, NotFinite, Report, SimulationError, Termination, Undetermined};
pub use observer::{EventRecord, Ignore, Observer, Sample, Side, StepOutputs, StepView};
pub use options::{AbsoluteTolerance, ChatteringPolicy, Limits, Method, Options, OptionsError};
pub use solve::{DenseOutput, Event, Solution, Solve, SolveError, solve, solve_dae, solve_second_order};
pub use sparsity::JacobianPattern;
pub use stats::{Checks, Seconds, Stats};
pub use stopwatch::{Stopwatch, Timing};
pub use system::{
    Argument, CallError, CallResult, Direction, EventCause, EventOutcome, EventVisit, HybridSystem,
    InputStop, StepAction,
};
