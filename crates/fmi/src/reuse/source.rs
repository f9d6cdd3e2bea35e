//! Where the copies of a library come from, and what tells one library from another.

use crate::error::FmiError;
use crate::platform::{self, FileIdentity, FilePlace};
use crate::sys::LoaderOptions;
use std::any::Any;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What keeps the folder of a copy on the disk.
pub(super) type FolderOwner = Arc<dyn Any + Send + Sync>;

/// What tells one library from another.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum Key {
    /// Of an archive: its fingerprint, and the place in it.
    Content(String, PathBuf, LoaderOptions),
    /// Of a folder, which may be edited: the file.
    File(FilePlace, FileIdentity, LoaderOptions),
}

/// Where copies of a library come from.
#[derive(Clone)]
pub(crate) struct Source {
    /// The original file.
    pub(crate) library: PathBuf,
    /// The folder of the FMU.
    pub(crate) root: PathBuf,
    /// What the file was when it was found, where it could be written over.
    pub(crate) identity: Option<FileIdentity>,
    /// Keeps the folder on the disk.
    pub(crate) folder_owner: Option<FolderOwner>,
}

impl Source {
    /// Whether the library is one of the FMU's files, not one that was built from its sources.
    pub(super) fn is_inside(&self) -> bool {
        self.library.starts_with(&self.root)
    }

    /// Where the library lies in the folder of a copy.
    pub(super) fn place(&self) -> PathBuf {
        match self.library.strip_prefix(&self.root) {
            Ok(place) => place.to_owned(),
            Err(_) => Path::new("binaries").join(self.library.file_name().unwrap_or_default()),
        }
    }

    /// # Errors
    /// The file was written over: a copy would be another library.
    pub(super) fn check_unchanged(&self) -> Result<(), FmiError> {
        let Some(identity) = &self.identity else { return Ok(()) };
        let metadata = self.library.metadata().map_err(FmiError::io("open", &self.library))?;
        match platform::file_identity(&metadata).same_content(identity) {
            true => Ok(()),
            false => Err(FmiError::written_over(&self.library)),
        }
    }
}
