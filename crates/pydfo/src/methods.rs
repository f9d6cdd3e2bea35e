//! The options of a method from a Python dict: every entry checked for its type, unknown ones refused with those known.

use crate::settings;
use dfo::{
    AnyMethod, BatchPlan, BoundsHandling, Coefficients, Crossover, InitialSimplex, Kind, MethodOptions,
    Repair, Sampling, Scheme, Selection, Strategy, Weight,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict};

/// What can be said to every method; read in `pydfo/_options.py`.
const COMMON: &str = "cache, checkpoint_interval, f_tol, kinds, nominal, problem, scale, stop, tolerances, trace_limit, warm_start, x_tol";

/// The words for an option with a fixed set of values.
type Words<T> = &'static [(&'static str, T)];

const PLANS: Words<BatchPlan> = &[
    ("auto", BatchPlan::Auto),
    ("serial", BatchPlan::Serial),
    ("two", BatchPlan::Two),
    ("four", BatchPlan::Four),
    ("two-ahead", BatchPlan::TwoAhead),
    ("ahead", BatchPlan::Ahead),
    ("lee-wiswall", BatchPlan::LeeWiswall),
];
const BOUNDS: Words<BoundsHandling> =
    &[("mirror", BoundsHandling::Mirror), ("clamp", BoundsHandling::Clamp), ("sine", BoundsHandling::Sine)];
const SAMPLINGS: Words<Sampling> = &[
    ("uniform", Sampling::Uniform),
    ("latin-hypercube", Sampling::LatinHypercube),
    ("sobol", Sampling::Sobol),
];
const REPAIRS: Words<Repair> = &[
    ("midpoint", Repair::Midpoint),
    ("mirror", Repair::Mirror),
    ("clamp", Repair::Clamp),
    ("resample", Repair::Resample),
];
const STRATEGIES: Words<Strategy> = &[
    ("rand1", Strategy::Rand1),
    ("best1", Strategy::Best1),
    ("current-to-best1", Strategy::CurrentToBest1),
    ("rand2", Strategy::Rand2),
];
const CROSSOVERS: Words<Crossover> =
    &[("binomial", Crossover::Binomial), ("exponential", Crossover::Exponential)];
const COEFFICIENTS: &str = "'auto', 'standard', 'adaptive', or (reflection, expansion, contraction, shrink)";

/// The entries of a dict, taken one by one.
struct Given<'a, 'py> {
    method: &'a str,
    entries: &'a Bound<'py, PyDict>,
    known: Vec<&'static str>,
}

impl<'py> Given<'_, 'py> {
    fn take(&mut self, name: &'static str) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.known.push(name);
        self.entries.get_item(name)
    }

    fn unfit(&self, name: &str, what: &str, value: &Bound<'py, PyAny>) -> PyErr {
        let text = value.repr().map_or_else(|_| "?".to_owned(), |r| r.to_string());
        PyTypeError::new_err(format!("option '{name}' of {} must be {what}, not {text}", self.method))
    }

    /// Reads an entry, if there is one, into its place.
    fn read<T>(
        &mut self,
        name: &'static str,
        what: &str,
        place: &mut T,
        convert: impl Fn(&Bound<'py, PyAny>) -> Option<T>,
    ) -> PyResult<()> {
        if let Some(value) = self.take(name)? {
            *place = convert(&value).ok_or_else(|| self.unfit(name, what, &value))?;
        }
        Ok(())
    }

    fn number(&mut self, name: &'static str, place: &mut f64) -> PyResult<()> {
        self.read(name, "a number", place, number)
    }

    fn optional_number(&mut self, name: &'static str, place: &mut Option<f64>) -> PyResult<()> {
        self.read(name, "a number or None", place, |v| optional(v, number))
    }

    fn count(&mut self, name: &'static str, place: &mut usize) -> PyResult<()> {
        self.read(name, "a whole number, at least 0", place, count)
    }

    fn optional_count(&mut self, name: &'static str, place: &mut Option<usize>) -> PyResult<()> {
        self.read(name, "a whole number or None", place, |v| optional(v, count))
    }

    fn flag(&mut self, name: &'static str, place: &mut bool) -> PyResult<()> {
        self.read(name, "True or False", place, |v| {
            v.cast::<PyBool>().map(|b| b.is_true()).ok().or_else(|| {
                // bool of NumPy
                let scalar = v.hasattr("dtype").unwrap_or(false);
                scalar.then(|| v.call_method0("item").and_then(|b| b.extract()).ok()).flatten()
            })
        })
    }

    fn word<T: Copy>(&mut self, name: &'static str, place: &mut T, words: Words<T>) -> PyResult<()> {
        if let Some(value) = self.take(name)? {
            let Ok(text) = value.extract::<String>() else {
                return Err(self.unfit(name, "a string", &value));
            };
            let found = words.iter().find(|(word, _)| *word == text.replace('_', "-"));
            *place = found.map(|(_, v)| *v).ok_or_else(|| {
                let words: Vec<_> = words.iter().map(|(word, _)| format!("'{word}'")).collect();
                PyValueError::new_err(format!("{name} = '{text}' is none of {}", words.join(", ")))
            })?;
        }
        Ok(())
    }

    /// Refuses what nobody asked for.
    fn finish(mut self) -> PyResult<()> {
        self.known.sort_unstable();
        for name in self.entries.keys() {
            let name = name.extract::<String>().unwrap_or_else(|_| name.to_string());
            if !self.known.contains(&&*name) {
                let near = nearest(self.entries.py(), &name, &self.known);
                let hint = near.map_or_else(|| ";".to_owned(), |near| format!("; did you mean '{near}'?"));
                return Err(PyValueError::new_err(format!(
                    "{} has no option '{name}'{hint} it has {}, and every method has {COMMON}",
                    self.method,
                    self.known.join(", ")
                )));
            }
        }
        Ok(())
    }
}

