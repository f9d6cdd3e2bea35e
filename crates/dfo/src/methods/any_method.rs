//! Methods by name or number, for callers that choose one at run time, and the automatic choice for a
//! problem.

use super::barrier::Barrier;
use super::boxed::BoxedMethod;
use super::cma_es::{CmaEs, Restarts};
use super::differential_evolution::DifferentialEvolution;
use super::genetic::Genetic;
use super::least_squares::LeastSquares;
use super::multistart::{Multistart, Polish};
use super::nelder_mead::NelderMead;
use super::nsga2::Nsga2;
use super::option_names::{COMMON, collect, described, place, tagged, unknown, values};
use super::pattern_search::PatternSearch;
use super::quadratic_model::QuadraticModel;
use crate::error::Error;
use crate::method_interface::interface::{MethodOptions, ProblemClass, Setup};
use crate::problem::option_texts;
use crate::values::choices::{ParameterKind, Search};
use crate::values::nearest::{edits, folded};
use crate::values::record::{Record, Value};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::str::FromStr;

/// Any optimization method, with its options.
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
    /// `barrier`, number 2. Requires at least one bound.
    Barrier(Barrier),
    /// `de` or `differential-evolution` (L-SHADE), and `de-classic` (rand/1/bin), which is number 3.
    DifferentialEvolution(DifferentialEvolution),
    /// `ga` or `genetic`, number 4.
    Genetic(Genetic),
    /// `least-squares`, for objectives with residuals.
    LeastSquares(LeastSquares),
    /// `cma-es`.
    CmaEs(CmaEs),
    /// `multistart`.
    Multistart(Multistart),
    /// `auto`: the run chooses the method.
    Auto(Auto),
    /// `quadratic-model`, for smooth costs.
    QuadraticModel(QuadraticModel),
    /// `pattern-search`, for costs with kinks. Inefficient for smooth costs.
    PatternSearch(PatternSearch),
    /// `nsga2`, for several criteria. It has no name that users choose, because it does not minimise a cost.
    Nsga2(Nsga2),
}

/// A method of the list.
struct Listed {
    name: &'static str,
    /// Number of the method in `fmin`.
    number: Option<usize>,
    /// Alternative names.
    also: &'static [&'static str],
    /// Methods of other tools that solve the same problems in another way. An error for such a name suggests
    /// this method.
    similar: &'static [&'static str],
    options: fn() -> AnyMethod,
}

/// The list of methods. Add new methods here.
const LIST: [Listed; 10] = [
    Listed {
        name: "nelder-mead",
        number: Some(1),
        also: &["nm"],
        similar: &["simplex", "fmin", "sbplx", "subplex"],
        options: || NelderMead::default().into(),
    },
    Listed {
        name: "barrier",
        number: Some(2),
        also: &["sequential-barrier"],
        similar: &["interior-point"],
        options: || Barrier::default().into(),
    },
    Listed {
        name: "de",
        number: None,
        also: &["differential-evolution", "l-shade"],
        similar: &["jade", "shade", "sade", "jso"],
        options: || DifferentialEvolution::default().into(),
    },
    Listed {
        name: "de-classic",
        number: Some(3),
        also: &["differential-evolution-classic", "rand1bin"],
        similar: &[],
        options: || DifferentialEvolution::classic().into(),
    },
    Listed {
        name: "ga",
        number: Some(4),
        also: &["genetic", "genetic-algorithm"],
        similar: &["evolution", "evolutionary"],
        options: || Genetic::default().into(),
    },
    Listed {
        name: "least-squares",
        number: None,
        also: &[],
        similar: &[
            "lsq",
            "leastsq",
            "levenberg-marquardt",
            "lm",
            "trf",
            "dogbox",
            "dfo-ls",
            "pounders",
            "gauss-newton",
        ],
        options: || LeastSquares::default().into(),
    },
    Listed {
        name: "cma-es",
        number: None,
        also: &["cma"],
        similar: &["ipop-cma-es", "bipop-cma-es", "evolution-strategy"],
        options: || CmaEs::default().into(),
    },
    Listed {
        name: "multistart",
        number: None,
        also: &[],
        similar: &["basinhopping", "dual-annealing", "shgo", "mlsl", "brute"],
        options: || Multistart::default().into(),
    },
    Listed {
        name: "quadratic-model",
        number: None,
        also: &[],
        similar: &[
            "cobyqa",
            "bobyqa",
            "newuoa",
            "uobyqa",
            "cobyla",
            "powell",
            "cg",
            "bfgs",
            "l-bfgs-b",
            "tnc",
            "slsqp",
            "newton-cg",
            "trust-constr",
            "dogleg",
            "trust-ncg",
            "trust-exact",
            "trust-krylov",
        ],
        options: || QuadraticModel::default().into(),
    },
    Listed {
        name: "pattern-search",
        number: None,
        also: &[],
        similar: &["mads", "orthomads", "nomad", "compass-search", "direct-search", "direct", "hooke-jeeves"],
        options: || PatternSearch::default().into(),
    },
];

