//! Fields of the serde types that records are read as: their names, and parts of a record that several types
//! share.

use crate::values::record::{Record, RecordError, Value};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;

/// The names of the fields of a type.
///
/// # Errors
/// Its default cannot be serialised.
pub fn field_names<T: Default + Serialize>() -> Result<BTreeSet<String>, RecordError> {
    match Value::of(&T::default())? {
        Value::Record(fields) => Ok(fields.into_keys().collect()),
        _ => Ok(BTreeSet::new()),
    }
}

/// Reads a record as a type; `what`: what its fields are called where there is none of a name.
///
/// # Errors
/// A field that there is not, or a value that it cannot have.
pub fn read_record<T: DeserializeOwned>(record: &Record, what: &str) -> Result<T, RecordError> {
    let record = Value::Record(record.clone());
    T::deserialize(&record).map_err(|error| error.among(what).of(what, &record))
}

/// Reads a record as a type that leaves out what it does not know.
///
/// # Errors
/// As [`read_record`].
pub fn read_known<T>(record: &Record, what: &str) -> Result<T, RecordError>
where
    T: Default + Serialize + DeserializeOwned,
{
    let known: Vec<String> = field_names::<T>()?.into_iter().collect();
    match record.keys().find(|name| !known.contains(name)) {
        Some(name) => Err(RecordError::unknown(what, name, &known)),
        None => read_record(record, what),
    }
}

/// Reads those fields of a record that the type has; the others are returned.
///
/// # Errors
/// As [`read_record`].
pub fn read_part<T>(record: Record, what: &str) -> Result<(T, Record), RecordError>
where
    T: Default + Serialize + DeserializeOwned,
{
    let names = field_names::<T>()?;
    let (own, others) = record.into_iter().partition(|(name, _)| names.contains(name));
    Ok((read_record(&own, what)?, others))
}
