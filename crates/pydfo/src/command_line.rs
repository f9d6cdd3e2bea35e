//! The command line `fmufit`, as a wheel installs it.

use pyo3::prelude::*;
use std::ffi::OsString;

/// Runs the command line with these arguments, the name of the program first; returns the exit code.
#[cfg(feature = "cli")]
#[pyfunction]
pub(crate) fn command_line(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| fmufit_cli::main(arguments))
}

/// Says that this module was built without it.
#[cfg(not(feature = "cli"))]
#[pyfunction]
pub(crate) fn command_line(arguments: Vec<OsString>) -> PyResult<u8> {
    let program = arguments.first().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let message = format!(
        "{program}: this pydfo was built without the command line (feature `cli`): `make build` builds one with it"
    );
    Err(pyo3::exceptions::PyNotImplementedError::new_err(message))
}
