//! Processes in which FMUs run: what an FMU does to its process, this one does not notice.
//!
//! An FMU is foreign machine code: it crashes, hangs, leaks, calls `exit`, keeps values in statics. Whatever evaluates a model more than once
//! asks [`Workers`] to do it. A worker is a program that calls [`serve_if_asked`] first in its `main`; it is started with one end of a
//! socket pair as its standard input (see [`frame`] for what is said), a folder of its own as working folder and for temporary files, and
//! limits that it sets on itself. It runs one FMU in one thread. It ends when the socket is closed, at the latest with the process that has started it.

mod frame;
mod launcher;
mod limits;
mod notes;
#[cfg(unix)]
mod child;
#[cfg(unix)]
mod process;
#[cfg(unix)]
mod workers;

#[cfg(unix)]
pub use child::{Service, serve_if_asked};
pub use frame::Frame;
pub use launcher::Launcher;
pub use limits::{Isolation, WorkerLimits};
#[cfg(unix)]
pub use workers::{Load, Workers};

/// What both sides have to be of.
const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "/1");

/// Environment variable by which a process is asked to serve; its value are the limits.
const ASKED: &str = "FMUFIT_WORKER";

/// Environment variable with the worker's folder.
const FOLDER: &str = "FMUFIT_WORKER_FOLDER";

/// Environment variable with the level up to which it is to log.
const LEVEL: &str = "FMUFIT_WORKER_LOG";

/// Whether this process was started as a worker.
pub fn is_asked() -> bool {
    std::env::var_os(ASKED).is_some()
}
