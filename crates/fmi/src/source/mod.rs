//! FMUs as source code: building a library for this platform, keeping it, and packing a folder into an `.fmu`.

mod build;
mod cache;
mod compiler;
mod headers;
mod library;
mod pack;

pub use cache::clear_caches;

pub(crate) use cache::folder as cache_folder;
pub use library::build_library;
pub(crate) use library::{COMPILE_TIME, build_unchanged};
pub use pack::{pack, pack_unless};
