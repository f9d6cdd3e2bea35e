//! Worker processes: how they are started and what they run.

use fmi::worker::Launcher;
use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;

// Worker processes start without an interpreter if the file of this module can be loaded before one.
fmi::serve_before_main!(calibration::serve_if_worker);

/// Sets how worker processes are started: a program with arguments that finally calls `serve_worker`.
/// `library`: the file of this module.
#[pyfunction]
pub(crate) fn set_launcher(program: PathBuf, arguments: Vec<OsString>, library: PathBuf) {
    Launcher::of(program).with_arguments(arguments).preloading(library).set();
}

/// The program of the worker processes, started before it is needed. It ends when this object is dropped,
/// unless it is in use.
#[pyclass(frozen)]
pub(crate) struct ForkServer(
    #[expect(dead_code, reason = "kept alive")] Option<Arc<fmi::worker::StartedAhead>>,
);

/// Starts the program of the worker processes in advance.
#[pyfunction]
pub(crate) fn start_worker_ahead(py: Python<'_>) -> ForkServer {
    ForkServer(py.detach(fmi::worker::start_ahead))
}

/// Serves as a template of worker processes until it is no longer needed.
#[pyfunction]
pub(crate) fn serve_worker(py: Python<'_>) {
    py.detach(calibration::serve_if_worker);
}