/// Maximum number of parameters for which `auto` chooses quadratic models. With more parameters, the models
/// take about a millisecond per evaluation and solve smooth problems (`benches/overhead.rs -- solved`). They
/// were not compared with Nelder-Mead at those sizes.
const MOST_FOR_MODELS: usize = 60;

/// Makes one call on the method that `$any` contains.
macro_rules! each {
    ($any:expr, $options:ident => $call:expr) => {
        match $any {
            AnyMethod::NelderMead($options) => $call,
            AnyMethod::Barrier($options) => $call,
            AnyMethod::DifferentialEvolution($options) => $call,
            AnyMethod::Genetic($options) => $call,
            AnyMethod::LeastSquares($options) => $call,
            AnyMethod::CmaEs($options) => $call,
            AnyMethod::Multistart($options) => $call,
            AnyMethod::Auto($options) => $call,
            AnyMethod::QuadraticModel($options) => $call,
            AnyMethod::PatternSearch($options) => $call,
            AnyMethod::Nsga2($options) => $call,
        }
    };
}

impl AnyMethod {
    /// True if the method searches for the best of several minima.
    pub fn is_global(&self) -> bool {
        match self {
            Self::DifferentialEvolution(_) | Self::Genetic(_) | Self::CmaEs(_) | Self::Multistart(_) => true,
            Self::Auto(auto) => auto.search == Search::Global,
            _ => false,
        }
    }

    /// Names of all methods, without `auto`.
    pub const NAMES: [&'static str; LIST.len()] = {
        let mut names = [""; LIST.len()];
        let mut k = 0;
        while k < names.len() {
            names[k] = LIST[k].name;
            k += 1;
        }
        names
    };

    /// Returns the name by which the method is chosen.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NelderMead(_) => "nelder-mead",
            Self::Barrier(_) => "barrier",
            Self::DifferentialEvolution(options) => options.name(),
            Self::Genetic(_) => "ga",
            Self::LeastSquares(_) => "least-squares",
            Self::CmaEs(_) => "cma-es",
            Self::Multistart(_) => "multistart",
            Self::Auto(_) => "auto",
            Self::QuadraticModel(_) => "quadratic-model",
            Self::PatternSearch(_) => "pattern-search",
            Self::Nsga2(_) => Nsga2::NAME,
        }
    }

    /// Returns the names of all methods, without `auto`.
    pub fn names() -> impl ExactSizeIterator<Item = &'static str> {
        LIST.iter().map(|method| method.name)
    }

    /// Returns all methods, each with all names by which it can be chosen.
    #[cfg(feature = "schema")]
    pub(crate) fn listed() -> impl Iterator<Item = (Vec<&'static str>, Self)> {
        LIST.iter()
            .map(|method| (method.also.iter().chain([&method.name]).copied().collect(), (method.options)()))
    }

    /// Returns the JSON schema of each option.
    #[cfg(feature = "schema")]
    pub(crate) fn option_schemas(
        &self,
        generator: &mut schemars::SchemaGenerator,
    ) -> serde_json::Map<String, serde_json::Value> {
        let names = self.option_names().unwrap_or_default();
        each!(self, options => super::schema::option_schemas(options, &names, generator))
    }

    /// Returns the method with this number in `fmin` of Gedda et al. (2012). The numbers are 1 Nelder-Mead, 2
    /// sequential barrier, 3 differential evolution (as defined in the paper) and 4 genetic algorithm.
    ///
    /// # Errors
    /// Returns an error for any other number.
    pub fn by_number(number: usize) -> Result<Self, Error> {
        listed(&number.to_string(), |method| method.number == Some(number))
    }
}

