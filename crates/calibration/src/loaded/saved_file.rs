//! Files that store a computation under way, with the identity of its problem. The first line of a file
//! contains the checksum of the JSON text that follows.

use crate::error::CalibrationError;
use crate::problem::fingerprint::hash_of_bytes;
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

/// First bytes of a file. The checksum follows.
const MARK: &[u8] = b"fmufit sha256 ";

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
    let (found, damage): (Option<T>, _) = match content_of(&bytes) {
        None => (None, unreadable),
        Some((hash, content)) if hash != hash_of_bytes(content).as_bytes() => {
            (None, "is damaged, because its checksum does not match")
        }
        Some((_, content)) => (serde_json::from_slice(content).ok(), unreadable),
    };
    match found.as_ref().map_or(Some(damage), refusal) {
        Some(why) => Err(CalibrationError::Setup(format!(
            "{} {why}. Specify another file, or remove this one",
            path.display()
        ))),
        None => Ok(found),
    }
}

/// Returns the checksum of a file and the content after its first line; `None` for another kind of file.
fn content_of(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let rest = bytes.strip_prefix(MARK)?;
    let end = rest.iter().position(|byte| *byte == b'\n')?;
    Some((&rest[..end], &rest[end + 1..]))
}

/// Writes a file atomically.
///
/// # Errors
/// Returns an error if writing fails.
pub(crate) fn write<T: Serialize>(path: &Path, content: &T) -> Result<(), CalibrationError> {
    let content = serde_json::to_vec(content).map_err(|e| CalibrationError::Setup(e.to_string()))?;
    let bytes = [MARK, hash_of_bytes(&content).as_bytes(), b"\n", &content].concat();
    fill_atomically(path, |mut file, _| Ok(file.write_all(&bytes).map_err(FmiError::io("write", path))?))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A digit that becomes another digit is still a number, so only the checksum detects it.
    #[test]
    fn every_changed_bit_of_a_file_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.boot");
        let content = vec![0.125, 1.5e-7, -3.0];
        write(&path, &content).unwrap();
        let read_back = || read(&path, "is another file", |_: &Vec<f64>| None);
        assert_eq!(read_back().unwrap(), Some(content));
        let bytes = std::fs::read(&path).unwrap();
        for bit in 0..8 * bytes.len() {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            std::fs::write(&path, damaged).unwrap();
            let error = read_back().unwrap_err().to_string();
            assert!(error.contains("run.boot is") && error.contains("remove this one"), "{error}");
        }
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(read_back().is_err(), "{length} bytes");
        }
    }
}
