//! What every crate of this workspace needs and none of them is about: the context of a run, files.
#![forbid(unsafe_code)]

mod context;
pub mod files;

pub use context::RunContext;