/// Returns the first method of the list that satisfies the predicate, or the error for an unknown method.
fn listed(given: &str, is_it: impl Fn(&Listed) -> bool) -> Result<AnyMethod, Error> {
    if let Some(method) = LIST.iter().find(|method| is_it(method)) {
        return Ok((method.options)());
    }
    let available = LIST.iter().map(|Listed { name, number, .. }| match number {
        Some(number) => format!("{name} ({number})"),
        None => (*name).to_owned(),
    });
    let available: Vec<String> = available.chain(["auto".to_owned()]).collect();
    let hint = meant(given).map_or_else(String::new, |name| format!("; did you mean '{name}'?"));
    Err(Error::UnknownMethod { name: given.to_owned(), hint, available: available.join(", ") })
}

/// Returns the method most likely meant by an unknown name. This method solves the same problems as the named
/// one, or its name differs by a few letters.
fn meant(given: &str) -> Option<&'static str> {
    let given = folded(given);
    if let Some(method) = LIST.iter().find(|m| m.similar.iter().any(|name| folded(name) == given)) {
        return Some(method.name);
    }
    let names = LIST.iter().flat_map(|m| {
        m.also.iter().chain(m.similar).chain([&m.name]).map(move |name| (m.name, folded(name)))
    });
    let near =
        names.map(|(name, listed_name)| (edits(&given, &listed_name), listed_name.len(), name)).min()?;
    // A third of the letters may differ.
    (3 * near.0 <= near.1.max(given.chars().count())).then_some(near.2)
}

impl Default for AnyMethod {
    /// Returns Nelder-Mead.
    fn default() -> Self {
        Self::NelderMead(NelderMead::default())
    }
}

impl FromStr for AnyMethod {
    type Err = Error;

