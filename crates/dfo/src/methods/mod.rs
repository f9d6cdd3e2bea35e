//! Methods by name or number, for callers that choose at run time.

mod barrier;
mod cma_es;
mod differential_evolution;
mod genetic;
mod least_squares;
mod nelder_mead;
mod pattern_search;
mod shared;

pub use barrier::{Barrier, BarrierState};
pub use cma_es::{CmaBounds, CmaEs, CmaEsState, Restarts};
pub use differential_evolution::{
    Adaptive, Crossover, DifferentialEvolution, DifferentialEvolutionState, Repair, Scheme, Strategy, Weight,
};
pub use genetic::{Genetic, GeneticState, Selection};
pub use least_squares::{LeastSquares, LeastSquaresState};
pub use nelder_mead::{BatchPlan, Coefficients, InitialSimplex, NelderMead, NelderMeadState};
pub use pattern_search::{PatternSearch, PatternSearchState, PollPlan};

use crate::answer::Answers;
use crate::choices::Kind;
use crate::error::Error;
use crate::method::{Batch, Details, Method, MethodOptions, Setup, Status};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Any of the methods, with its options.
///
/// ```
/// use dfo::{AnyMethod, MethodOptions, minimize};
///
/// for name in AnyMethod::NAMES {
///     if name.parse::<AnyMethod>()?.needs_residuals() {
///         continue;
///     }
///     let report = minimize(|x: &[f64]| (x[0] - 0.3).powi(2))
///         .start(&[0.9])
///         .bounds(&[0.0], &[1.0])?
///         .method(name.parse::<AnyMethod>()?)
///         .seed(1)
///         .max_evaluations(500)
///         .run()?;
///     assert!(report.method == name && report.fun < 1e-4, "{report}");
/// }
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum AnyMethod {
    /// `nelder-mead`, number 1.
    NelderMead(NelderMead),
    /// `barrier`, number 2.
    Barrier(Barrier),
    /// `de` (L-SHADE) and `de-classic` (rand/1/bin), which is number 3.
    DifferentialEvolution(DifferentialEvolution),
    /// `ga`, number 4.
    Genetic(Genetic),
    /// `least-squares`, for objectives with residuals.
    LeastSquares(LeastSquares),
    /// `cma-es`.
    CmaEs(CmaEs),
    /// `pattern-search`.
    PatternSearch(PatternSearch),
}

/// A method's name, its number in `fmin`, and its default options.
type Listed = (&'static str, Option<usize>, fn() -> AnyMethod);

/// The methods: a new one is added here.
const LIST: [Listed; 8] = [
    ("nelder-mead", Some(1), || NelderMead::default().into()),
    ("barrier", Some(2), || Barrier::default().into()),
    ("de", None, || DifferentialEvolution::default().into()),
    ("de-classic", Some(3), || DifferentialEvolution::classic().into()),
    ("ga", Some(4), || Genetic::default().into()),
    ("least-squares", None, || LeastSquares::default().into()),
    ("cma-es", None, || CmaEs::default().into()),
    ("pattern-search", None, || PatternSearch::default().into()),
];

impl AnyMethod {
    /// All names.
    pub const NAMES: [&'static str; LIST.len()] = {
        let mut names = [""; LIST.len()];
        let mut k = 0;
        while k < names.len() {
            names[k] = LIST[k].0;
            k += 1;
        }
        names
    };

    /// The method where none is chosen: Nelder-Mead; differential evolution with integer parameters, the genetic
    /// algorithm with categorical ones.
    pub fn auto(kinds: &[Kind]) -> Self {
        if kinds.contains(&Kind::Categorical) {
            Self::Genetic(Genetic::default())
        } else if kinds.contains(&Kind::Integer) {
            Self::DifferentialEvolution(DifferentialEvolution::default())
        } else {
            Self::default()
        }
    }

    /// The name that it is chosen by.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NelderMead(_) => "nelder-mead",
            Self::Barrier(_) => "barrier",
            Self::DifferentialEvolution(options) => options.name(),
            Self::Genetic(_) => "ga",
            Self::LeastSquares(_) => "least-squares",
            Self::CmaEs(_) => "cma-es",
            Self::PatternSearch(_) => "pattern-search",
        }
    }

    /// The method that `fmin` of Gedda et al. (2012) has under this number: 1 Nelder-Mead, 2 sequential barrier,
    /// 3 differential evolution as the paper writes it, 4 genetic algorithm.
    ///
    /// # Errors
    /// Another number.
    pub fn by_number(number: usize) -> Result<Self, Error> {
        listed(&number.to_string(), |(_, known)| known == Some(number))
    }
}

