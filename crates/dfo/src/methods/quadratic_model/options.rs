//! Options of quadratic models.

use crate::error::Error;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Up to so many parameters the interpolation conditions are solved anew at each step, which costs little,
/// and loses no digits.
pub(super) const MOST_FROM_SCRATCH: usize = 20;

/// Options of the trust region on quadratic interpolation models, for costs that are smooth but for noise.
///
/// The x test measures the smallest trust region at which the model was exhausted, the f test the decrease
/// that it still predicts there.
///
/// ```
/// use dfo::{QuadraticModel, minimize};
///
/// let rosenbrock = |x: &[f64]| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2);
/// let report = minimize(rosenbrock).start(&[-1.2, 1.0]).method(QuadraticModel::default()).run()?;
/// assert!(report.is_success() && report.fun < 1e-10 && report.n_evaluations < 150, "{report}");
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct QuadraticModel {
    /// The first trust region, in units of the sizes of the parameters; default 0.2 in a box, 0.1 where a
    /// parameter has no or one bound.
    pub radius: Option<f64>,
    /// The most points that the model interpolates, from n + 2 to (n + 1)(n + 2)/2 for n free parameters. The
    /// search begins with at most 2n + 1 and keeps later ones as long as there is room. Default 4n + 1, but
    /// not more than there may be, and 2n + 1 for more than 20 parameters.
    pub points: Option<usize>,
    /// Number of times in a row that the search starts anew around its best point, with the first trust
    /// region, where steps that the model takes for good do not lower the cost (noise, kinks), before it
    /// gives up; a start that finds a lower cost begins the count anew. Where noise or kinks have shown, so
    /// many starts in a row must end without, to have converged. Default 3.
    pub restarts: usize,
    /// True if the search goes on as [`NelderMead`](crate::NelderMead), from its best point, where the model
    /// shows noise or kinks: its curvature grows as its region shrinks, or its steps fail at several
    /// resolutions. Then the message of the result says so, and its tests are those of the simplex. Default
    /// false; [`Auto`](crate::Auto) sets it.
    #[serde(default)]
    pub hand_over: bool,
}

impl Default for QuadraticModel {
    fn default() -> Self {
        Self { radius: None, points: None, restarts: 3, hand_over: false }
    }
}

impl QuadraticModel {
    /// Sets the first trust region.
    #[must_use]
    pub fn radius(mut self, radius: f64) -> Self {
        self.radius = Some(radius);
        self
    }

    /// Sets the most interpolation points, see [`QuadraticModel::points`](field@Self::points).
    #[must_use]
    pub fn points(mut self, points: usize) -> Self {
        self.points = Some(points);
        self
    }

    /// Sets the number of restarts in a row that may bring nothing, see
    /// [`QuadraticModel::restarts`](field@Self::restarts).
    #[must_use]
    pub fn restarts(mut self, restarts: usize) -> Self {
        self.restarts = restarts;
        self
    }

    /// Sets whether Nelder-Mead takes over where noise or kinks show, see
    /// [`QuadraticModel::hand_over`](field@Self::hand_over).
    #[must_use]
    pub fn hand_over(mut self, hand_over: bool) -> Self {
        self.hand_over = hand_over;
        self
    }

    /// The first trust region in this space. Without far bounds: in a box the sizes are widths, else they are
    /// magnitudes.
    pub(super) fn first_radius(&self, space: &Space) -> f64 {
        let boxed = (0..space.n_free()).all(|k| space.width(k).is_some());
        self.radius.unwrap_or(if boxed { 0.2 } else { 0.1 })
    }

    /// The most interpolation points for `n` free parameters.
    ///
    /// # Errors
    /// An option out of its range.
    pub(super) fn resolve(&self, n: usize) -> Result<usize, Error> {
        if let Some(value) = self.radius.filter(|radius| !(*radius > 0.0 && radius.is_finite())) {
            return Err(Error::Option { name: "radius", value, range: "above 0 and finite" });
        }
        let range = (n + 2).min(2 * n + 1)..=(n + 1).saturating_mul(n + 2) / 2;
        let default = (if n > MOST_FROM_SCRATCH { 2 * n + 1 } else { 4 * n + 1 }).min(*range.end());
        match self.points {
            Some(points) if !range.contains(&points) => {
                let range = "from n + 2 to (n + 1)(n + 2)/2, n the number of free parameters";
                Err(Error::Option { name: "points", value: points as f64, range })
            }
            points => Ok(points.unwrap_or(default)),
        }
    }
}
