//! Parts that all crates of this workspace share: the context of a run, numbers as messages show them, files.
#![forbid(unsafe_code)]

mod context;
#[cfg(feature = "files")]
pub mod files;
mod number;
mod time;

pub use context::RunContext;
pub use number::{Bytes, Number};
pub use time::time_tolerance;
