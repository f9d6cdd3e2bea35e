//! FMUs as source code: building and caching a library for this platform, and packing a folder into an
//! `.fmu`.

mod build;
mod cache;
mod compiler;
mod headers;
mod pack;

pub use build::build_library;
pub(crate) use build::{COMPILE_TIME, build_unchanged};
pub use cache::clear_caches;
pub(crate) use compiler::Patience;
pub(crate) use pack::write_archive;
pub use pack::{pack, pack_for, pack_texts};
