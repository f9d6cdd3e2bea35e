//! Everything that differs between operating systems and processors: names of folders and libraries, headers
//! of shared libraries, what tells one file from another, memory that is left.

mod atomic_file;
mod binary;
mod find_binary;
pub(crate) mod memory;
mod system;
mod unloading;

pub use atomic_file::fill_atomically;
pub(crate) use binary::check_length;
pub use binary::{BinaryFormat, BinaryHeader, Machine};
pub(crate) use find_binary::unusable_binary;
pub use find_binary::{FoundBinary, find_binary};
pub use system::*;
pub(crate) use unloading::may_be_unloaded;
