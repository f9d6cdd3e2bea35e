//! Options of methods by name, and their location in the serialised defaults of a method.

use crate::values::nearest::nearest;
use crate::values::record::{Record, RecordError, Value};
use std::collections::BTreeSet;

/// Options that every method supports, by their user-visible names.
pub(crate) const COMMON: [&str; 14] = [
    "cache",
    "checkpoint_interval",
    "constraint_tol",
    "f_tol",
    "kinds",
    "max_failed",
    "nominal",
    "problem",
    "scale",
    "stop",
    "tolerances",
    "trace_limit",
    "warm_start",
    "x_tol",
];

/// True if a value is a variant with fields. Such a variant is serialised as an object whose only key is its
/// name.
fn is_variant(value: &Value) -> bool {
    matches!(value, Value::Record(fields) if fields.values().all(|value| matches!(value, Value::Record(_))))
}

/// Adds the names of the options of a serialised method. The fields of a variant (for example, the scheme of
/// differential evolution) count as options.
pub(super) fn collect(form: &Value, names: &mut BTreeSet<String>) {
    let Value::Record(variants) = form else { return };
    for fields in variants.values() {
        let Value::Record(fields) = fields else { continue };
        for (name, value) in fields {
            match is_variant(value) {
                true => collect(value, names),
                false => _ = names.insert(name.clone()),
            }
        }
    }
}

/// Copies the options in `names` from a serialised method to `options`. Empty lists are skipped.
pub(super) fn values(form: &Value, names: &BTreeSet<String>, options: &mut Record) {
    let Value::Record(variants) = form else { return };
    for fields in variants.values() {
        let Value::Record(fields) = fields else { continue };
        for (name, value) in fields {
            match names.contains(name) {
                true if *value == Value::List(Vec::new()) => {}
                true => _ = options.insert(name.clone(), value.clone()),
                false => values(value, names, options),
            }
        }
    }
}

/// Returns the location of an option in a serialised method.
pub(super) fn place<'f>(form: &'f mut Value, option: &str) -> Option<&'f mut Value> {
    let Value::Record(variants) = form else { return None };
    variants.values_mut().find_map(|fields| match fields {
        Value::Record(fields) => fields.iter_mut().find_map(|(name, value)| match is_variant(value) {
            true => place(value, option),
            false => (name == option).then_some(value),
        }),
        _ => None,
    })
}

/// Returns the serialised form of a value. For some options, the form of the value determines the variant.
pub(super) fn tagged(option: &str, value: Value) -> Value {
    let variant = |name: &str, value| Value::Record(Record::from([(name.to_owned(), value)]));
    match (option, value) {
        ("coefficients", Value::List(values)) if values.len() == 4 => {
            let names = ["reflection", "expansion", "contraction", "shrink"].map(str::to_owned);
            variant("custom", Value::Record(names.into_iter().zip(values).collect()))
        }
        ("initial_simplex", Value::Nothing) => Value::Text("auto".to_owned()),
        ("initial_simplex", Value::List(rows)) => {
            let name = if matches!(rows.first(), Some(Value::List(_))) { "vertices" } else { "steps" };
            variant(name, Value::List(rows))
        }
        ("restarts", Value::Nothing) => Value::Text("none".to_owned()),
        ("selection", value @ (Value::Count(_) | Value::Number(_))) => variant("tournament", value),
        ("selection", Value::Text(word)) if word.eq_ignore_ascii_case("fitness") => {
            Value::Text("fitness-proportional".to_owned())
        }
        ("weight", value @ (Value::Count(_) | Value::Number(_))) => variant("fixed", value),
        ("weight", Value::List(values)) if values.len() == 2 => variant("dither", Value::List(values)),
        ("resolution", Value::List(steps)) if steps.is_empty() => Value::Other("an empty list".to_owned()),
        // Options must be finite numbers.
        (_, Value::Number(number)) if !number.is_finite() => Value::Other(number.to_string()),
        (_, value) => value,
    }
}

/// Returns the JSON schema of the additional value forms that [`tagged`] accepts for an option.
#[cfg(feature = "schema")]
pub(super) fn shape(option: &str) -> Option<serde_json::Value> {
    let numbers = |n: usize| serde_json::json!({ "type": "array", "items": { "type": "number" }, "minItems": n, "maxItems": n });
    Some(match option {
        "batch" => serde_json::json!({ "const": "workers" }),
        "coefficients" => numbers(4),
        "initial_simplex" => {
            serde_json::json!({ "type": ["array", "null"], "items": { "type": ["number", "array"] } })
        }
        "restarts" => serde_json::json!({ "type": "null" }),
        "selection" => {
            serde_json::json!({ "anyOf": [{ "const": "fitness" }, { "type": "integer", "minimum": 1 }] })
        }
        "weight" => serde_json::json!({ "anyOf": [{ "type": "number" }, numbers(2)] }),
        _ => return None,
    })
}

/// Returns a description of the valid values of an option that accepts several forms.
pub(super) fn described(option: &str) -> Option<&'static str> {
    Some(match option {
        "coefficients" => "'auto', 'standard', 'adaptive', or (reflection, expansion, contraction, shrink)",
        "initial_population" => "points, each with one number per parameter",
        "initial_simplex" => "steps or vertices",
        "resolution" => "one number per parameter",
        "selection" => "'fitness', or the number of members in a tournament",
        "weight" => "a number or (low, high)",
        _ => return None,
    })
}

/// Returns the error for an unknown option, with the most similar known option as a hint.
pub(super) fn unknown(method: &'static str, option: &str, available: &BTreeSet<String>) -> RecordError {
    let all = available.iter().map(String::as_str).chain(COMMON);
    let hint = nearest(option, all).map_or(";".to_owned(), |name| format!("; did you mean '{name}'?"));
    let available = available.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    let common = COMMON.join(", ");
    RecordError::message(format!(
        "{method} has no option '{option}'{hint} its options are {available}; options of every method are \
         {common}"
    ))
}
