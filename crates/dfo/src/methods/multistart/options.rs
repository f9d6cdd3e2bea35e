//! What the user may choose about a search from several starts.

use crate::error::Error;
use crate::method::{Method, MethodOptions, Setup};
use crate::methods::differential_evolution::DifferentialEvolution;
use crate::methods::least_squares::LeastSquares;
use crate::methods::nelder_mead::NelderMead;
use crate::sampling::Sampling;
use serde::{Deserialize, Serialize};

/// The method of the local searches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Polish {
    /// [`LeastSquares`]: for objectives with residuals.
    LeastSquares,
    /// [`NelderMead`].
    #[default]
    NelderMead,
}

/// Options of the search from several starts.
///
/// ```
/// use dfo::{Multistart, minimize};
///
/// // Four minima, two of them as deep as each other.
/// let cost = |x: &[f64]| (x[0] * x[0] - 1.0).powi(2) + (x[1] * x[1] - 1.0).powi(2) + 0.1 * x[0];
/// let report = minimize(cost).bounds(&[-2.0; 2], &[2.0; 2])?.method(Multistart::default()).seed(1).run()?;
/// assert!(report.is_success() && report.optima.len() == 4, "{report}");
/// assert!(report.optima[0].x[0] < 0.0 && report.optima.iter().all(|o| o.n_starts >= 1));
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Multistart {
    /// Points of a sample (`N`); default 10 per parameter, at least 20.
    pub sample: Option<usize>,
    /// How they are spread over the box; default a Sobol sequence, a Latin hypercube above 40 parameters.
    pub sampling: Option<Sampling>,
    /// The method of the local searches; default Nelder-Mead.
    pub polish: Polish,
    /// Local searches that run at once, their points in one batch; default 4. Part of the path: it does not follow the workers.
    pub side_by_side: usize,
    /// Most local searches; default no limit but the budget.
    pub max_starts: Option<usize>,
    /// Share of the budget for differential evolution before the local searches, from 0 (default) to below 1. Where there is no limit
    /// of evaluations, 0.
    pub exploration: f64,
}

impl Default for Multistart {
    fn default() -> Self {
        Self {
            sample: None,
            sampling: None,
            polish: Polish::default(),
            side_by_side: 4,
            max_starts: None,
            exploration: 0.0,
        }
    }
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
        self.side_by_side = searches;
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
        self.exploration = share;
        self
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        if !(0.0..1.0).contains(&self.exploration) {
            return Err(Error::Option {
                name: "exploration",
                value: self.exploration,
                range: "from 0 to below 1",
            });
        }
        let counts = [
            ("sample", self.sample),
            ("side_by_side", Some(self.side_by_side)),
            ("max_starts", self.max_starts),
        ];
        match counts.into_iter().find(|(_, count)| *count == Some(0)) {
            Some((name, _)) => Err(Error::Option { name, value: 0.0, range: "at least 1" }),
            None => Ok(()),
        }
    }

    /// Points of a sample for so many free parameters.
    pub(super) fn sample_of(&self, n: usize) -> usize {
        if n == 0 { 1 } else { self.sample.unwrap_or(n.saturating_mul(10).max(20)) }
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
        match self.polish {
            Polish::LeastSquares => boxed(&LeastSquares::default(), setup, state),
            Polish::NelderMead => boxed(&NelderMead::default(), setup, state),
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
