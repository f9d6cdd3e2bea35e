//! Words that users choose from: each stands for a variant of an enum, by its serialised name.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde::de::value::{Error, StrDeserializer};

/// The value of a word, whatever the case of its letters.
pub(crate) fn word<T: DeserializeOwned>(name: &str, given: &str) -> PyResult<T> {
    let lower = given.to_ascii_lowercase();
    T::deserialize(StrDeserializer::<Error>::new(&lower)).map_err(|e| none_of(name, given, &e.to_string()))
}

/// The word that stands for a value.
pub(crate) fn word_of<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

pub(crate) fn words<T: DeserializeOwned>(name: &str, given: &[String]) -> PyResult<Vec<T>> {
    given.iter().map(|g| word(name, g)).collect()
}

/// The error for a word that is none of those which serde expected, as its message lists them.
pub(crate) fn none_of(name: &str, given: &str, message: &str) -> PyErr {
    let expected = message.rsplit("expected ").next().unwrap_or_default();
    let known: Vec<&str> = expected.split('`').skip(1).step_by(2).collect();
    let listed = known.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(", ");
    let meant = known.iter().find(|word| !given.is_empty() && word.starts_with(given));
    let hint = meant.map_or_else(String::new, |word| format!("; did you mean '{word}'?"));
    PyValueError::new_err(format!("{name} = '{given}' is none of {listed}{hint}"))
}
