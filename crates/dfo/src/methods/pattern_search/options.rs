//! Options of pattern search.

use crate::error::Error;
use crate::method_interface::interface::Lookahead;
use serde::{Deserialize, Serialize};

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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct PatternSearch {
    /// Number of points that are evaluated at once; default [`Lookahead::Measured`].
    pub batch: Lookahead,
    /// The first distance of the poll points from the best point along each parameter, in units of its size:
    /// the nominal value where one was given, else the width of the box, else |x0|, else 1. Default 0.3.
    pub frame: f64,
    /// When the tests have passed and discrete gradients show no way down, the search begins anew with the
    /// first frame and new directions, until so many such searches in a row have gained nothing (no more than
    /// the f test allows); default 1. They find what lies behind a step, of which no gradient tells. 0: the
    /// first search is the only one.
    pub restarts: usize,
}

impl Default for PatternSearch {
    fn default() -> Self {
        Self { batch: Lookahead::Measured, frame: 0.3, restarts: 1 }
    }
}

impl PatternSearch {
    /// Sets how many points are evaluated at once.
    #[must_use]
    pub fn batch(mut self, points: Lookahead) -> Self {
        self.batch = points;
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
        self.batch.check()?;
        if self.frame > 0.0 && self.frame.is_finite() {
            return Ok(());
        }
        Err(Error::Option { name: "frame", value: self.frame, range: "positive and finite" })
    }
}
