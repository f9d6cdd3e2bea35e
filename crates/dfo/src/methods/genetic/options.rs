//! Options of the genetic algorithm.

use crate::error::Error;
use crate::method_interface::sampling::Sampling;
use crate::methods::shared::population::MAX_MEMBERS;
use serde::{Deserialize, Serialize};

/// Selection of parents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Selection {
    /// With probabilities proportional to fitness, the difference between the 70 % quantile of the
    /// population's costs and the cost.
    #[default]
    FitnessProportional,
    /// The best of this number of members, drawn at random with repetition.
    Tournament(usize),
}

/// Options of the genetic algorithm.
///
/// Every free parameter requires two finite bounds. Parameters may be integers or categorical.
///
/// The tolerance tests measure the best distinct points of all generations. The number of these points is an
/// eighth of the population, at least n + 1 and at most 100. Copies of one point fill a population long
/// before the minimum is found. Mutation keeps some members far from the best. With integer or categorical
/// parameters, the tests measure the best eighth of the population.
///
/// Unless `resolution` is set, neighbouring codes are 1.5e-5 of the width of the box apart. Smaller distances
/// cannot be resolved, so a smaller relative `x_tol` never passes and the run ends as stalled. For up to ten
/// parameters, the method needs about 1200 evaluations per parameter to reach 1e-6 of a quadratic. With more
/// parameters, it needs more.
///
/// ```
/// use dfo::{Genetic, ParameterKind, minimize};
///
/// let cost = |x: &[f64]| (x[0] - 0.3).powi(2) + if x[1] == 2.0 { 0.0 } else { 1.0 };
/// let report = minimize(cost)
///     .bounds(&[-1.0, 0.0], &[1.0, 4.0])?
///     .kinds(&[ParameterKind::Continuous, ParameterKind::Categorical])
///     .method(Genetic::default())
///     .seed(1)
///     .max_evaluations(3000)
///     .run()?;
/// assert!(report.fun < 1e-3 && report.x[1] == 2.0);
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Genetic {
    /// Number of members; default 10 n, at least 50.
    pub population: Option<usize>,
    /// Selection of parents; default proportional to fitness.
    pub selection: Selection,
    /// Probability that a pair is crossed; default 0.7.
    pub crossover_rate: f64,
    /// Probability that a bit is flipped; default one bit per child on average, at most 0.1.
    pub mutation_rate: Option<f64>,
    /// Number of best members that survive unchanged; default 1.
    pub elite: usize,
    /// True to encode numbers in Gray code; default true.
    pub gray: bool,
    /// Requested step size per parameter, in the user's order and in `ln x` on a logarithmic scale. The
    /// number of bits is chosen so that the distance between neighbouring values does not exceed the step
    /// size. If empty (the default), each parameter has 16 bits. Discrete parameters have as many bits as
    /// their values require.
    pub resolution: Vec<f64>,
    /// Sampling method of the first population; default uniform.
    pub sampling: Sampling,
    /// True to include a given start point, exactly, in the first population; default true.
    pub include_start: bool,
    /// Number of generations without a better point after which the run ends; default 100.
    pub stall: Option<usize>,
}

impl Default for Genetic {
    fn default() -> Self {
        Self {
            population: None,
            selection: Selection::FitnessProportional,
            crossover_rate: 0.7,
            mutation_rate: None,
            elite: 1,
            gray: true,
            resolution: Vec::new(),
            sampling: Sampling::Uniform,
            include_start: true,
            stall: Some(100),
        }
    }
}

impl Genetic {
    /// Sets the number of members.
    #[must_use]
    pub fn population(mut self, members: usize) -> Self {
        self.population = Some(members);
        self
    }

    /// Sets the selection of parents.
    #[must_use]
    pub fn selection(mut self, selection: Selection) -> Self {
        self.selection = selection;
        self
    }

    /// Sets the probability that a pair is crossed.
    #[must_use]
    pub fn crossover_rate(mut self, rate: f64) -> Self {
        self.crossover_rate = rate;
        self
    }

    /// Sets the probability that a bit is flipped.
    #[must_use]
    pub fn mutation_rate(mut self, rate: f64) -> Self {
        self.mutation_rate = Some(rate);
        self
    }

    /// Sets the number of best members that survive unchanged.
    #[must_use]
    pub fn elite(mut self, members: usize) -> Self {
        self.elite = members;
        self
    }

    /// Sets whether numbers are encoded in Gray code.
    #[must_use]
    pub fn gray(mut self, gray: bool) -> Self {
        self.gray = gray;
        self
    }

    /// Sets the requested step size, one per parameter.
    #[must_use]
    pub fn resolution(mut self, steps: &[f64]) -> Self {
        self.resolution = steps.to_vec();
        self
    }

    /// Sets the sampling method of the first population.
    #[must_use]
    pub fn sampling(mut self, sampling: Sampling) -> Self {
        self.sampling = sampling;
        self
    }

    /// Sets whether a given start point is included in the first population.
    #[must_use]
    pub fn include_start(mut self, include: bool) -> Self {
        self.include_start = include;
        self
    }

    /// Sets the number of generations without a better point after which the run ends; `None` disables this
    /// limit.
    #[must_use]
    pub fn stall(mut self, generations: Option<usize>) -> Self {
        self.stall = generations;
        self
    }

    pub(super) fn check(&self, members: usize) -> Result<(), Error> {
        let rate = |value: f64| (0.0..=1.0).contains(&value);
        let (mutation, size) = (self.mutation_rate.unwrap_or(0.0), members as f64);
        let tournament = match self.selection {
            Selection::Tournament(size) => size,
            Selection::FitnessProportional => 1,
        };
        for (name, value, good, range) in [
            ("crossover_rate", self.crossover_rate, rate(self.crossover_rate), "from 0 to 1"),
            ("mutation_rate", mutation, rate(mutation), "from 0 to 1"),
            ("population", size, (2..=MAX_MEMBERS).contains(&members), "from 2 to a million"),
            ("elite", self.elite as f64, self.elite < members, "below the number of members"),
            (
                "selection",
                tournament as f64,
                (1..=members).contains(&tournament),
                "from 1 to the number of members",
            ),
            ("stall", 0.0, self.stall != Some(0), "at least 1"),
        ] {
            if !good {
                return Err(Error::Option { name, value, range });
            }
        }
        Ok(())
    }
}