fn number(value: &Bound<'_, PyAny>) -> Option<f64> {
    value.extract().ok().filter(|_| !value.is_instance_of::<PyBool>())
}

fn count(value: &Bound<'_, PyAny>) -> Option<usize> {
    value.extract().ok().filter(|_| !value.is_instance_of::<PyBool>())
}

fn optional<T>(
    value: &Bound<'_, PyAny>,
    convert: impl Fn(&Bound<'_, PyAny>) -> Option<T>,
) -> Option<Option<T>> {
    if value.is_none() { Some(None) } else { convert(value).map(Some) }
}

fn coefficients(value: &Bound<'_, PyAny>) -> Option<Coefficients> {
    if let Ok(word) = value.extract::<String>() {
        return match word.as_str() {
            "auto" => Some(Coefficients::Auto),
            "standard" => Some(Coefficients::Standard),
            "adaptive" => Some(Coefficients::Adaptive),
            _ => None,
        };
    }
    let (reflection, expansion, contraction, shrink) = value.extract().ok()?;
    Some(Coefficients::Custom { reflection, expansion, contraction, shrink })
}

/// Steps (a list of numbers) or vertices (a list of lists).
fn initial_simplex(value: &Bound<'_, PyAny>) -> Option<InitialSimplex> {
    if value.is_none() {
        return Some(InitialSimplex::Auto);
    }
    let steps = value.extract().map(InitialSimplex::Steps);
    steps.or_else(|_| value.extract().map(InitialSimplex::Vertices)).ok()
}

fn weight(value: &Bound<'_, PyAny>) -> Option<Weight> {
    if let Some(weight) = number(value) {
        return Some(Weight::Fixed(weight));
    }
    value.extract().ok().map(|(low, high)| Weight::Dither(low, high))
}

/// The method of a name, with its options.
pub(crate) fn method(name: &str, entries: &Bound<'_, PyDict>) -> PyResult<AnyMethod> {
    let (method, given) = read(name, entries)?;
    given.finish()?;
    Ok(method)
}

/// The names of the methods, and whether each needs a start point.
#[pyfunction]
pub(crate) fn method_names() -> Vec<(&'static str, bool)> {
    let needs_start = |name: &str| name.parse::<AnyMethod>().is_ok_and(|method| method.needs_start());
    AnyMethod::NAMES.map(|name| (name, needs_start(name))).to_vec()
}

/// The name of the method for those who choose none, for parameters of these kinds.
#[pyfunction]
pub(crate) fn auto_method(kinds: Vec<String>) -> PyResult<&'static str> {
    let kinds: Vec<Kind> = kinds.iter().map(|kind| settings::kind("kinds", kind)).collect::<PyResult<_>>()?;
    Ok(AnyMethod::auto(&kinds).name())
}

