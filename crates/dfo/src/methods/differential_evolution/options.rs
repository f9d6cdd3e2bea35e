//! Options of differential evolution.

use crate::error::Error;
use crate::method_interface::sampling::Sampling;
use serde::{Deserialize, Serialize};

/// Strategy for donor vectors. `r1`, `r2`, ... are different members, drawn for each target `i`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Strategy {
    /// `x_r1 + F (x_r2 - x_r3)`.
    #[default]
    Rand1,
    /// `x_best + F (x_r1 - x_r2)`.
    Best1,
    /// `x_i + F (x_best - x_i) + F (x_r1 - x_r2)`.
    CurrentToBest1,
    /// `x_r1 + F (x_r2 - x_r3) + F (x_r4 - x_r5)`.
    Rand2,
}

impl Strategy {
    /// Returns the number of members drawn in addition to the target.
    pub(super) fn n_drawn(self) -> usize {
        match self {
            Self::Best1 | Self::CurrentToBest1 => 2,
            Self::Rand1 => 3,
            Self::Rand2 => 5,
        }
    }
}

/// Crossover of target and donor to form the trial vector. At least one coordinate always comes from the
/// donor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Crossover {
    /// Takes each coordinate from the donor with the crossover probability.
    #[default]
    Binomial,
    /// Takes a contiguous run of coordinates from the donor, wrapping at the end. The run continues with the
    /// crossover probability.
    Exponential,
}

/// The differential weight `F`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum DifferentialWeight {
    /// A constant weight.
    Fixed(f64),
    /// Drawn uniformly from a range once per generation.
    Dither(f64, f64),
}

/// Repair of coordinates outside the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Repair {
    /// Moved to the midpoint between the target and the violated bound.
    #[default]
    Midpoint,
    /// Mirrored at the bound.
    Mirror,
    /// Moved to the bound.
    Clamp,
    /// Redrawn from the whole range.
    Resample,
}

/// Options of L-SHADE. The defaults are the authors' values, except for a memory of five.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Adaptive {
    /// Fraction of the population that counts as best; default 0.11.
    pub p_best: f64,
    /// Number of entries in the memories of `F` and `CR`; default 5.
    pub memory: usize,
    /// Size of the archive, in units of the population; default 2.6.
    pub archive: f64,
    /// Number of members at the end of the budget; default 4.
    pub final_population: usize,
}

impl Default for Adaptive {
    fn default() -> Self {
        Self { p_best: 0.11, memory: 5, archive: 2.6, final_population: 4 }
    }
}

/// Scheme for trial vectors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Scheme {
    /// With constant weight and probability.
    Classic {
        /// Strategy for donors.
        strategy: Strategy,
        /// Crossover of target and donor.
        crossover: Crossover,
        /// Differential weight, from 0 to 2.
        weight: DifferentialWeight,
        /// Crossover probability, from 0 to 1.
        probability: f64,
    },
    /// L-SHADE: factors from memories, an archive, and a population that shrinks over the budget.
    Adaptive(Adaptive),
}

