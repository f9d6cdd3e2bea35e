//! Files that store a computation under way, with the identity of its problem.

use crate::error::CalibrationError;
use fmi::FmiError;
use fmi::platform::fill_atomically;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{ErrorKind, Write};
use std::path::Path;

/// Reads a file. Returns `None` if it does not exist. `refusal` returns the reason why its content cannot be
/// continued, and `unreadable` is the reason if it cannot be parsed.
///
/// # Errors
/// Returns an error with the path and the reason.
pub(super) fn read<T: DeserializeOwned>(
    path: &Path,
    unreadable: &'static str,
    refusal: impl FnOnce(&T) -> Option<&'static str>,
) -> Result<Option<T>, CalibrationError> {
    let bytes = match base::files::read_regular(path) {
        Ok(bytes) => bytes,
        Err(source) if source.kind() == ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(CalibrationError::DataFile { path: path.to_owned(), source }),
    };
    let found: Option<T> = serde_json::from_slice(&bytes).ok();
    match found.as_ref().map_or(Some(unreadable), refusal) {
        Some(why) => Err(CalibrationError::Setup(format!(
            "{} {why}. Specify another file, or remove this one",
            path.display()
        ))),
        None => Ok(found),
    }
}

/// Writes a file atomically.
///
/// # Errors
/// Returns an error if writing fails.
pub(super) fn write<T: Serialize>(path: &Path, content: &T) -> Result<(), CalibrationError> {
    let bytes = serde_json::to_vec(content).map_err(|e| CalibrationError::Setup(e.to_string()))?;
    fill_atomically(path, |mut file, _| Ok(file.write_all(&bytes).map_err(FmiError::io("write", path))?))
}
