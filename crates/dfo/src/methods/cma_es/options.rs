//! Options of CMA-ES.

use crate::error::Error;
use crate::methods::shared::population::MAX_MEMBERS;
use serde::{Deserialize, Serialize};

/// Restart policy: the search may begin anew, from another mean with another population, when it has come to
/// an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Restarts {
    /// The run ends when its tests pass, as with every other method.
    #[default]
    None,
    /// With twice the population each time (Auger and Hansen, CEC 2005).
    Ipop,
    /// With twice the population, or with a small one and a small step size, whichever kind has had fewer
    /// evaluations (Hansen, GECCO workshop 2009).
    Bipop,
}

/// Treatment of points that are drawn outside of the bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum CmaBounds {
    /// Mirrored, with a parabola within a margin at the bound, so that a cost that goes down towards it has a
    /// smooth minimum there (c-cmaes, boundary transformation).
    #[default]
    Smooth,
    /// Mirrored.
    Mirror,
}

/// Options of CMA-ES.
///
/// It starts from the start point, which is the first individual; without one, from the middle of the box. Of
/// the points of an earlier run it takes the best. With restarts it goes on until a limit ends the run (at
/// the latest when the population has been doubled nine times), from points drawn in the box; along a
/// parameter without a box they are drawn around the start point, with the size of the parameter as standard
/// deviation.
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
    /// Individuals of a generation, at least 2; default `4 + floor(3 ln n)` for `n` free parameters
    /// (tutorial, table 1), at least three quarters of the lag.
    pub population: Option<usize>,
    /// The first standard deviation along each parameter, in units of its size: the nominal value where one
    /// was given, else the width of the box, else |x0|, else 1. One unit for all, so that it is a pure number
    /// and the unit of `x_tol`. Default 0.3, as the tutorial (section B.2) advises for the width of a box,
    /// and as Nelder-Mead takes it for its first simplex.
    pub sigma: f64,
    /// Restarts of the search when it has come to an end; default [`Restarts::None`]: where a simulation
    /// takes minutes, a run that has converged must end, and other minima are searched for on request only.
    pub restarts: Restarts,
    /// Treatment of bounds; default [`CmaBounds::Smooth`].
    pub bounds_handling: CmaBounds,
    /// Number of individuals that are drawn ahead of selection at any time, at most one and a half
    /// populations: farther ahead the search does not converge. Default 0: a generation is drawn when the one
    /// before it is known whole, which takes the fewest evaluations and is best for one worker. With four
    /// times the workers these are busy where one evaluation in ten takes ten times as long
    /// (benches/scaling.md).
    pub lag: usize,
}

impl Default for CmaEs {
    fn default() -> Self {
        Self {
            population: None,
            sigma: 0.3,
            restarts: Restarts::None,
            bounds_handling: CmaBounds::Smooth,
            lag: 0,
        }
    }
}

impl CmaEs {
    /// Sets the number of individuals.
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

    /// Sets whether the search begins anew when it has come to an end.
    #[must_use]
    pub fn restarts(mut self, restarts: Restarts) -> Self {
        self.restarts = restarts;
        self
    }

    /// Sets how bounds are kept to.
    #[must_use]
    pub fn bounds_handling(mut self, handling: CmaBounds) -> Self {
        self.bounds_handling = handling;
        self
    }

    /// Sets the number of individuals that are drawn ahead of selection.
    #[must_use]
    pub fn lag(mut self, individuals: usize) -> Self {
        self.lag = individuals;
        self
    }

    /// Individuals for `n` free parameters, once everything is checked.
    pub(super) fn members(&self, n: usize) -> Result<usize, Error> {
        if !(self.sigma > 0.0 && self.sigma.is_finite()) {
            return Err(Error::Option { name: "sigma", value: self.sigma, range: "positive and finite" });
        }
        if self.lag > MAX_MEMBERS {
            let range = "from 0 to a million";
            return Err(Error::Option { name: "lag", value: self.lag as f64, range });
        }
        let of_lag = self.lag - self.lag / 4;
        let members = self.population.unwrap_or(of_lag.max(4 + (3.0 * (n.max(1) as f64).ln()) as usize));
        if !(2..=MAX_MEMBERS).contains(&members) {
            let range = "from 2 to a million";
            return Err(Error::Option { name: "population", value: members as f64, range });
        }
        Ok(if n == 0 { 1 } else { members })
    }
}
