//! Shared parts of all crates of this workspace: the context of a run, number formatting and files.
#![forbid(unsafe_code)]

mod context;
#[cfg(feature = "files")]
pub mod files;
mod number;
mod time;

pub use context::RunContext;
pub use number::{Bytes, Number};
pub use time::time_tolerance;

/// Returns the number of processor cores that this process may use; 1 if it is unknown.
pub fn available_cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}
