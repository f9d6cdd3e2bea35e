//! Why a run ends.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Why a run ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Termination {
    /// The tolerance tests passed.
    Converged,
    /// The predicted decrease is less than the effect of the noise of the residuals: the f test cannot pass.
    Noise,
    /// The target value was reached.
    Target,
    /// The search has no extent left that floating-point numbers could resolve, and the tests have not
    /// passed.
    Collapsed,
    /// The same, and only one vertex has a cost: nothing was learned.
    OneFiniteVertex,
    /// The tolerance tests passed, but points around the best one fail: a lower cost may lie between them.
    BesideFailures,
    /// The tolerance tests passed, but whoever started the run has found that one more step of least squares
    /// lowers the cost. No run of this crate ends so.
    BeforeMinimum,
    /// No point of the simplex or population has a cost any more, though earlier ones had.
    AllFailed,
    /// More than the share of all evaluations that was allowed has failed.
    TooManyFailed,
    /// Nothing new came for long: no better point in many generations, or every point asked for was known
    /// already.
    Stalled,
    /// All parameters are fixed: the one point there is was evaluated.
    AllFixed,
    /// The evaluations are used up.
    MaxEvaluations,
    /// The iterations are used up.
    MaxIterations,
    /// The time is used up.
    MaxTime,
    /// An observer said stop.
    StoppedByObserver,
    /// The poll function or the cancel flag said stop (Ctrl-C, for example).
    Interrupted,
    /// The objective asked to end the run, with this message.
    Aborted(String),
    /// The run ended, and its last checkpoint could not be written; the result is whole.
    NotSaved {
        /// Why it could not be written.
        reason: String,
        /// Why the run ended.
        ended: Box<Termination>,
    },
    /// The tolerance tests passed, but every point had the same cost: nothing was learned.
    ConstantCost,
    /// The search ended beyond all quantities: the cost fell below -1e50, so it has no minimum. Or the
    /// minimum of a sum of squares lies at infinity: the parameters grew, and the cost still falls that way.
    Unbounded,
}

/// What ended a run ([`Termination::cause`]), and so what may follow it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// The search came to an end of its own.
    Search,
    /// A limit of evaluations, iterations or of the cost.
    Limit,
    /// A callback.
    Callback,
    /// The limit of time.
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

    /// True if the caller asked for the end of all that is under way.
    pub fn is_request(self) -> bool {
        matches!(self, Self::Callback | Self::Interrupt)
    }
}

/// A cost that has fallen below this counts as unbounded: no quantity in any unit is as large. On the way to
/// the largest number, 1.8e308, tests that are relative to the cost may pass.
pub(crate) const UNBOUNDED: f64 = -1e50;

impl Termination {
    /// True if the tolerance tests passed, or the target was reached, or there was nothing to search. The end
    /// in noise is a success where the x test passed, which [`Report::is_success`](crate::Report::is_success)
    /// checks.
    pub fn is_success(&self) -> bool {
        matches!(self, Self::Converged | Self::Target | Self::AllFixed)
    }

    /// Why the search ended, also where the checkpoint could not be written then.
    pub fn ended(&self) -> &Self {
        match self {
            Self::NotSaved { ended, .. } => ended,
            ended => ended,
        }
    }

    /// What ended the run.
    pub fn cause(&self) -> Cause {
        match self {
            Self::Converged
            | Self::Noise
            | Self::ConstantCost
            | Self::Collapsed
            | Self::BesideFailures
            | Self::BeforeMinimum
            | Self::Stalled
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

    /// A short name, fit for tables and files.
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
