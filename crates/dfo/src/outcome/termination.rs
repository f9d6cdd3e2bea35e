//! Reasons for the end of a run.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Reason why a run ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Termination {
    /// The tolerance tests passed.
    Converged,
    /// The predicted decrease is smaller than the effect of the noise of the residuals, so the f test cannot
    /// pass.
    Noise,
    /// The target value was reached.
    Target,
    /// The extent of the search is below the resolution of floating-point numbers, and the tests have not
    /// passed.
    Collapsed,
    /// The search collapsed as in [`Collapsed`](Self::Collapsed), and only one vertex has a cost. The result
    /// is not informative.
    OneFiniteVertex,
    /// The tolerance tests passed, but points around the best one fail. A lower cost may exist between them.
    BesideFailures,
    /// The tolerance tests passed, but the caller of the run has found that another least-squares step lowers
    /// the cost. No run of this crate ends with this reason.
    BeforeMinimum,
    /// The simplex or population no longer contains a point with a cost, although earlier points had one.
    AllFailed,
    /// The fraction of failed evaluations exceeded its limit.
    TooManyFailed,
    /// The search made no progress for long: many generations without a better point, or only repeated
    /// points.
    Stalled,
    /// All parameters are fixed, and the only point was evaluated.
    AllFixed,
    /// The limit of evaluations was reached.
    MaxEvaluations,
    /// The limit of iterations was reached.
    MaxIterations,
    /// The limit of time was reached.
    MaxTime,
    /// The observer requested a stop.
    StoppedByObserver,
    /// The poll function or the cancel flag requested a stop, for example after Ctrl-C.
    Interrupted,
    /// The objective ended the run with this message.
    Aborted(String),
    /// The run ended, but its last checkpoint could not be written. The result is complete.
    NotSaved {
        /// Reason why the checkpoint could not be written.
        reason: String,
        /// Reason why the run ended.
        ended: Box<Termination>,
    },
    /// The tolerance tests passed, but all points had the same cost. The result is not informative.
    ConstantCost,
    /// The search ended, but its best point violates a nonlinear constraint by more than the tolerance.
    Infeasible,
    /// The cost fell below -1e50, so it has no minimum. Also used if the minimum of a sum of squares is at
    /// infinity: the parameters grew, and the cost still decreases in that direction.
    Unbounded,
}

/// Category of the reason why a run ended ([`Termination::cause`]). It determines what may follow the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// The search ended by itself.
    Search,
    /// A limit of evaluations, of iterations or of the cost.
    Limit,
    /// A callback.
    Callback,
    /// The time limit.
    Time,
    /// The objective: its points fail, or it has no minimum.
    Objective,
    /// An interrupt, or an error in the objective.
    Interrupt,
}

impl Cause {
    /// True if further evaluations around the result are allowed and may succeed.
    pub fn allows_evaluations(self) -> bool {
        matches!(self, Self::Search | Self::Limit | Self::Callback)
    }

    /// True if the caller requested the end of all work in progress.
    pub fn is_request(self) -> bool {
        matches!(self, Self::Callback | Self::Interrupt)
    }
}

/// Cost below which a problem counts as unbounded. No physical quantity is as large in any unit. Further
/// towards the largest number, 1.8e308, relative tests may pass.
pub(crate) const UNBOUNDED: f64 = -1e50;

impl Termination {
    /// True if the tolerance tests passed, the target was reached, or there was nothing to search. An end in
    /// noise is a success if the x test passed, which [`Report::is_success`](crate::Report::is_success)
    /// checks.
    pub fn is_success(&self) -> bool {
        matches!(self, Self::Converged | Self::Target | Self::AllFixed)
    }

    /// Returns the reason why the search ended, even if the checkpoint could not be written afterwards.
    pub fn ended(&self) -> &Self {
        match self {
            Self::NotSaved { ended, .. } => ended,
            ended => ended,
        }
    }

    /// Returns the category of the reason.
    pub fn cause(&self) -> Cause {
        match self {
            Self::Converged
            | Self::Noise
            | Self::ConstantCost
            | Self::Collapsed
            | Self::BesideFailures
            | Self::BeforeMinimum
            | Self::Stalled
            | Self::Infeasible
            | Self::AllFixed => Cause::Search,
            Self::Target | Self::MaxEvaluations | Self::MaxIterations => Cause::Limit,
            Self::StoppedByObserver => Cause::Callback,
            Self::MaxTime => Cause::Time,
            Self::OneFiniteVertex | Self::AllFailed | Self::TooManyFailed | Self::Unbounded => {
                Cause::Objective
            }
            Self::Interrupted | Self::Aborted(_) => Cause::Interrupt,
            Self::NotSaved { ended, .. } => ended.cause(),
        }
    }

    /// Returns a short name for tables and files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Noise => "noise",
            Self::Target => "target",
            Self::Collapsed => "collapsed",
            Self::OneFiniteVertex => "one-finite-vertex",
            Self::BesideFailures => "beside-failures",
            Self::BeforeMinimum => "before-minimum",
            Self::AllFailed => "all-failed",
            Self::TooManyFailed => "too-many-failed",
            Self::Stalled => "stalled",
            Self::AllFixed => "all-fixed",
            Self::MaxEvaluations => "max-evaluations",
            Self::MaxIterations => "max-iterations",
            Self::MaxTime => "max-time",
            Self::StoppedByObserver => "stopped-by-observer",
            Self::Interrupted => "interrupted",
            Self::Aborted(_) => "aborted",
            Self::NotSaved { .. } => "not-saved",
            Self::ConstantCost => "constant-cost",
            Self::Infeasible => "infeasible",
            Self::Unbounded => "unbounded",
        }
    }
}

impl fmt::Display for Termination {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Aborted(message) => write!(f, "aborted: {message}"),
            Self::NotSaved { reason, ended } => write!(f, "{ended}, not saved: {reason}"),
            other => f.write_str(other.name()),
        }
    }
}
