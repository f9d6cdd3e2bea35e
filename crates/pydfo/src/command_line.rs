//! The command line `fmufit`, as installed by a wheel.

use pyo3::prelude::*;
use std::ffi::OsString;

/// Runs the command line with these arguments, of which the first is the name of the program. Returns the
/// exit code.
#[cfg(feature = "cli")]
#[pyfunction]
pub(crate) fn command_line(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| fmufit_cli::main(arguments))
}

/// Raises an error, because this module was built without the command line.
#[cfg(not(feature = "cli"))]
#[pyfunction]
pub(crate) fn command_line(arguments: Vec<OsString>) -> PyResult<u8> {
    let program = arguments.first().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let message = format!(
        "{program}: this pydfo was built without the command line (feature `cli`). Run `make build` to build \
         pydfo with it"
    );
    Err(pyo3::exceptions::PyNotImplementedError::new_err(message))
}
