//! Files that store a computation under way, with the identity of its problem.

use crate::error::CalibrationError;
use fmi::FmiError;
use fmi::platform::fill_atomically;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::time::{Duration, Instant};

/// Minimum interval between two writes.
const SHORTEST: Duration = Duration::from_millis(200);

/// The whole file is written each time. The interval is at least this multiple of the duration of a write, so
/// that writing takes at most a tenth of the time.
const SHARE: u32 = 10;

/// Time of the last write, which decides when the next one is due.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct LastWrite(Option<(Instant, Duration)>);

impl LastWrite {
    /// True if the last write was long enough ago.
    pub(crate) fn is_due(&self) -> bool {
        self.0.is_none_or(|(at, took)| at.elapsed() >= SHORTEST.max(SHARE * took))
    }

    /// Writes a file. A failure only causes a warning, so that the results in memory are not lost. `what`
    /// names the results.
    pub(crate) fn write<T: Serialize>(&mut self, path: &Path, content: &T, what: &str) {
        let began = Instant::now();
        if let Err(error) = write(path, content) {
            log::warn!("{what} was not saved: {error}");
        }
        self.0 = Some((Instant::now(), began.elapsed()));
    }
}

/// Reads a file. Returns `None` if it does not exist. `refusal` returns the reason why its content cannot be
/// continued, and `unreadable` is the reason if it cannot be parsed.
///
/// # Errors
/// Returns an error with the path and the reason.
pub(crate) fn read<T: DeserializeOwned>(
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
pub(crate) fn write<T: Serialize>(path: &Path, content: &T) -> Result<(), CalibrationError> {
    let bytes = serde_json::to_vec(content).map_err(|e| CalibrationError::Setup(e.to_string()))?;
    fill_atomically(path, |mut file, _| Ok(file.write_all(&bytes).map_err(FmiError::io("write", path))?))
}