    /// Parses the name of a method: short, full, or as in SciPy. Case and separators between words are
    /// ignored.
    fn from_str(name: &str) -> Result<Self, Error> {
        let given = folded(name);
        if given == "auto" {
            return Ok(Self::Auto(Auto::default()));
        }
        listed(name, |method| {
            method.also.iter().chain([&method.name]).any(|name_of_method| folded(name_of_method) == given)
        })
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

from_options!(
    NelderMead,
    Barrier,
    DifferentialEvolution,
    Genetic,
    LeastSquares,
    CmaEs,
    Multistart,
    QuadraticModel,
    PatternSearch,
    Auto,
    Nsga2
);

/// Number of successive restarts without a better point after which a search with integers ends
/// (`benches/dfo/mixed_integer.py`).
const INTEGER_PATIENCE: usize = 4;

/// Returns the method for problems in which all parameters are integers.
fn integer_search() -> CmaEs {
    CmaEs::default().restarts(Restarts::Ipop).patience(INTEGER_PATIENCE)
}

/// Leaves the choice of the method to the run ([`AnyMethod::chosen_for`]). The report records the chosen
/// method and the reason.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default)]
#[non_exhaustive]
pub struct Auto {
    /// Goal of the search: the minimum nearest to the start (default), or the best minimum in the box.
    pub search: Search,
    /// Options for the chosen method, by name. Options that only Nelder-Mead supports select Nelder-Mead. A
    /// batch plan that only Nelder-Mead supports does the same.
    #[cfg_attr(feature = "schema", schemars(with = "std::collections::BTreeMap<String, serde_json::Value>"))]
    pub options: Record,
}

impl AnyMethod {
    /// Returns options that leave the choice of the method for this search to the run.
    ///
    /// ```
    /// use dfo::{AnyMethod, Search, minimize, residuals};
    ///
    /// let rosenbrock = |x: &[f64], out: &mut Vec<f64>| out.extend([10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]]);
    /// let report = minimize(residuals(rosenbrock)).start(&[-1.2, 1.0]).method(AnyMethod::auto(Search::Local)).run()?;
    /// assert_eq!((&*report.method, report.method_reason.as_deref()), ("least-squares", Some("the objective returns residuals")));
    /// # Ok::<(), dfo::Error>(())
    /// ```
    pub fn auto(search: Search) -> Self {
        Self::Auto(Auto { search, ..Auto::default() })
    }

    /// Returns the method for a problem of this class, with the reason:
    ///
    /// - Problems with residuals use [`LeastSquares`]. It needs a tenth of the evaluations of methods that
    ///   use only the cost.
    /// - Costs of at most 60 parameters use [`QuadraticModel`]. If its model shows kinks or weak noise, it
    ///   hands over to [`NelderMead`], and for strong noise or steps to [`CmaEs`]
    ///   ([`QuadraticModel::hand_over`](field@QuadraticModel::hand_over)). It needs at most half of the
    ///   evaluations of Nelder-Mead for smooth costs, and as many for others (`benches/choice.rs`).
    /// - Searches for the best minimum in a box use [`Multistart`].
    /// - Problems with only integer parameters of more than two values use [`CmaEs`] with restarts. It solves
    ///   as many of them as [`DifferentialEvolution`], with a fifth to a third of the evaluations
    ///   (`benches/dfo/mixed_integer.py`). Problems with integer and continuous parameters use
    ///   [`DifferentialEvolution`], which solves more of them. Problems with categorical parameters use
    ///   [`Genetic`].
    /// - With constraints, a method that supports them is chosen. A global search uses [`Multistart`], which
    ///   solves 236 of 240 problems with nonlinear constraints, and [`DifferentialEvolution`] 203
    ///   (`benches/constrained.rs`). If neither [`LeastSquares`] nor [`QuadraticModel`] supports the
    ///   constraints, [`CmaEs`] is used.
    ///
    /// # Errors
    /// Returns an error if a global search is requested and a free parameter lacks a finite bound. The error
    /// reports the first such parameter.
    pub fn chosen_for(class: &ProblemClass<'_>) -> Result<(Self, &'static str), Error> {
        let chosen = |method: AnyMethod, reason: &'static str| Ok((method, reason));
        let reason = |class: &ProblemClass<'_>, reasons: [&'static str; 2]| {
            reasons[usize::from(class.linear || class.nonlinear)]
        };
        if class.kinds.contains(&ParameterKind::Categorical) {
            return chosen(
                Genetic::default().into(),
                reason(
                    class,
                    ["some parameters are categorical", "some parameters are categorical, with constraints"],
                ),
            );
        }
        if class.kinds.contains(&ParameterKind::Integer) {
            // Differential evolution solves more of the binary problems.
            let is_discrete = |(k, kind): (usize, &ParameterKind)| {
                let width = class.upper[k] - class.lower[k];
                *kind == ParameterKind::Integer && width > 1.0 || width == 0.0
            };
            if class.equalities {
                return chosen(
                    CmaEs::default().into(),
                    "some parameters are integers, with nonlinear equalities",
                );
            }
            if class.linear || class.nonlinear {
                return chosen(
                    DifferentialEvolution::default().into(),
                    "some parameters are integers, with constraints",
                );
            }
            return match class.kinds.iter().enumerate().all(is_discrete) {
                true => {
                    chosen(integer_search().into(), "all parameters are integers with more than two values")
                }
                false => chosen(DifferentialEvolution::default().into(), "some parameters are integers"),
            };
        }
        if let (Search::Global, Some(index)) = (class.search, class.open()) {
            let (lower, upper) = (class.lower[index], class.upper[index]);
            return Err(Error::NeedsBox { method: "a global search", index, lower, upper });
        }
        if class.linear || class.nonlinear {
            return Ok(Self::chosen_for_constraints(class));
        }
        match (class.search, class.residuals) {
            (Search::Global, true) => chosen(
                Multistart::default().polish(Polish::LeastSquares).into(),
                "a global search with residuals uses least squares from several start points",
            ),
            (Search::Global, false) => chosen(
                Multistart::default().into(),
                "a global search without residuals uses differential evolution, then local searches from \
                 several start points",
            ),
            (Search::Local, true) => {
                chosen(LeastSquares::default().into(), "the objective returns residuals")
            }
            (Search::Local, false) if class.lower.len() > MOST_FOR_MODELS => chosen(
                NelderMead::default().into(),
                "the objective returns a cost without residuals, and has too many parameters for a fast \
                 quadratic model",
            ),
            (Search::Local, false) => chosen(
                QuadraticModel::default().hand_over(true).into(),
                "the objective returns a cost without residuals: a quadratic model while the cost is smooth, \
                 Nelder-Mead if it has kinks, CMA-ES if it has strong noise or steps",
            ),
        }
    }

    /// Returns the method for continuous parameters with constraints, with the reason.
    fn chosen_for_constraints(class: &ProblemClass<'_>) -> (Self, &'static str) {
        let (least_squares, model) = (LeastSquares::default(), QuadraticModel::default());
        let supports =
            |linear: bool, nonlinear: bool| (linear || !class.linear) && (nonlinear || !class.nonlinear);
        let fits = supports(least_squares.supports_linear(), least_squares.supports_nonlinear());
        let models = supports(model.supports_linear(), model.supports_nonlinear());
        match (class.search, class.residuals) {
            (Search::Global, _) if class.nonlinear => (
                Multistart::default().into(),
                "a global search with nonlinear constraints uses models of the cost and of the constraints \
                 from several start points",
            ),
            (Search::Global, true) if fits => (
                Multistart::default().polish(Polish::LeastSquares).into(),
                "a global search with residuals and linear constraints uses least squares from several \
                 feasible start points",
            ),
            (Search::Global, _) => (
                Multistart::default().into(),
                "a global search with linear constraints uses differential evolution, then local searches \
                 from several feasible start points",
            ),
            (Search::Local, true) if fits => match class.nonlinear {
                true => (least_squares.into(), "the objective returns residuals, with nonlinear constraints"),
                false => (least_squares.into(), "the objective returns residuals, with linear constraints"),
            },
            (Search::Local, true) if models && class.nonlinear && class.lower.len() <= MOST_FOR_MODELS => (
                model.into(),
                "least squares does not support nonlinear constraints: quadratic models of the cost and of \
                 the constraints",
            ),
            (Search::Local, _) if models && class.lower.len() <= MOST_FOR_MODELS => match class.nonlinear {
                true => (
                    model.into(),
                    "the objective returns a cost without residuals, with nonlinear constraints: models of \
                     the cost and of the constraints",
                ),
                false => (
                    model.hand_over(true).into(),
                    "the objective returns a cost without residuals, with linear constraints: a quadratic \
                     model while the cost is smooth, other methods if it has kinks, noise or steps",
                ),
            },
            (Search::Local, _) if class.nonlinear => {
                (CmaEs::default().into(), "nonlinear constraints: CMA-ES with an augmented Lagrangian")
            }
            (Search::Local, _) => (
                CmaEs::default().into(),
                "linear constraints: CMA-ES moves points to the nearest feasible point",
            ),
        }
    }

    /// Returns the method chosen from the setup alone. The setup does not record whether the objective has
    /// residuals.
    fn of_setup(auto: &Auto, setup: &Setup) -> Result<Self, Error> {
        let space = &setup.space;
        let mut kinds = vec![ParameterKind::Continuous; space.n()];
        for (k, &index) in space.free().iter().enumerate() {
            kinds[index] = space.kind(k);
        }
        let (lower, upper) = (space.bounds().lower(), space.bounds().upper());
        let class = ProblemClass {
            lower,
            upper,
            kinds: &kinds,
            residuals: false,
            search: auto.search,
            linear: space.has_linear(),
            nonlinear: !setup.constraints.nonlinear.is_empty(),
            equalities: setup.constraints.has_equalities(),
        };
        Ok(auto.choose(&class)?.0)
    }
}

impl AnyMethod {
    /// Returns the names of the options of this method.
    pub fn option_names(&self) -> Result<BTreeSet<String>, Error> {
        let mut names = BTreeSet::new();
        collect(&Value::of(self)?, &mut names);
        // Only L-SHADE uses the budget for planning.
        if self.name() == "de-classic" {
            names.remove("budget");
        }
        Ok(names)
    }

