//! Version and environment variables that the process and its worker agree on.

use std::ffi::CStr;

/// Version that must be the same in both processes.
pub(super) const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "/3");

/// Environment variable by which a process is asked to serve; its value is the version.
pub(super) const ASKED: &str = "FMUFIT_WORKER";

/// Environment variable with the worker's folder.
pub(super) const FOLDER: &CStr = c"FMUFIT_WORKER_FOLDER";

/// Environment variable with the folder for temporary files, which is the same.
pub(super) const TEMPORARY: &CStr = c"TMPDIR";

/// Environment variable with the level up to which it is to log.
pub(super) const LEVEL: &str = "FMUFIT_WORKER_LOG";

/// True if this process was started to serve.
pub fn is_asked() -> bool {
    std::env::var_os(ASKED).is_some()
}
