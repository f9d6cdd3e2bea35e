//! Processes in which FMUs run: what an FMU does to its process, this one does not notice.
//!
//! An FMU is foreign machine code: it crashes, hangs, leaks, calls `exit`, keeps values in statics. Whatever evaluates a model more than once
//! asks [`Workers`] to do it. A worker is a program that calls [`serve_if_asked`] first in its `main`; it is started with one end of a
//! socket pair as its standard input (see [`frame`] for what is said), a folder of its own as working folder and for temporary files, and
//! limits that it sets on itself. It runs one FMU in one thread. It ends when the socket is closed, at the latest with the process that has started it.

#[cfg(not(unix))]
mod absent;
#[cfg(unix)]
mod child;
mod frame;
mod launcher;
mod limits;
mod load;
#[cfg(unix)]
mod notes;
#[cfg(unix)]
mod process;
#[cfg(unix)]
mod workers;

#[cfg(not(unix))]
pub use absent::{Workers, serve_if_asked};
#[cfg(unix)]
pub use child::serve_if_asked;
pub use frame::Frame;
pub use launcher::Launcher;
pub use limits::{Isolation, WorkerLimits};
pub use load::Load;
#[cfg(unix)]
pub use workers::Workers;

use crate::description::Quirk;
use crate::error::FmiError;

/// What a worker does for who has started it.
pub trait Service {
    /// Answers a message. `cancelled`: the answer is not wanted any more.
    ///
    /// # Errors
    /// Told to the other side.
    fn answer(
        &mut self,
        asked: &Frame,
        cancelled: &dyn Fn() -> bool,
        answer: &mut Frame,
    ) -> Result<(), FmiError>;

    /// Departures from the standard that have shown in runs since the last call.
    fn new_quirks(&mut self) -> Vec<Quirk>;
}

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