    /// Returns the options of this method by name, in the form that [`with_options`](Self::with_options)
    /// accepts. For `auto`, returns only the options set.
    ///
    /// # Errors
    /// Returns an error if the options cannot be serialised.
    pub fn option_record(&self) -> Result<Record, Error> {
        if let Self::Auto(auto) = self {
            return Ok(auto.options.clone());
        }
        let names = match self {
            Self::Nsga2(_) => self.option_names()?,
            _ => self.name().parse::<Self>()?.option_names()?,
        };
        let mut options = Record::new();
        values(&Value::of(self)?, &names, &mut options);
        Ok(options)
    }

    /// Returns this method with the given options. All other options are unchanged.
    ///
    /// # Errors
    /// Returns an error if the method does not support an option, or if a value is invalid for its option.
    pub fn with_options(self, options: &Record) -> Result<Self, Error> {
        if let Self::Auto(Auto { search, .. }) = self {
            // `None` leaves the option at the default of the chosen method.
            let given = options.iter().filter(|(_, value)| **value != Value::Nothing);
            let options = given.map(|(option, value)| (option.clone(), value.clone())).collect();
            return Ok(Self::Auto(Auto { search, options }));
        }
        let (name, available) = (self.name(), self.option_names()?);
        let (mut method, mut form) = (self.clone(), Value::of(&self)?);
        for (option, given) in options {
            let place = if available.contains(option) { place(&mut form, option) } else { None };
            let Some(place) = place else { return Err(unknown(name, option, &available).into()) };
            let is_optional = *place == Value::Nothing;
            *place = tagged(option, given.clone());
            method = form.read("method").map_err(|mut error| {
                if let Some(what) = described(option) {
                    error.must_be(what);
                }
                if is_optional {
                    error.or_none();
                }
                error.of_method(name, option, given)
            })?;
        }
        Ok(method)
    }

