//! Fields of the serde types that records are read as: their names, and the split of a record between several
//! types.

use crate::values::record::{Record, RecordError, Value};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

/// Returns the names of the fields of a type.
///
/// # Errors
/// Returns an error if the default value of the type cannot be serialised.
pub fn field_names<T: Default + Serialize>() -> Result<BTreeSet<String>, RecordError> {
    match Value::of(&T::default())? {
        Value::Record(fields) => Ok(fields.into_keys().collect()),
        _ => Ok(BTreeSet::new()),
    }
}

/// Reads a record as a type. `what` describes its fields in the error about an unknown name.
///
/// # Errors
/// Returns an error if a field is unknown or its value is not allowed.
pub fn read_record<T: DeserializeOwned>(record: &Record, what: &str) -> Result<T, RecordError> {
    let record = Value::Record(record.clone());
    T::deserialize(&record).map_err(|error| error.among(what).of(what, &record))
}

/// Reads a record as a type whose serde implementation ignores unknown fields. Unknown fields are an error
/// here.
///
/// # Errors
/// Returns the errors of [`read_record`].
pub fn read_strict<T>(record: &Record, what: &str) -> Result<T, RecordError>
where
    T: Default + Serialize + DeserializeOwned,
{
    let expected: Vec<String> = field_names::<T>()?.into_iter().collect();
    match record.keys().find(|name| !expected.contains(name)) {
        Some(name) => Err(RecordError::unknown(what, name, &expected)),
        None => read_record(record, what),
    }
}

/// Reads the fields of a record that the type has, and returns the other fields.
///
/// # Errors
/// Returns the errors of [`read_record`].
pub fn read_part<T>(record: Record, what: &str) -> Result<(T, Record), RecordError>
where
    T: Default + Serialize + DeserializeOwned,
{
    let names = field_names::<T>()?;
    let (of_type, others) = record.into_iter().partition(|(name, _)| names.contains(name));
    Ok((read_record(&of_type, what)?, others))
}
