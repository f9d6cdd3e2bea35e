//! Options of multistart.

use crate::error::Error;
use crate::method_interface::interface::{Method, MethodOptions, Setup};
use crate::method_interface::sampling::Sampling;
use crate::methods::cma_es::CmaEs;
use crate::methods::differential_evolution::DifferentialEvolution;
use crate::methods::least_squares::LeastSquares;
use crate::methods::nelder_mead::NelderMead;
use crate::methods::quadratic_model::QuadraticModel;
use serde::{Deserialize, Serialize};

/// Method of the local searches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Polish {
    /// [`NelderMead`] for up to five free parameters, [`CmaEs`] for more, [`QuadraticModel`] with nonlinear
    /// constraints.
    #[default]
    Auto,
    /// [`LeastSquares`]: for objectives with residuals.
    LeastSquares,
    /// [`NelderMead`].
    NelderMead,
    /// [`CmaEs`], with an initial standard deviation of a tenth of the parameter sizes.
    CmaEs,
}

/// Maximum number of free parameters for which Nelder-Mead polishes and half of the budget explores. With
/// more parameters, CMA-ES polishes and three tenths explore. Tuned on the even-numbered BBOB functions of
/// `benches/dfo`, with shares 0.3, 0.5 and 0.7 and both methods. Solved within 1000 n evaluations: n = 2: 100
/// %, n = 5: 89 %, n = 10: 83 %.
const FEW: usize = 5;

/// Options of multistart, a search from several starts.
///
/// ```
/// use dfo::{Multistart, minimize};
///
/// // Four minima, two of them as deep as each other.
/// let cost = |x: &[f64]| (x[0] * x[0] - 1.0).powi(2) + (x[1] * x[1] - 1.0).powi(2) + 0.1 * x[0];
/// let method = Multistart::default().exploration(0.0);
/// let report = minimize(cost).bounds(&[-2.0; 2], &[2.0; 2])?.method(method).seed(1).run()?;
/// assert!(report.is_success() && report.optima.len() == 4, "{report}");
/// assert!(report.optima[0].x[0] < 0.0 && report.optima.iter().all(|o| o.n_starts >= 1));
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Multistart {
    /// Number of points per sample (`N`); default 10 per parameter, at least 20.
    pub sample: Option<usize>,
    /// Sampling method in the box; default a Sobol sequence, or a Latin hypercube above 40 parameters.
    pub sampling: Option<Sampling>,
    /// Method of the local searches.
    pub polish: Polish,
    /// Number of local searches that run in parallel, with their points in one batch. Default 4; after an
    /// exploration, 1 until the first search has ended. The number does not depend on the workers, because it
    /// changes the path. Until the first search has ended, the others use at most half of the evaluation
    /// limit.
    pub side_by_side: Option<usize>,
    /// Maximum number of local searches; by default limited only by the budget.
    pub max_starts: Option<usize>,
    /// Fraction of the budget for differential evolution before the local searches, at least 0 and below 1.
    /// Default 0 with least squares and with nonlinear equalities, otherwise 0.5 for up to five free
    /// parameters and 0.3 for more. Zero if the number of evaluations is not limited.
    pub exploration: Option<f64>,
}

impl Multistart {
    /// Sets the number of points per sample.
    #[must_use]
    pub fn sample(mut self, points: usize) -> Self {
        self.sample = Some(points);
        self
    }

    /// Sets the sampling method in the box.
    #[must_use]
    pub fn sampling(mut self, sampling: Sampling) -> Self {
        self.sampling = Some(sampling);
        self
    }

    /// Sets the method of the local searches.
    #[must_use]
    pub fn polish(mut self, polish: Polish) -> Self {
        self.polish = polish;
        self
    }

    /// Sets the number of local searches that run in parallel.
    #[must_use]
    pub fn side_by_side(mut self, searches: usize) -> Self {
        self.side_by_side = Some(searches);
        self
    }

    /// Sets the maximum number of local searches.
    #[must_use]
    pub fn max_starts(mut self, starts: usize) -> Self {
        self.max_starts = Some(starts);
        self
    }

    /// Sets the fraction of the budget for differential evolution.
    #[must_use]
    pub fn exploration(mut self, share: f64) -> Self {
        self.exploration = Some(share);
        self
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        if let Some(value) = self.exploration.filter(|share| !(0.0..1.0).contains(share)) {
            return Err(Error::Option { name: "exploration", value, range: "from 0 to below 1" });
        }
        let counts =
            [("sample", self.sample), ("side_by_side", self.side_by_side), ("max_starts", self.max_starts)];
        match counts.into_iter().find(|(_, count)| *count == Some(0)) {
            Some((name, _)) => Err(Error::Option { name, value: 0.0, range: "at least 1" }),
            None => Ok(()),
        }
    }

    /// Returns the number of points per sample for `n` free parameters.
    pub(super) fn sample_of(&self, n: usize) -> usize {
        if n == 0 { 1 } else { self.sample.unwrap_or(n.saturating_mul(10).max(20)) }
    }

    /// Returns the fraction of the budget for the exploration with `n` free parameters.
    pub(super) fn exploration_of(&self, n: usize, equalities: bool) -> f64 {
        let default = match self.polish {
            Polish::LeastSquares => 0.0,
            _ if equalities => 0.0,
            _ if n <= FEW => 0.5,
            _ => 0.3,
        };
        self.exploration.unwrap_or(default)
    }

    pub(super) fn sampling_of(&self, n: usize) -> Sampling {
        self.sampling.unwrap_or(if n > 40 { Sampling::LatinHypercube } else { Sampling::Sobol })
    }

    /// Returns the local search from the start point of a setup, or restores it from a state.
    pub(super) fn search(
        &self,
        setup: &Setup,
        state: Option<&[u8]>,
    ) -> Result<Box<dyn Method + Send>, Error> {
        let few = setup.space.n_free() <= FEW;
        match self.polish {
            Polish::LeastSquares => boxed(&LeastSquares::default().serial(), setup, state),
            Polish::NelderMead => boxed(&NelderMead::default(), setup, state),
            Polish::Auto if !setup.constraints.nonlinear.is_empty() => {
                boxed(&QuadraticModel::default(), setup, state)
            }
            Polish::Auto if few => boxed(&NelderMead::default(), setup, state),
            Polish::Auto | Polish::CmaEs => boxed(&CmaEs::default().sigma(0.1), setup, state),
        }
    }

    /// Returns the exploration with the given number of evaluations, or restores it from a state.
    pub(super) fn explore(
        &self,
        setup: &Setup,
        evaluations: usize,
        state: Option<&[u8]>,
    ) -> Result<Box<dyn Method + Send>, Error> {
        boxed(&DifferentialEvolution::default().budget(evaluations), setup, state)
    }
}

fn boxed(
    options: &impl MethodOptions,
    setup: &Setup,
    state: Option<&[u8]>,
) -> Result<Box<dyn Method + Send>, Error> {
    Ok(match state {
        Some(state) => Box::new(options.restore(setup, state)?),
        None => Box::new(options.begin(setup)?),
    })
}
