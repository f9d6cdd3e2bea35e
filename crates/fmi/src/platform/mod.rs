//! Code that depends on the operating system or the processor: names of folders and libraries, headers
//! of shared libraries, identities of files, available memory.

mod atomic_file;
mod binary;
mod binary_folders;
mod build_target;
mod compiler_process;
mod file_identity;
mod find_binary;
mod folder_lock;
pub(crate) mod memory;
mod missing_libraries;
mod platforms;
mod private_folders;

pub use atomic_file::fill_atomically;
pub(crate) use binary::check_length;
pub use binary::{BinaryFormat, BinaryHeader, Machine};
pub use binary_folders::{FolderNames, LIBRARY_EXTENSION, binary_folders};
pub use build_target::BuildTarget;
pub(crate) use compiler_process::*;
pub(crate) use file_identity::*;
pub(crate) use find_binary::unusable_binary;
pub use find_binary::{FoundBinary, find_binary};
pub(crate) use folder_lock::{LOCK, MARK, NEW_LOCK, is_left_behind, new_lock};
pub(crate) use missing_libraries::missing_libraries;
pub(crate) use platforms::platforms;
pub use platforms::{Platform, RunsBy};
pub use private_folders::without_private_folders;
pub(crate) use private_folders::*;