    /// True if the method supports this option with this value.
    fn takes(&self, option: &str, value: &Value) -> bool {
        self.clone().with_options(&Record::from([(option.to_owned(), value.clone())])).is_ok()
    }

    /// Returns the names of all options, of any method and of every run.
    pub fn all_option_names() -> Result<BTreeSet<String>, Error> {
        let mut names: BTreeSet<String> = COMMON.into_iter().map(str::to_owned).collect();
        for method in &LIST {
            names.extend((method.options)().option_names()?);
        }
        Ok(names)
    }
}

impl Auto {
    /// Returns the method for a problem with the options set, and the reason. Options that only
    /// Nelder-Mead supports select Nelder-Mead, if it can solve the problem.
    fn choose(&self, class: &ProblemClass<'_>) -> Result<(AnyMethod, String), Error> {
        let simplex = AnyMethod::from(NelderMead::default());
        let can_take_simplex = !class.nonlinear
            && self.search == Search::Local
            && class.kinds.iter().all(|kind| *kind == ParameterKind::Continuous);
        let (mut method, reason) = AnyMethod::chosen_for(&ProblemClass { search: self.search, ..*class })?;
        let mut reason = reason.to_owned();
        let of_method = method.option_names()?;
        let mut options = self.options.clone();
        let plan = match options.get("batch") {
            Some(plan @ Value::Text(word)) if !method.takes("batch", plan) => {
                Some((plan.clone(), word.clone()))
            }
            _ => None,
        };
        if plan.as_ref().is_some_and(|(_, word)| word.eq_ignore_ascii_case("auto")) {
            // Use the plan of the chosen method.
            options.remove("batch");
        } else if can_take_simplex
            && let Some((_, word)) = plan.filter(|(plan, _)| simplex.takes("batch", plan))
        {
            (method, reason) = (simplex, format!("the batch plan '{word}' belongs to nelder-mead"));
        } else if can_take_simplex && let Some(option) = options.keys().find(|o| !of_method.contains(*o)) {
            let of_simplex = simplex.option_names()?;
            if options.keys().all(|option| of_simplex.contains(option)) {
                (method, reason) = (simplex, format!("the option '{option}' belongs to nelder-mead"));
            }
        } else if class.kinds.contains(&ParameterKind::Integer)
            && let Some(option) = options.keys().find(|o| !of_method.contains(*o))
        {
            let evolution = AnyMethod::from(DifferentialEvolution::default());
            let of_evolution = evolution.option_names()?;
            if !class.kinds.contains(&ParameterKind::Categorical)
                && options.keys().all(|option| of_evolution.contains(option))
            {
                (method, reason) = (evolution, format!("the option '{option}' belongs to de"));
            }
        }
        Ok((method.with_options(&options)?, reason))
    }
}

impl MethodOptions for Auto {
    type Method = BoxedMethod;

    fn begin(&self, setup: &Setup) -> Result<BoxedMethod, Error> {
        AnyMethod::of_setup(self, setup)?.begin(setup)
    }

    fn restore(&self, setup: &Setup, state: &[u8]) -> Result<BoxedMethod, Error> {
        AnyMethod::of_setup(self, setup)?.restore(setup, state)
    }

    // The chosen method rejects constraints that it does not support.
    fn supports_linear(&self) -> bool {
        true
    }

    fn supports_nonlinear(&self) -> bool {
        true
    }

    fn supports_equalities(&self) -> bool {
        true
    }

    fn describe(&self) -> Vec<(String, String)> {
        option_texts::fields(self)
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

    fn chosen(&self, class: &ProblemClass<'_>) -> Result<Option<(Self, String)>, Error> {
        match self {
            Self::Auto(auto) => auto.choose(class).map(Some),
            _ => Ok(None),
        }
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

    fn supports_linear(&self) -> bool {
        each!(self, o => o.supports_linear())
    }

    fn supports_nonlinear(&self) -> bool {
        each!(self, o => o.supports_nonlinear())
    }

    fn supports_equalities(&self) -> bool {
        each!(self, o => o.supports_equalities())
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
