//! What every crate of this workspace needs and none of them is about: files.
#![forbid(unsafe_code)]

pub mod files;