/// Options of differential evolution. The default is L-SHADE; [`classic`](Self::classic) is rand/1/bin.
///
/// Every free parameter requires two finite bounds. Parameters may be integers.
///
/// ```
/// use dfo::{DifferentialEvolution, minimize};
///
/// let rastrigin = |x: &[f64]| -> f64 {
///     x.iter().map(|x| x * x + 10.0 - 10.0 * (std::f64::consts::TAU * x).cos()).sum()
/// };
/// let report = minimize(rastrigin)
///     .bounds(&[-5.0; 2], &[4.0; 2])?
///     .method(DifferentialEvolution::default())
///     .seed(1)
///     .max_evaluations(4000)
///     .run()?;
/// assert!(report.fun < 1e-6 && report.seed == Some(1));
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct DifferentialEvolution {
    /// Scheme for trial vectors; default L-SHADE.
    pub scheme: Scheme,
    /// Number of members of the first population, by default at least 20. The default for L-SHADE is `18 n (b
    /// / 10 000)^0.3`, at most 18 n, where `b n` is the planned number of evaluations. The default for the
    /// classic scheme is 10 n.
    pub population: Option<usize>,
    /// Members of the first population, at least as many as the strategy needs. Each member is a complete
    /// point in the user's units. Default `None`: members are sampled. If given, the population size is the
    /// number of members, as with the array `init` of SciPy's `differential_evolution`. The start point and
    /// the points of an earlier run are evaluated only if they are members.
    #[serde(default)]
    pub initial_population: Option<Vec<Vec<f64>>>,
    /// Sampling method of the first population; default Latin hypercube, or uniform
    /// for [`classic`](Self::classic).
    pub sampling: Sampling,
    /// Repair of coordinates outside the box; default [`Repair::Midpoint`].
    pub repair: Repair,
    /// True to include a given start point in the first population. Default true, for
    /// [`classic`](Self::classic) false.
    pub include_start: bool,
    /// Number of evaluations over which L-SHADE shrinks its population. Default: the limit of the run, or
    /// `2000 (n + 1)` if the run has no limit. The budget is a plan, not a limit. After the budget, the run
    /// continues with the last members.
    pub budget: Option<usize>,
    /// Number of trials created ahead of selection at any time. Default 15 n, at most 75, for L-SHADE, and 0
    /// for [`classic`](Self::classic). With lag 0, a generation is created when the previous one is
    /// completely known.
    pub lag: Option<usize>,
}

impl Default for DifferentialEvolution {
    fn default() -> Self {
        Self {
            scheme: Scheme::Adaptive(Adaptive::default()),
            population: None,
            initial_population: None,
            sampling: Sampling::LatinHypercube,
            repair: Repair::Midpoint,
            include_start: true,
            budget: None,
            lag: None,
        }
    }
}

impl DifferentialEvolution {
    /// Returns the method as defined by Gedda et al. (2012, section 4.2.1): rand/1/bin with constant weight
    /// and probability. The first population is uniform in the box. The weight is 0.8 and the probability 0.9
    /// (Storn and Price 1997).
    pub fn classic() -> Self {
        Self {
            scheme: Scheme::Classic {
                strategy: Strategy::Rand1,
                crossover: Crossover::Binomial,
                weight: DifferentialWeight::Fixed(0.8),
                probability: 0.9,
            },
            sampling: Sampling::Uniform,
            include_start: false,
            ..Self::default()
        }
    }

    /// Sets the classic scheme with this strategy, crossover, weight and probability.
    #[must_use]
    pub fn with(
        mut self,
        strategy: Strategy,
        crossover: Crossover,
        weight: DifferentialWeight,
        probability: f64,
    ) -> Self {
        self.scheme = Scheme::Classic { strategy, crossover, weight, probability };
        self
    }

    /// Sets the number of members of the first population.
    #[must_use]
    pub fn population(mut self, members: usize) -> Self {
        self.population = Some(members);
        self
    }

    /// Sets the members of the first population, see
    /// [`DifferentialEvolution::initial_population`](field@Self::initial_population).
    #[must_use]
    pub fn initial_population(mut self, members: Vec<Vec<f64>>) -> Self {
        self.initial_population = Some(members);
        self
    }

    /// Sets the sampling method of the first population.
    #[must_use]
    pub fn sampling(mut self, sampling: Sampling) -> Self {
        self.sampling = sampling;
        self
    }

    /// Sets the repair of coordinates outside the box.
    #[must_use]
    pub fn repair(mut self, repair: Repair) -> Self {
        self.repair = repair;
        self
    }

    /// Sets whether a given start point is included in the first population.
    #[must_use]
    pub fn include_start(mut self, include: bool) -> Self {
        self.include_start = include;
        self
    }

    /// Sets the number of evaluations over which L-SHADE shrinks its population.
    #[must_use]
    pub fn budget(mut self, evaluations: usize) -> Self {
        self.budget = Some(evaluations);
        self
    }

