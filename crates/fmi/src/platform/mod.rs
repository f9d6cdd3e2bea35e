//! Everything that differs between operating systems and processors: names of folders and libraries, headers
//! of shared libraries, what tells one file from another, memory that is left.

mod atomic_file;
mod binary;
mod binary_folders;
mod compiler_process;
mod file_identity;
mod find_binary;
pub(crate) mod memory;
mod private_folders;

pub use atomic_file::fill_atomically;
pub(crate) use binary::check_length;
pub use binary::{BinaryFormat, BinaryHeader, Machine};
pub use binary_folders::{FolderNames, LIBRARY_EXTENSION, binary_folders};
pub(crate) use compiler_process::*;
pub(crate) use file_identity::*;
pub(crate) use find_binary::unusable_binary;
pub use find_binary::{FoundBinary, find_binary};
pub use private_folders::without_private_folders;
pub(crate) use private_folders::*;
