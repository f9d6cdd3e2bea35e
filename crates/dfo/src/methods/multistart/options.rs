//! Options of a search from several starts.

use crate::error::Error;
use crate::method_interface::interface::{Method, MethodOptions, Setup};
use crate::method_interface::sampling::Sampling;
use crate::methods::cma_es::CmaEs;
use crate::methods::differential_evolution::DifferentialEvolution;
use crate::methods::least_squares::LeastSquares;
use crate::methods::nelder_mead::NelderMead;
use serde::{Deserialize, Serialize};

/// The method of the local searches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Polish {
    /// [`NelderMead`] for up to five free parameters, [`CmaEs`] for more.
    #[default]
    Auto,
    /// [`LeastSquares`]: for objectives with residuals.
    LeastSquares,
    /// [`NelderMead`].
    NelderMead,
    /// [`CmaEs`], from a tenth of the sizes of the parameters.
    CmaEs,
}

/// Up to so many free parameters Nelder-Mead polishes, and half of the budget explores; above, CMA-ES
/// polishes, and three tenths explore. The even BBOB functions of `benches/dfo` have chosen this: of shares
/// 0.3, 0.5, 0.7 with either method, solved within 1000 n evaluations n = 2: 100 %, n = 5: 89 %, n = 10: 83
/// %.
const FEW: usize = 5;

/// Options of the search from several starts.
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
    /// Points of a sample (`N`); default 10 per parameter, at least 20.
    pub sample: Option<usize>,
    /// Distribution of the sample over the box; default a Sobol sequence, a Latin hypercube above 40
    /// parameters.
    pub sampling: Option<Sampling>,
    /// The method of the local searches.
    pub polish: Polish,
    /// Local searches that run at once, their points in one batch; default 4, and 1 after an exploration
    /// until that search has ended. Part of the path: it does not follow the workers. Until the first of them
    /// has ended, the others have at most half of a limit of evaluations.
    pub side_by_side: Option<usize>,
    /// Most local searches; default no limit but the budget.
    pub max_starts: Option<usize>,
    /// Share of the budget for differential evolution before the local searches, from 0 to below 1; default 0
    /// with least squares, else 0.5 for up to five free parameters and 0.3 for more. Nothing where there is
    /// no limit of evaluations.
    pub exploration: Option<f64>,
}

impl Multistart {
    /// Sets the points of a sample.
    #[must_use]
    pub fn sample(mut self, points: usize) -> Self {
        self.sample = Some(points);
        self
    }

    /// Sets how they are spread over the box.
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

    /// Sets how many local searches run at once.
    #[must_use]
    pub fn side_by_side(mut self, searches: usize) -> Self {
        self.side_by_side = Some(searches);
        self
    }

    /// Sets the most local searches.
    #[must_use]
    pub fn max_starts(mut self, starts: usize) -> Self {
        self.max_starts = Some(starts);
        self
    }

    /// Sets the share of the budget for differential evolution.
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

    /// Points of a sample for so many free parameters.
    pub(super) fn sample_of(&self, n: usize) -> usize {
        if n == 0 { 1 } else { self.sample.unwrap_or(n.saturating_mul(10).max(20)) }
    }

    /// The share of the exploration for so many free parameters.
    pub(super) fn exploration_of(&self, n: usize) -> f64 {
        let default = match self.polish {
            Polish::LeastSquares => 0.0,
            _ if n <= FEW => 0.5,
            _ => 0.3,
        };
        self.exploration.unwrap_or(default)
    }

    pub(super) fn sampling_of(&self, n: usize) -> Sampling {
        self.sampling.unwrap_or(if n > 40 { Sampling::LatinHypercube } else { Sampling::Sobol })
    }

    /// The local search from the start point of a problem; continued from a state where there is one.
    pub(super) fn search(
        &self,
        setup: &Setup,
        state: Option<&[u8]>,
    ) -> Result<Box<dyn Method + Send>, Error> {
        let few = setup.space.n_free() <= FEW;
        match self.polish {
            Polish::LeastSquares => boxed(&LeastSquares::default(), setup, state),
            Polish::NelderMead => boxed(&NelderMead::default(), setup, state),
            Polish::Auto if few => boxed(&NelderMead::default(), setup, state),
            Polish::Auto | Polish::CmaEs => boxed(&CmaEs::default().sigma(0.1), setup, state),
        }
    }

    /// The exploration with so many evaluations; continued from a state where there is one.
    pub(super) fn explore(
        &self,
        setup: &Setup,
        evaluations: usize,
        state: Option<&[u8]>,
    ) -> Result<Box<dyn Method + Send>, Error> {
        boxed(&DifferentialEvolution::default().budget(evaluations), setup, state)
    }
}

fn boxed<M>(options: &M, setup: &Setup, state: Option<&[u8]>) -> Result<Box<dyn Method + Send>, Error>
where
    M: MethodOptions,
    M::Method: Send + 'static,
{
    Ok(match state {
        Some(state) => Box::new(options.restore(setup, state)?),
        None => Box::new(options.begin(setup)?),
    })
}
