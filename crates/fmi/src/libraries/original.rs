//! The original library file of an FMU, and the identity of its content in this process.

use crate::archive::Archive;
use crate::error::FmiError;
use crate::fair_lock::FairLock;
use crate::platform::{self, FileIdentity, FilePlace};
use crate::sys::LoaderOptions;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Key that distinguishes libraries.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Key {
    /// A library in an archive: fingerprint of the archive, and path in the archive.
    Content(String, PathBuf, LoaderOptions),
    /// A library in a folder, which may be edited: the file.
    File(FilePlace, FileIdentity, LoaderOptions),
}

/// Locks of all loaded copies of a library, shared by all FMUs that contain it, because copies may share
/// variables. Libraries are never unloaded, so locks are never removed.
static LOCKS: Mutex<Option<HashMap<Key, Arc<FairLock>>>> = Mutex::new(None);

/// Location of a library.
#[derive(Debug)]
pub(crate) struct LibraryFile {
    /// The original file.
    pub(crate) library: PathBuf,
    /// The folder of the FMU.
    pub(crate) root: PathBuf,
}

/// The file of a library.
#[derive(Debug)]
pub(crate) struct OriginalLibrary {
    /// The original file.
    pub(super) library: PathBuf,
    /// The folder of the FMU.
    pub(super) root: PathBuf,
    /// Identity of the file when it was found, if the file could be modified.
    identity: Option<FileIdentity>,
    lock: Arc<FairLock>,
}

impl OriginalLibrary {
    /// # Errors
    /// Returns an error if the file cannot be inspected.
    pub(super) fn new(
        LibraryFile { library, root }: LibraryFile,
        archive: &Archive,
        loader: LoaderOptions,
    ) -> Result<Self, FmiError> {
        let (key, identity) = match (library.strip_prefix(&root), archive.fingerprint()) {
            (Ok(place), Some(content)) => (Key::Content(content, place.to_owned(), loader), None),
            _ => {
                let metadata = library.metadata().map_err(FmiError::io("open", &library))?;
                let identity = platform::file_identity(&metadata);
                (Key::File(identity.place(&library), identity.clone(), loader), Some(identity))
            }
        };
        let mut locks = LOCKS.lock().unwrap_or_else(PoisonError::into_inner);
        let lock = Arc::clone(locks.get_or_insert_default().entry(key).or_default());
        Ok(Self { library, root, identity, lock })
    }

    /// True if both have the same content.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.lock, &other.lock)
    }

    /// True if the library is a file of the FMU, and not built from its sources.
    pub(super) fn is_inside(&self) -> bool {
        self.library.starts_with(&self.root)
    }

    /// Returns the path of the library inside the folder of a copy.
    pub(super) fn place(&self) -> PathBuf {
        match self.library.strip_prefix(&self.root) {
            Ok(place) => place.to_owned(),
            Err(_) => Path::new("binaries").join(self.library.file_name().unwrap_or_default()),
        }
    }

    /// # Errors
    /// Returns an error if the file has been modified, because a copy would be a different library.
    pub(super) fn check_unchanged(&self) -> Result<(), FmiError> {
        let Some(identity) = &self.identity else { return Ok(()) };
        let metadata = self.library.metadata().map_err(FmiError::io("open", &self.library))?;
        match platform::file_identity(&metadata).same_content(identity) {
            true => Ok(()),
            false => Err(FmiError::written_over(&self.library)),
        }
    }

    /// Returns the lock of the copies.
    pub(super) fn lock(&self) -> Arc<FairLock> {
        Arc::clone(&self.lock)
    }
}
