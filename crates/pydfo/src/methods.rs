//! The options of a method from a Python dict: they take their places in the serialised defaults of the method.

use crate::words::{self, none_of};
use dfo::{AnyMethod, Kind, MethodOptions, ProblemClass, Search};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict};
use serde::Deserialize;
use serde_json::{Map, Number, Value, json};
use std::collections::BTreeMap;

/// The options of every method; read in `pydfo/_options.py`.
const COMMON: &str = "cache, checkpoint_interval, f_tol, kinds, max_failed, nominal, problem, scale, stop, tolerances, trace_limit, warm_start, x_tol";

/// The method of a name, with its options.
pub(crate) fn method(name: &str, entries: &Bound<'_, PyDict>) -> PyResult<AnyMethod> {
    let (mut method, mut form) = default(name)?;
    let places = places(name, &form);
    for (key, given) in entries {
        let option = key.extract::<String>().unwrap_or_else(|_| key.to_string());
        let Some(place) = places.get(&option).and_then(|pointer| form.pointer_mut(pointer)) else {
            return Err(unknown(entries.py(), name, &option, &places));
        };
        let is_optional = place.is_null();
        *place = tagged(&option, plain(&given));
        method = AnyMethod::deserialize(&form)
            .map_err(|error| unfit(name, &option, &given, (&error.to_string(), is_optional)))?;
    }
    Ok(method)
}

/// The names of the methods, and whether each needs a start point.
#[pyfunction]
pub(crate) fn method_names() -> Vec<(&'static str, bool)> {
    let needs_start = |name: &str| name.parse::<AnyMethod>().is_ok_and(|method| method.needs_start());
    AnyMethod::NAMES.map(|name| (name, needs_start(name))).to_vec()
}

/// The name of the method that is called so, or "auto".
#[pyfunction]
pub(crate) fn method_name(name: &str) -> PyResult<&'static str> {
    Ok(default(name)?.0.name())
}

/// The name of the method that `fmin` has under this number.
#[pyfunction]
pub(crate) fn method_of_number(number: usize) -> PyResult<&'static str> {
    AnyMethod::by_number(number).map(|method| method.name()).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// A method's name, options that are not its defaults, and why it was chosen.
type AutoMethod = (&'static str, Vec<(String, OptionValue)>, String);

/// The value of an option that a choice sets.
#[derive(IntoPyObject)]
pub(crate) enum OptionValue {
    Flag(bool),
    Word(String),
}

impl From<String> for OptionValue {
    fn from(text: String) -> Self {
        match text.as_str() {
            "yes" => Self::Flag(true),
            "no" => Self::Flag(false),
            _ => Self::Word(text),
        }
    }
}

/// The method for those who choose none. `given`: the names of the options that were given, which must be its own; those of
/// Nelder-Mead choose Nelder-Mead.
#[pyfunction]
pub(crate) fn auto_method(
    kinds: Vec<String>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    residuals: bool,
    search: &str,
    given: Vec<String>,
) -> PyResult<AutoMethod> {
    let (kinds, search) = (words::words("kinds", &kinds)?, words::word("search", search)?);
    let class = ProblemClass { lower: &lower, upper: &upper, kinds: &kinds, residuals, search };
    let of_name = |name: &str| default(name).map(|(_, form)| places(name, &form));
    let (method, reason) = AnyMethod::chosen_for(&class).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let own = of_name(method.name())?;
    if let Some(option) = given.iter().find(|option| !own.contains_key(*option)) {
        let simplex = AnyMethod::default();
        let others = of_name(simplex.name())?;
        if search == Search::Local
            && kinds.iter().all(|k| *k == Kind::Continuous)
            && given.iter().all(|o| others.contains_key(o))
        {
            return Ok((
                simplex.name(),
                Vec::new(),
                format!("the option '{option}' is one of {}", simplex.name()),
            ));
        }
    }
    let plain = default(method.name())?.0.describe();
    let differs = |(name, value): &(String, String)| !plain.iter().any(|(n, v)| (n, v) == (name, value));
    let chosen = method.describe().into_iter().filter(differs).map(|(name, value)| (name, value.into()));
    Ok((method.name(), chosen.collect(), reason.to_owned()))
}

/// The names of the options that there are, of any method.
#[pyfunction]
pub(crate) fn option_names() -> PyResult<Vec<String>> {
    let mut names: Vec<String> = COMMON.split(", ").map(str::to_owned).collect();
    for name in AnyMethod::NAMES {
        names.extend(places(name, &default(name)?.1).into_keys());
    }
    Ok(names)
}

/// A method with its defaults, and the same serialised.
fn default(name: &str) -> PyResult<(AnyMethod, Value)> {
    let method: AnyMethod = name.parse().map_err(|e: dfo::Error| PyValueError::new_err(e.to_string()))?;
    let form = serde_json::to_value(&method).map_err(|e| PyValueError::new_err(e.to_string()))?;
    Ok((method, form))
}

/// The options of a method, and the JSON pointers to where they stand: those of a variant (the scheme of differential
/// evolution) are options like the others.
fn places(method: &str, form: &Value) -> BTreeMap<String, String> {
    let mut places = BTreeMap::new();
    let mut open = vec![(String::new(), form)];
    while let Some((pointer, value)) = open.pop() {
        // A variant with fields is an object with its name as the only key.
        for (variant, fields) in value.as_object().into_iter().flatten() {
            for (option, value) in fields.as_object().into_iter().flatten() {
                let place = format!("{pointer}/{variant}/{option}");
                if value.as_object().is_some_and(|v| v.values().all(Value::is_object)) {
                    open.push((place, value));
                // Only L-SHADE plans with it.
                } else if (method, option.as_str()) != ("de-classic", "budget") {
                    places.insert(option.clone(), place);
                }
            }
        }
    }
    places
}

/// Up to here, floating-point numbers tell all whole numbers apart.
const MOST_EXACT: f64 = 9_007_199_254_740_992.0;

/// A Python value as plain data; an empty object, which fits nowhere, stands for what is none.
fn plain(value: &Bound<'_, PyAny>) -> Value {
    if let Ok(list) = value.call_method0("tolist") {
        return plain(&list);
    }
    if value.is_none() {
        Value::Null
    } else if let Ok(flag) = value.cast::<PyBool>() {
        Value::Bool(flag.is_true())
    } else if let Ok(count) = value.extract::<i64>() {
        Value::Number(count.into())
    } else if let Ok(number) = value.extract::<f64>() {
        // Floats like 1e4 are counts, too.
        if (1.0..=MOST_EXACT).contains(&number) && number.fract() == 0.0 {
            return Value::Number((number as u64).into());
        }
        Number::from_f64(number).map_or_else(|| Value::Object(Map::new()), Value::Number)
    } else if let Ok(text) = value.extract::<String>() {
        Value::String(text.replace('_', "-"))
    } else if let Ok(items) = value.extract::<Vec<Bound<'_, PyAny>>>() {
        items.iter().map(plain).collect()
    } else {
        Value::Object(Map::new())
    }
}

