//! Options of least squares.

use crate::error::Error;
use crate::method_interface::interface::name_or_number;
use serde::{Deserialize, Deserializer, Serialize};

/// Number of points that least squares evaluates at once after the first n + 1. Each plan follows a different
/// path, which does not depend on the number of workers that evaluate it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum StepPlan {
    /// Chosen at the start from n and the number of workers of the run: as many points as there are workers,
    /// at most n + 4, if there are at least n + 1 workers. Otherwise one point at a time. The report and the
    /// checkpoint contain the choice.
    #[default]
    Auto,
    /// One point at a time: the fewest evaluations.
    Serial,
    /// n + 4 points: n neighbours of a point for its Jacobian, and four best points of the model within
    /// different radii.
    Rounds,
    /// This number of points: n neighbours, and at least one best point of the model. A round with more
    /// points than this number is evaluated in parts.
    #[serde(untagged)]
    Points(usize),
}

impl<'de> Deserialize<'de> for StepPlan {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        const NAMES: [(&str, StepPlan); 3] =
            [("auto", StepPlan::Auto), ("serial", StepPlan::Serial), ("rounds", StepPlan::Rounds)];
        let expected = "an integer, 'auto', 'serial' or 'rounds'";
        name_or_number(deserializer, expected, &NAMES, StepPlan::Points)
    }
}

impl StepPlan {
    /// Returns the plan for `n` parameters and this number of workers.
    pub(super) fn decided(self, n: usize, workers: usize) -> Self {
        match self {
            Self::Auto if workers > n => Self::Points(workers.min(Self::Rounds.width(n))),
            Self::Auto => Self::Serial,
            plan => plan,
        }
    }

    /// Returns the number of points for `n` parameters.
    pub(super) fn width(self, n: usize) -> usize {
        match self {
            Self::Auto | Self::Serial => 1,
            Self::Rounds => n + 4,
            Self::Points(points) => points,
        }
    }
}

/// Options of the Gauss-Newton method on interpolation models, for objectives with residuals (see
/// [`residuals`](crate::residuals)).
///
/// The x test measures the resolution of the model, or the step to its minimum if that step is longer. The
/// test uses the sum of this step and the possible error of the model if the sum is smaller. The f test
/// measures the decrease predicted by the model.
///
/// The method minimises the sum of squares of the residuals. If the cost of the objective is another
/// increasing function of this sum, the f test still measures the sum; the run reports the cost.
///
/// ```
/// use dfo::{LeastSquares, minimize, residuals};
///
/// let rosenbrock = |x: &[f64], out: &mut Vec<f64>| out.extend([10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
/// let report = minimize(residuals(rosenbrock)).start(&[-1.2, 1.0]).method(LeastSquares::default()).run()?;
/// assert!(report.is_success() && report.fun < 1e-12 && report.n_evaluations < 60, "{report}");
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct LeastSquares {
    /// First radius, in units of the parameter sizes; default 0.1.
    pub radius: f64,
    /// Number of points evaluated at once after the first n + 1; default [`StepPlan::Auto`].
    pub batch: StepPlan,
}

impl Default for LeastSquares {
    fn default() -> Self {
        Self { radius: 0.1, batch: StepPlan::Auto }
    }
}

impl LeastSquares {
    /// Sets the first radius.
    #[must_use]
    pub fn radius(mut self, radius: f64) -> Self {
        self.radius = radius;
        self
    }

    /// Sets the number of points evaluated at once.
    #[must_use]
    pub fn batch(mut self, points: usize) -> Self {
        self.batch = StepPlan::Points(points);
        self
    }

    /// Evaluates one point at a time ([`StepPlan::Serial`]).
    #[must_use]
    pub fn serial(mut self) -> Self {
        self.batch = StepPlan::Serial;
        self
    }

    /// Evaluates n + 4 points at once ([`StepPlan::Rounds`]).
    #[must_use]
    pub fn rounds(mut self) -> Self {
        self.batch = StepPlan::Rounds;
        self
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        if self.batch == StepPlan::Points(0) {
            return Err(Error::Option { name: "batch", value: 0.0, range: "at least 1" });
        }
        if self.radius > 0.0 && self.radius.is_finite() {
            return Ok(());
        }
        Err(Error::Option { name: "radius", value: self.radius, range: "above 0 and finite" })
    }
}
