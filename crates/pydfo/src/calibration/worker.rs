//! Worker processes: how they are started, and what they do.

use fmi::worker::Launcher;
use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;

/// Sets how worker processes are started: a program with arguments that ends up in `serve_worker`.
#[pyfunction]
pub(crate) fn set_launcher(program: PathBuf, arguments: Vec<OsString>) {
    Launcher { program, arguments }.set();
}

/// Starts the program of the worker processes, which will be needed soon.
#[pyfunction]
pub(crate) fn start_worker_ahead(py: Python<'_>) {
    py.detach(fmi::worker::start_ahead);
}

/// Serves as a template of worker processes until nobody needs it any more.
#[pyfunction]
pub(crate) fn serve_worker(py: Python<'_>) {
    py.detach(calibration::serve_if_asked);
}