/// The method of the list for which this holds.
fn listed(asked: &str, is_it: impl Fn((&str, Option<usize>)) -> bool) -> Result<AnyMethod, Error> {
    if let Some((.., options)) = LIST.iter().find(|(name, number, _)| is_it((name, *number))) {
        return Ok(options());
    }
    let known = LIST.map(|(name, number, _)| match number {
        Some(number) => format!("{name} ({number})"),
        None => name.to_owned(),
    });
    Err(Error::UnknownMethod { name: asked.to_owned(), known: known.join(", ") })
}

impl Default for AnyMethod {
    /// Nelder-Mead.
    fn default() -> Self {
        Self::NelderMead(NelderMead::default())
    }
}

impl FromStr for AnyMethod {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        listed(name, |(known, _)| known == name)
    }
}

macro_rules! from_options {
    ($($options:ident),*) => {
        $(impl From<$options> for AnyMethod {
            fn from(options: $options) -> Self {
                Self::$options(options)
            }
        })*
    };
}

from_options!(NelderMead, Barrier, DifferentialEvolution, Genetic, LeastSquares, CmaEs, PatternSearch);

/// The same call on whichever method it is.
macro_rules! each {
    ($any:expr, $options:ident => $call:expr) => {
        match $any {
            AnyMethod::NelderMead($options) => $call,
            AnyMethod::Barrier($options) => $call,
            AnyMethod::DifferentialEvolution($options) => $call,
            AnyMethod::Genetic($options) => $call,
            AnyMethod::LeastSquares($options) => $call,
            AnyMethod::CmaEs($options) => $call,
            AnyMethod::PatternSearch($options) => $call,
        }
    };
}

/// A running method of a kind that only the run knows.
pub struct BoxedMethod(Box<dyn Method + Send>);

impl BoxedMethod {
    /// Boxes a method.
    pub fn new(method: impl Method + Send + 'static) -> Self {
        Self(Box::new(method))
    }
}

impl fmt::Debug for BoxedMethod {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("BoxedMethod").field(&self.0.name()).finish()
    }
}

impl MethodOptions for AnyMethod {
    type Method = BoxedMethod;

    fn begin(&self, setup: &Setup) -> Result<BoxedMethod, Error> {
        each!(self, o => o.begin(setup).map(BoxedMethod::new))
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<BoxedMethod, Error> {
        each!(self, o => o.restore(setup, state).map(BoxedMethod::new))
    }

    fn needs_start(&self) -> bool {
        each!(self, o => o.needs_start())
    }

    fn needs_residuals(&self) -> bool {
        each!(self, o => o.needs_residuals())
    }

    fn describe(&self) -> Vec<(String, String)> {
        each!(self, o => o.describe())
    }

    fn plans_with_budget(&self) -> bool {
        each!(self, o => o.plans_with_budget())
    }

    fn starts_inside(&self) -> bool {
        each!(self, o => o.starts_inside())
    }

    fn default_limits(&self, n: usize) -> (Option<usize>, Option<usize>) {
        each!(self, o => o.default_limits(n))
    }

    fn default_cache(&self) -> usize {
        each!(self, o => o.default_cache())
    }
}

impl Method for BoxedMethod {
    fn name(&self) -> &'static str {
        self.0.name()
    }
    fn ask(&mut self, batch: &mut Batch) {
        self.0.ask(batch);
    }
    fn tell(&mut self, answers: &Answers) -> Result<(), Error> {
        self.0.tell(answers)
    }
    fn speculate(&mut self, wanted: usize, known: &dyn Fn(&[f64]) -> bool, batch: &mut Batch) {
        self.0.speculate(wanted, known, batch);
    }
    fn status(&self) -> Status {
        self.0.status()
    }
    fn details(&self) -> Details<'_> {
        self.0.details()
    }
    fn best(&self) -> Option<(&[f64], f64)> {
        self.0.best()
    }
    fn save(&self) -> Option<Vec<u8>> {
        self.0.save()
    }
}
