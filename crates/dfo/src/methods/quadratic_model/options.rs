//! Options of quadratic models.

use crate::error::Error;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Maximum number of parameters for which the interpolation conditions are solved from scratch at each step.
/// This is cheap and loses no accuracy.
pub(super) const MOST_FROM_SCRATCH: usize = 20;

/// Options of the trust region on quadratic interpolation models, for costs that are smooth except for noise.
///
/// The x test measures the smallest trust region at which the model was exhausted. The f test measures the
/// decrease that the model still predicts there.
///
/// If a box is too wide to determine the size of a parameter (see [`typical_size`](crate::typical_size)), no
/// box determines a size: all linear parameters without a given size have the size |x0|.
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
    /// First trust-region radius, in units of the parameter sizes. Default 0.2 in a box, 0.1 if any parameter
    /// has no or only one bound.
    pub radius: Option<f64>,
    /// Maximum number of points that the model interpolates, from n + 2 to (n + 1)(n + 2)/2 for n free
    /// parameters. The search starts with at most 2n + 1 points and keeps later ones up to this number.
    /// Default 4n + 1, limited to the valid range, and 2n + 1 for more than 20 parameters.
    pub points: Option<usize>,
    /// Maximum number of consecutive restarts without a lower cost; default 3. If predicted decreases do not
    /// lower the cost (noise, kinks), the search restarts around its best point. Each restart uses the first
    /// trust region. A start that finds a lower cost resets the count. After noise or kinks have been
    /// detected, this number of consecutive starts must end without them for convergence.
    pub restarts: usize,
    /// True to continue with another method from the best point if the model shows noise or kinks. They are
    /// detected if the curvature grows as the region shrinks, or if steps fail at several resolutions.
    /// [`CmaEs`](crate::CmaEs) continues if they hide the curvature within a fifth of the first radius, as
    /// strong noise and steps do. Otherwise [`NelderMead`](crate::NelderMead) continues. The message of the
    /// result then reports the change, and the tests are the tests of the second method. Default false;
    /// [`Auto`](crate::Auto) sets it.
    #[serde(default)]
    pub hand_over: bool,
}

impl Default for QuadraticModel {
    fn default() -> Self {
        Self { radius: None, points: None, restarts: 3, hand_over: false }
    }
}

impl QuadraticModel {
    /// Sets the first trust-region radius.
    #[must_use]
    pub fn radius(mut self, radius: f64) -> Self {
        self.radius = Some(radius);
        self
    }

    /// Sets the maximum number of interpolation points, see [`QuadraticModel::points`](field@Self::points).
    #[must_use]
    pub fn points(mut self, points: usize) -> Self {
        self.points = Some(points);
        self
    }

    /// Sets the maximum number of consecutive restarts without a lower cost, see
    /// [`QuadraticModel::restarts`](field@Self::restarts).
    #[must_use]
    pub fn restarts(mut self, restarts: usize) -> Self {
        self.restarts = restarts;
        self
    }

    /// Sets whether another method continues if noise or kinks are detected, see
    /// [`QuadraticModel::hand_over`](field@Self::hand_over).
    #[must_use]
    pub fn hand_over(mut self, hand_over: bool) -> Self {
        self.hand_over = hand_over;
        self
    }

    /// Returns the first trust-region radius in this space, which has no far bounds. In a box, the parameter
    /// sizes are widths; otherwise they are magnitudes.
    pub(super) fn first_radius(&self, space: &Space) -> f64 {
        let boxed = (0..space.n_free()).all(|k| space.width(k).is_some());
        self.radius.unwrap_or(if boxed { 0.2 } else { 0.1 })
    }

    /// Returns the maximum number of interpolation points for `n` free parameters.
    ///
    /// # Errors
    /// Returns an error if an option is out of its range.
    pub(super) fn resolve(&self, n: usize) -> Result<usize, Error> {
        if let Some(value) = self.radius.filter(|radius| !(*radius > 0.0 && radius.is_finite())) {
            return Err(Error::Option { name: "radius", value, range: "above 0 and finite" });
        }
        let range = (n + 2).min(2 * n + 1)..=(n + 1).saturating_mul(n + 2) / 2;
        let default = (if n > MOST_FROM_SCRATCH { 2 * n + 1 } else { 4 * n + 1 }).min(*range.end());
        match self.points {
            Some(points) if !range.contains(&points) => {
                let range = "from n + 2 to (n + 1)(n + 2)/2, where n is the number of free parameters";
                Err(Error::Option { name: "points", value: points as f64, range })
            }
            points => Ok(points.unwrap_or(default)),
        }
    }
}
