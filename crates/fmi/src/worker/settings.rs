//! Version and environment variables that the process and its worker agree on.

/// Version that must be the same in both processes.
pub(super) const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "/1");

/// Environment variable by which a process is asked to serve; its value are the limits.
pub(super) const ASKED: &str = "FMUFIT_WORKER";

/// Environment variable with the worker's folder.
pub(super) const FOLDER: &str = "FMUFIT_WORKER_FOLDER";

/// Environment variable with the level up to which it is to log.
pub(super) const LEVEL: &str = "FMUFIT_WORKER_LOG";

/// True if this process was started as a worker.
pub fn is_asked() -> bool {
    std::env::var_os(ASKED).is_some()
}
