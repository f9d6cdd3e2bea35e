//! Version and environment variables that the process and its worker agree on.

use std::ffi::CStr;

/// Version that must be identical in both processes.
pub(super) const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "/3");

/// Environment variable that requests a process to serve; the value is the version.
pub(super) const ASKED: &str = "FMUFIT_WORKER";

/// Environment variable with the worker's folder.
pub(super) const FOLDER: &CStr = c"FMUFIT_WORKER_FOLDER";

/// Environment variable with the folder for temporary files, which is the worker's folder.
pub(super) const TEMPORARY: &CStr = c"TMPDIR";

/// Environment variable with the maximum log level.
pub(super) const LEVEL: &str = "FMUFIT_WORKER_LOG";

/// True if this process was started to serve.
pub fn is_asked() -> bool {
    std::env::var_os(ASKED).is_some()
}
