//! FMUs as source code: building a library for this platform, keeping it, and packing a folder into an
//! `.fmu`.

mod build;
mod cache;
mod compiler;
mod headers;
mod library;
mod pack;

pub use cache::clear_caches;

pub use library::build_library;
pub(crate) use library::{COMPILE_TIME, build_unchanged};
pub(crate) use pack::write_archive;
pub use pack::{pack, pack_texts, pack_unless};
