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