    /// Sets the number of trials created ahead of selection.
    #[must_use]
    pub fn lag(mut self, trials: usize) -> Self {
        self.lag = Some(trials);
        self
    }

    /// Returns the number of trials created ahead of selection for `n` free parameters.
    pub(super) fn lag_of(&self, n: usize) -> usize {
        self.lag.unwrap_or(match self.scheme {
            Scheme::Classic { .. } => 0,
            Scheme::Adaptive(_) => (15 * n).min(MOST_LAG),
        })
    }

    /// Returns the number of members of the first population for `n` free parameters and the planned number
    /// of evaluations.
    pub(super) fn population_of(&self, n: usize, budget: usize) -> usize {
        let default = match self.scheme {
            Scheme::Classic { .. } => 10 * n,
            Scheme::Adaptive(_) => {
                let share = budget as f64 / (1e4 * n.max(1) as f64);
                (18.0 * n as f64 * share.powf(POPULATION_POWER).min(1.0)).round() as usize
            }
        };
        let given = self.initial_population.as_ref().map(Vec::len);
        given.or(self.population).unwrap_or(default.max(20))
    }

    /// Returns the name of the method with these options.
    pub fn name(&self) -> &'static str {
        match self.scheme {
            Scheme::Classic { .. } => "de-classic",
            Scheme::Adaptive(_) => "de",
        }
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        let within = |name, value: f64, low: f64, high: f64, range| {
            if value >= low && value <= high { Ok(()) } else { Err(Error::Option { name, value, range }) }
        };
        if self.budget == Some(0) {
            return Err(Error::Option { name: "budget", value: 0.0, range: "at least 1" });
        }
        within("lag", self.lag.unwrap_or(0) as f64, 0.0, 1e6, "from 0 to a million")?;
        match self.scheme {
            Scheme::Classic { weight, probability, .. } => {
                within("crossover probability", probability, 0.0, 1.0, "from 0 to 1")?;
                match weight {
                    DifferentialWeight::Fixed(f) => within("differential weight", f, 0.0, 2.0, "from 0 to 2"),
                    DifferentialWeight::Dither(low, high) => {
                        within("differential weight", low, 0.0, 2.0, "from 0 to 2")?;
                        within("differential weight", high, low, 2.0, "from the lower end to 2")
                    }
                }
            }
            Scheme::Adaptive(a) => {
                within("p_best", a.p_best, f64::MIN_POSITIVE, 1.0, "above 0, at most 1")?;
                within("archive", a.archive, 0.0, 100.0, "from 0 to 100")?;
                within("memory", a.memory as f64, 1.0, 1e6, "from 1 to a million")?;
                within("final population", a.final_population as f64, 4.0, 1e6, "from 4 to a million")
            }
        }
    }
}

/// Maximum default number of trials created ahead of selection. With 75, 16 workers are 80 to 90 % busy if
/// one evaluation in ten takes ten times as long (tests/all/flow.rs).
const MOST_LAG: usize = 75;

/// Exponent of the first population of L-SHADE. The base is the planned evaluations per parameter, relative
/// to the authors' 10 000. The power is multiplied by the authors' 18 n. The values 0, 0.3 and 0.4 were
/// compared on twelve functions similar to BBOB, with 300 n to 3000 n evaluations. The exponent 0.4 reaches
/// more targets but fails on Gallagher's peaks.
const POPULATION_POWER: f64 = 0.3;

/// Returns the number of evaluations that L-SHADE plans for `n` free parameters if the run has no limit. The
/// authors use 10 000 n (Tanabe and Fukunaga, CEC 2014), for functions that cost nothing. A fifth of that is
/// enough for the shifted Rastrigin, Rosenbrock and ellipsoid functions with 5 and 10 parameters.
pub(super) fn planned(n: usize) -> usize {
    2000usize.saturating_mul(n + 1)
}
