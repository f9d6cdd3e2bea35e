//! Processes in which FMUs run: what an FMU does to its process, this one does not notice.
//!
//! An FMU is foreign machine code: it crashes, hangs, leaks, calls `exit`, keeps values in statics. Whatever
//! evaluates a model more than once asks [`Workers`] to do it. A worker is a program that calls
//! [`serve_if_asked`] first in its `main`; it is started with one end of a socket pair as its standard input
//! (see [`Frame`] for what is said), a folder of its own as working folder and for temporary files, and
//! limits that it sets on itself. It runs one FMU in one thread. It ends when the socket is closed, at the
//! latest with the process that has started it.

#[cfg(not(unix))]
mod absent;
#[cfg(unix)]
mod child;
#[cfg(unix)]
mod folder;
mod frame;
mod launcher;
mod limits;
mod load;
#[cfg(unix)]
mod notes;
#[cfg(unix)]
mod process;
mod service;
mod settings;
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
pub use service::Service;
pub use settings::is_asked;
#[cfg(unix)]
pub use workers::Workers;