/// The names of the options that there are, of any method.
#[pyfunction]
pub(crate) fn option_names(py: Python<'_>) -> PyResult<Vec<&'static str>> {
    let none = PyDict::new(py);
    let mut names: Vec<_> = COMMON.split(", ").collect();
    for name in AnyMethod::NAMES {
        names.extend(read(name, &none)?.1.known);
    }
    Ok(names)
}

fn read<'a, 'py>(name: &'a str, entries: &'a Bound<'py, PyDict>) -> PyResult<(AnyMethod, Given<'a, 'py>)> {
    let mut method: AnyMethod = name.parse().map_err(|e: dfo::Error| PyValueError::new_err(e.to_string()))?;
    let mut given = Given { method: name, entries, known: Vec::new() };
    match &mut method {
        AnyMethod::NelderMead(m) => {
            given.word("batch", &mut m.batch, PLANS)?;
            given.word("bounds_handling", &mut m.bounds, BOUNDS)?;
            given.read("coefficients", COEFFICIENTS, &mut m.coefficients, coefficients)?;
            given.read("initial_simplex", "steps or vertices", &mut m.initial, initial_simplex)?;
            given.count("restarts", &mut m.restarts)?;
        }
        AnyMethod::Barrier(m) => {
            given.word("batch", &mut m.batch, PLANS)?;
            given.read("coefficients", COEFFICIENTS, &mut m.coefficients, coefficients)?;
            given.number("factor", &mut m.factor)?;
            given.optional_number("mu", &mut m.mu)?;
        }
        AnyMethod::DifferentialEvolution(m) => {
            given.optional_count("population", &mut m.population)?;
            given.word("sampling", &mut m.sampling, SAMPLINGS)?;
            given.word("repair", &mut m.repair, REPAIRS)?;
            given.flag("include_start", &mut m.include_start)?;
            match &mut m.scheme {
                Scheme::Classic { strategy, crossover, weight: f, probability } => {
                    given.word("strategy", strategy, STRATEGIES)?;
                    given.word("crossover", crossover, CROSSOVERS)?;
                    given.read("weight", "a number or (low, high)", f, weight)?;
                    given.number("probability", probability)?;
                }
                Scheme::Adaptive(a) => {
                    given.optional_count("budget", &mut m.budget)?;
                    given.number("p_best", &mut a.p_best)?;
                    given.count("memory", &mut a.memory)?;
                    given.number("archive", &mut a.archive)?;
                    given.count("final_population", &mut a.final_population)?;
                }
                _ => {}
            }
        }
        AnyMethod::Genetic(m) => {
            given.optional_count("population", &mut m.population)?;
            let words = "'fitness', or a number of members: the size of a tournament";
            given.read("selection", words, &mut m.selection, |value| match value.extract::<String>() {
                Ok(word) => (word == "fitness").then_some(Selection::FitnessProportional),
                Err(_) => count(value).map(Selection::Tournament),
            })?;
            given.number("crossover_rate", &mut m.crossover_rate)?;
            given.optional_number("mutation_rate", &mut m.mutation_rate)?;
            given.count("elite", &mut m.elite)?;
            given.flag("gray", &mut m.gray)?;
            given.read("resolution", "one number per parameter", &mut m.resolution, |v| v.extract().ok())?;
            given.word("sampling", &mut m.sampling, SAMPLINGS)?;
            given.flag("include_start", &mut m.include_start)?;
            given.optional_count("stall", &mut m.stall)?;
        }
        _ => {}
    }
    Ok((method, given))
}

/// The name among those of a method's options that is most like `name`.
fn nearest(py: Python<'_>, name: &str, known: &[&'static str]) -> Option<String> {
    let names: Vec<&str> = known.iter().copied().chain(COMMON.split(", ")).collect();
    let near =
        py.import("difflib").and_then(|difflib| difflib.call_method1("get_close_matches", (name, names, 1)));
    near.and_then(|near| near.extract::<Vec<String>>()).ok()?.pop()
}
