//! Options of CMA-ES.

use super::integers::has_integers;
use crate::error::Error;
use crate::methods::shared::population::MAX_MEMBERS;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Restart policy. After the search has ended, it may restart from another mean with another population size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Restarts {
    /// No restarts: the run ends when its tests pass, as with every other method.
    #[default]
    None,
    /// Restarts with twice the population each time (Auger and Hansen, CEC 2005).
    Ipop,
    /// Restarts with twice the population, or with a small population and a small step size. The kind that
    /// has used fewer evaluations is next (Hansen, GECCO workshop 2009).
    Bipop,
}

/// Treatment of points drawn outside the bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum CmaBounds {
    /// Mirrored, with a parabola within a margin at the bound. A cost that decreases towards the bound then
    /// has a smooth minimum there (c-cmaes, boundary transformation).
    #[default]
    Smooth,
    /// Mirrored.
    Mirror,
}

/// Options of CMA-ES.
///
/// The search starts from the start point, which is the first individual. Without a start point, it starts
/// from the middle of the box. From the points of an earlier run, it uses the best. With restarts, the search
/// continues until a limit ends the run, or until the population has been doubled nine times. Restarts begin
/// at points drawn in the box. Along a parameter without a box, they are drawn around the start point. The
/// standard deviation is then the size of the parameter. Parameters may be integers.
///
/// ```
/// use dfo::{CmaEs, minimize};
///
/// let ellipsoid = |x: &[f64]| (x[0] + x[1]).powi(2) + 1e6 * (x[0] - x[1]).powi(2);
/// let report = minimize(ellipsoid).start(&[3.0, 2.0]).method(CmaEs::default()).seed(1).run()?;
/// assert!(report.is_success() && report.fun < 1e-9 && report.n_evaluations < 1000, "{report}");
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct CmaEs {
    /// Number of individuals per generation, at least 2. Default `4 + floor(3 ln n)` for `n` free parameters
    /// (tutorial, table 1), one and a half times as many with integers, and at least three quarters of the
    /// lag.
    pub population: Option<usize>,
    /// First standard deviation along each parameter, in units of its size; default 0.3. The size is the
    /// nominal value if given, otherwise the width of the box, otherwise |x0|, otherwise 1. The common unit
    /// makes `sigma` dimensionless, and `x_tol` has the same unit. The tutorial (section B.2) recommends 0.3
    /// of the width of a box. Nelder-Mead uses the same value for its first simplex.
    pub sigma: f64,
    /// Restarts after the search has ended; default [`Restarts::None`]. If a simulation takes minutes, a
    /// converged run must end. Searches for other minima run only on request.
    pub restarts: Restarts,
    /// Treatment of bounds; default [`CmaBounds::Smooth`].
    pub bounds_handling: CmaBounds,
    /// Number of individuals drawn ahead of selection at any time; default 0. At most one and a half
    /// populations, because the search does not converge with a larger lag. With lag 0, a generation is drawn
    /// after the previous one is completely known. This needs the fewest evaluations and is best for one
    /// worker. A lag of four times the number of workers keeps them busy. This holds even if one evaluation
    /// in ten takes ten times as long (benches/scaling.md).
    pub lag: usize,
    /// Maximum number of successive restarts without a better point. After them, the run ends. Default
    /// `None`: no limit. A point counts as better if it decreases the cost by more than the fraction `f_tol`.
    #[serde(default)]
    pub patience: Option<usize>,
}

impl Default for CmaEs {
    fn default() -> Self {
        Self {
            population: None,
            sigma: 0.3,
            restarts: Restarts::None,
            bounds_handling: CmaBounds::Smooth,
            lag: 0,
            patience: None,
        }
    }
}

impl CmaEs {
    /// Sets the number of individuals per generation.
    #[must_use]
    pub fn population(mut self, individuals: usize) -> Self {
        self.population = Some(individuals);
        self
    }

    /// Sets the first standard deviation, in units of the sizes of the parameters.
    #[must_use]
    pub fn sigma(mut self, sigma: f64) -> Self {
        self.sigma = sigma;
        self
    }

    /// Sets the restart policy.
    #[must_use]
    pub fn restarts(mut self, restarts: Restarts) -> Self {
        self.restarts = restarts;
        self
    }

    /// Sets the treatment of points outside the bounds.
    #[must_use]
    pub fn bounds_handling(mut self, handling: CmaBounds) -> Self {
        self.bounds_handling = handling;
        self
    }

    /// Sets the number of individuals drawn ahead of selection.
    #[must_use]
    pub fn lag(mut self, individuals: usize) -> Self {
        self.lag = individuals;
        self
    }

    /// Sets the maximum number of successive restarts without a better point.
    #[must_use]
    pub fn patience(mut self, restarts: usize) -> Self {
        self.patience = Some(restarts);
        self
    }

    /// Returns the number of individuals for a space after checking the options.
    pub(super) fn members(&self, space: &Space) -> Result<usize, Error> {
        let n = space.n_free();
        if !(self.sigma > 0.0 && self.sigma.is_finite()) {
            return Err(Error::Option { name: "sigma", value: self.sigma, range: "positive and finite" });
        }
        if self.lag > MAX_MEMBERS {
            let range = "from 0 to a million";
            return Err(Error::Option { name: "lag", value: self.lag as f64, range });
        }
        let of_lag = self.lag - self.lag / 4;
        let of_tutorial = 4 + (3.0 * (n.max(1) as f64).ln()) as usize;
        let default = match has_integers(space) {
            true => of_tutorial + of_tutorial / 2,
            false => of_tutorial,
        };
        let members = self.population.unwrap_or(of_lag.max(default));
        if !(2..=MAX_MEMBERS).contains(&members) {
            let range = "from 2 to a million";
            return Err(Error::Option { name: "population", value: members as f64, range });
        }
        Ok(if n == 0 { 1 } else { members })
    }
}
