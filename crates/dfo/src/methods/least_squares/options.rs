//! Options of least squares.

use crate::error::Error;
use serde::{Deserialize, Serialize};

/// Options of the Gauss-Newton method on interpolation models, for objectives with residuals (see
/// [`residuals`](crate::residuals)).
///
/// The x test measures the resolution of the model, or the step to the model's minimum where that is longer; or
/// that step with the error that the model may have, where that is less. The f test measures the decrease that
/// the model predicts.
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
#[non_exhaustive]
pub struct LeastSquares {
    /// The first radius, in units of the sizes of the parameters; default 0.1.
    pub radius: f64,
    /// Points evaluated at once after the first n + 1; default one.
    pub batch: Option<usize>,
}

impl Default for LeastSquares {
    fn default() -> Self {
        Self { radius: 0.1, batch: None }
    }
}

impl LeastSquares {
    /// Sets the first radius.
    #[must_use]
    pub fn radius(mut self, radius: f64) -> Self {
        self.radius = radius;
        self
    }

    /// Sets the number of points that are evaluated at once.
    #[must_use]
    pub fn batch(mut self, points: usize) -> Self {
        self.batch = Some(points);
        self
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        if self.batch == Some(0) {
            return Err(Error::Option { name: "batch", value: 0.0, range: "at least 1" });
        }
        if self.radius > 0.0 && self.radius.is_finite() {
            return Ok(());
        }
        Err(Error::Option { name: "radius", value: self.radius, range: "above 0 and finite" })
    }
}
