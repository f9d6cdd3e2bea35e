//! Errors of the operating system as exceptions of Python.

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use std::io;
use std::path::Path;

/// Creates OSError with the system's number for it. Python selects the subclass, such as FileNotFoundError,
/// from the number, and converts a number of Windows to `errno`.
pub(super) fn os_error(number: i32, reason: String, path: &Path) -> PyErr {
    let path = path.as_os_str().to_owned();
    match cfg!(windows) {
        true => PyOSError::new_err((0, reason, path, number)),
        false => PyOSError::new_err((number, reason, path)),
    }
}

/// Returns the text of an error, without its number.
pub(super) fn reason(error: &io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}