/// The serialised form of an option whose variant is given by its shape.
fn tagged(option: &str, value: Value) -> Value {
    match (option, &value) {
        ("coefficients", Value::Array(v)) if v.len() == 4 => json!({
            "custom": { "reflection": v[0], "expansion": v[1], "contraction": v[2], "shrink": v[3] }
        }),
        ("initial_simplex", Value::Null) => json!("auto"),
        ("initial_simplex", Value::Array(rows)) => match rows.first() {
            Some(Value::Array(_)) => json!({ "vertices": value }),
            _ => json!({ "steps": value }),
        },
        ("restarts", Value::Null) => json!("none"),
        ("selection", Value::Number(_)) => json!({ "tournament": value }),
        ("selection", Value::String(word)) if word == "fitness" => json!("fitness-proportional"),
        ("weight", Value::Number(_)) => json!({ "fixed": value }),
        ("weight", Value::Array(_)) => json!({ "dither": value }),
        _ => value,
    }
}

/// The error for a value that an option cannot have, from the message of serde.
fn unfit(
    method: &str,
    option: &str,
    given: &Bound<'_, PyAny>,
    (message, is_optional): (&str, bool),
) -> PyErr {
    let what = match option {
        "coefficients" => "'auto', 'standard', 'adaptive', or (reflection, expansion, contraction, shrink)",
        "initial_simplex" => "steps or vertices",
        "resolution" => "one number per parameter",
        "selection" => "'fitness', or a number of members: the size of a tournament",
        "weight" => "a number or (low, high)",
        _ => match message.rsplit("expected ").next() {
            Some("usize") => "a whole number, at least 0",
            Some("f64") => "a number",
            Some("a boolean") => "True or False",
            _ => match given.extract::<String>() {
                Ok(word) => return none_of(option, &word, message),
                Err(_) => "a string",
            },
        },
    };
    let or_none = if is_optional { " or None" } else { "" };
    let text = given.repr().map_or_else(|_| "?".to_owned(), |r| r.to_string());
    let message = format!("option '{option}' of {method} must be {what}{or_none}, not {text}");
    // Whole numbers, NaN and infinities have the right type where numbers are expected.
    let is_whole = || given.extract::<f64>().is_ok_and(|number| number.fract() == 0.0 || !number.is_finite());
    match what.contains("number") && !given.is_instance_of::<PyBool>() && is_whole() {
        true => PyValueError::new_err(message),
        false => PyTypeError::new_err(message),
    }
}

/// The error for an option that there is not, with the one that is most like it.
fn unknown(py: Python<'_>, method: &str, option: &str, places: &BTreeMap<String, String>) -> PyErr {
    let known: Vec<&str> = places.keys().map(String::as_str).collect();
    let all: Vec<&str> = known.iter().copied().chain(COMMON.split(", ")).collect();
    let near = py.import("difflib").and_then(|difflib| {
        difflib.call_method1("get_close_matches", (option, all, 1))?.extract::<Vec<String>>()
    });
    let near = near.ok().and_then(|mut near| near.pop());
    let hint = near.map_or_else(|| ";".to_owned(), |near| format!("; did you mean '{near}'?"));
    let known = known.join(", ");
    PyValueError::new_err(format!(
        "{method} has no option '{option}'{hint} it has {known}, and every method has {COMMON}"
    ))
}
