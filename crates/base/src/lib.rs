//! Parts that all crates of this workspace share: the context of a run, files.
#![forbid(unsafe_code)]

mod context;
pub mod files;

pub use context::RunContext;
