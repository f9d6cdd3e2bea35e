//! Errors of the operating system as exceptions of Python.

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use std::io;
use std::path::Path;

/// Creates OSError with the system's number for it. Python selects the subclass, such as FileNotFoundError,
/// from the number, and converts a number of Windows to `errno`.
pub(super) fn os_error(py: Python<'_>, number: i32, reason: &str, path: &Path) -> PyErr {
    let (class, path) = (py.get_type::<PyOSError>(), path.as_os_str());
    // Called, not raised by class, because OSError selects the subclass when it is called.
    let exception = match cfg!(windows) {
        true => class.call1((0, reason, path, number)),
        false => class.call1((number, reason, path)),
    };
    exception.map_or_else(|error| error, PyErr::from_value)
}

/// Returns the text of an error, without its number.
pub(super) fn reason(error: &io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}
