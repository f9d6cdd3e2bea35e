//! Options of pattern search.

use crate::error::Error;
use crate::method_interface::interface::Lookahead;
use serde::{Deserialize, Serialize};

/// Options of pattern search, for costs with kinks, steps or failures and few parameters. For smooth costs,
/// [`QuadraticModel`](crate::QuadraticModel) needs a fraction of the evaluations. The search starts from the
/// start point, or from the middle of the box if there is no start point.
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
    /// Number of points evaluated at once; default [`Lookahead::Measured`].
    pub batch: Lookahead,
    /// First distance of the poll points from the best point along each parameter, in units of its size;
    /// default 0.3. The size is the nominal value if given, otherwise the width of the box, otherwise |x0|,
    /// otherwise 1.
    pub frame: f64,
    /// Number of consecutive restarts without a gain (above the limit of the f test) after which the run
    /// ends; default 1. After the tests have passed and discrete gradients show no descent direction, the
    /// search restarts. Each restart uses the first frame and new directions. Restarts find lower costs
    /// beyond a step, which gradients cannot show. 0 disables restarts.
    pub restarts: usize,
}

impl Default for PatternSearch {
    fn default() -> Self {
        Self { batch: Lookahead::Measured, frame: 0.3, restarts: 1 }
    }
}

impl PatternSearch {
    /// Sets the number of points evaluated at once.
    #[must_use]
    pub fn batch(mut self, points: Lookahead) -> Self {
        self.batch = points;
        self
    }

    /// Sets the size of the first frame.
    #[must_use]
    pub fn frame(mut self, frame: f64) -> Self {
        self.frame = frame;
        self
    }

    /// Sets the number of consecutive restarts without a gain after which the run ends.
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
