//! Options of methods by their names, and where they stand in the serialised defaults of a method.

use crate::values::nearest::nearest;
use crate::values::record::{Record, RecordError, Value};
use std::collections::BTreeSet;

/// The options that every method has, by the names that users know.
pub(crate) const COMMON: [&str; 13] = [
    "cache",
    "checkpoint_interval",
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

/// Whether a value has options of its own: a variant with fields, as an object with its name as the only key.
fn is_variant(value: &Value) -> bool {
    matches!(value, Value::Record(fields) if fields.values().all(|value| matches!(value, Value::Record(_))))
}

/// Adds the names of the options of a serialised method: those of a variant (the scheme of differential
/// evolution) are options like the others.
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

/// Takes the options of these names out of a serialised method; an empty list says nothing.
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

/// Where an option stands in a serialised method.
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

/// The serialised form of an option whose variant its shape tells.
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
        // A number that is not finite is none of an option.
        (_, Value::Number(number)) if !number.is_finite() => Value::Other(number.to_string()),
        (_, value) => value,
    }
}

/// The shapes of an option that [`tagged`] takes beside the serialised one, as a JSON schema.
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

/// What an option of several shapes must be.
pub(super) fn described(option: &str) -> Option<&'static str> {
    Some(match option {
        "coefficients" => "'auto', 'standard', 'adaptive', or (reflection, expansion, contraction, shrink)",
        "initial_simplex" => "steps or vertices",
        "resolution" => "one number per parameter",
        "selection" => "'fitness', or a number of members: the size of a tournament",
        "weight" => "a number or (low, high)",
        _ => return None,
    })
}

/// The error for an option that there is not, with the one that is most like it.
pub(super) fn unknown(method: &'static str, option: &str, known: &BTreeSet<String>) -> RecordError {
    let all = known.iter().map(String::as_str).chain(COMMON);
    let hint = nearest(option, all).map_or(";".to_owned(), |name| format!("; did you mean '{name}'?"));
    let known = known.iter().map(String::as_str).collect::<Vec<_>>().join(", ");
    let common = COMMON.join(", ");
    RecordError::message(format!(
        "{method} has no option '{option}'{hint} it has {known}, and every method has {common}"
    ))
}
