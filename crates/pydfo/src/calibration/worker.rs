//! Worker processes: how they are started, and what they do.

use fmi::worker::Launcher;
use pyo3::prelude::*;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;

// Without the start of an interpreter, where the file of this module can be loaded ahead of one.
fmi::serve_before_main!(calibration::serve_if_worker);

/// Sets how worker processes are started: a program with arguments that ends up in `serve_worker`. `library`:
/// the file of this module.
#[pyfunction]
pub(crate) fn set_launcher(program: PathBuf, arguments: Vec<OsString>, library: PathBuf) {
    Launcher { program, arguments, preload: None }.preloading(library).set();
}

/// The program of the worker processes, started before it is needed; it ends with this, unless it is in use.
#[pyclass(frozen)]
pub(crate) struct ForkServer(
    #[expect(dead_code, reason = "kept alive")] Option<Arc<fmi::worker::ForkServer>>,
);

/// Starts the program of the worker processes, which will be needed soon.
#[pyfunction]
pub(crate) fn start_worker_ahead(py: Python<'_>) -> ForkServer {
    ForkServer(py.detach(fmi::worker::start_fork_server))
}

/// Serves as a template of worker processes until nobody needs it any more.
#[pyfunction]
pub(crate) fn serve_worker(py: Python<'_>) {
    py.detach(calibration::serve_if_worker);
}
