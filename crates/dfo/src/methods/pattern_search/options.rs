//! Options of pattern search.

use crate::error::Error;
use crate::method::interface::Lookahead;
use serde::{Deserialize, Serialize};

/// Number of points that are evaluated at once. All plans take the same path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum PollPlan {
    /// At most as many as there are workers: so many that the path advances fastest, as measured while the
    /// run goes on.
    #[default]
    Auto,
    /// One point at a time: never an evaluation too many.
    Serial,
    /// A whole poll: `2 n` points.
    Poll,
    /// As many points as there are workers, however short an evaluation is.
    Ahead,
}

impl PollPlan {
    pub(super) fn lookahead(self, n: usize) -> Lookahead {
        match self {
            Self::Auto => Lookahead::Measured,
            Self::Serial => Lookahead::None,
            Self::Poll => Lookahead::Points(2 * n),
            Self::Ahead => Lookahead::Workers,
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Serial => "serial",
            Self::Poll => "poll",
            Self::Ahead => "ahead",
        }
    }
}

/// Options of pattern search, for costs with kinks, steps or failures and few parameters; for smooth ones
/// [`QuadraticModel`](crate::QuadraticModel) takes a fraction of the evaluations. It starts from the start
/// point; without one, from the middle of the box.
///
/// ```
/// use dfo::{PatternSearch, minimize};
///
/// let kinks = |x: &[f64]| (x[0] - 1.0).abs() + 10.0 * (x[1] - x[0]).abs();
/// let report = minimize(kinks).start(&[-1.0, 2.0]).method(PatternSearch::default()).run()?;
/// assert!(report.is_success() && report.fun < 1e-4, "{report}");
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PatternSearch {
    /// Number of points that are evaluated at once; default [`PollPlan::Auto`].
    pub batch: PollPlan,
    /// The first distance of the poll points from the best point along each parameter, in units of its size:
    /// the nominal value where one was given, else the width of the box, else |x0|, else 1. Default 0.3.
    pub frame: f64,
    /// When the tests have passed, the search begins anew with the first frame and new directions, until so
    /// many such searches in a row have gained nothing (no more than the f test allows); default 2. Where the
    /// cost has kinks few directions lead down, and a frame may shrink before one is met. 0: the first search
    /// is the only one.
    pub restarts: usize,
}

impl Default for PatternSearch {
    fn default() -> Self {
        Self { batch: PollPlan::Auto, frame: 0.3, restarts: 2 }
    }
}

impl PatternSearch {
    /// Sets how many points are evaluated at once.
    #[must_use]
    pub fn batch(mut self, plan: PollPlan) -> Self {
        self.batch = plan;
        self
    }

    /// Sets the first size of the frame.
    #[must_use]
    pub fn frame(mut self, frame: f64) -> Self {
        self.frame = frame;
        self
    }

    /// Sets how many searches in a row must gain nothing.
    #[must_use]
    pub fn restarts(mut self, restarts: usize) -> Self {
        self.restarts = restarts;
        self
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        if self.frame > 0.0 && self.frame.is_finite() {
            return Ok(());
        }
        Err(Error::Option { name: "frame", value: self.frame, range: "positive and finite" })
    }
}
