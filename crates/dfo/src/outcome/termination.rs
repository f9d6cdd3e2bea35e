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
    /// The checkpoint could not be written, for this reason; the result is whole.
    NotSaved(String),
    /// The tolerance tests passed, but every point had the same cost: nothing was learned.
    ConstantCost,
    /// The search ended beyond all quantities: the cost fell below -1e50, so it has no minimum. Or the
    /// minimum of a sum of squares lies at infinity: the parameters grew, and the cost still falls that way.
    Unbounded,
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

    /// A short name, fit for tables and files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Noise => "noise",
            Self::Target => "target",
            Self::Collapsed => "collapsed",
            Self::OneFiniteVertex => "one-finite-vertex",
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
            Self::NotSaved(_) => "not-saved",
            Self::ConstantCost => "constant-cost",
            Self::Unbounded => "unbounded",
        }
    }
}

impl fmt::Display for Termination {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Aborted(message) => write!(f, "aborted: {message}"),
            Self::NotSaved(message) => write!(f, "not saved: {message}"),
            other => f.write_str(other.name()),
        }
    }
}
