//! What all users of one loaded library file have in common, whichever way they opened it: the loader gives the same code
//! and the same static variables to everybody in the process.

use crate::error::FmiError;
use crate::platform::{self, FileIdentity, FilePlace};
use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The library files of this process. An entry goes when its library is unloaded, which few are (see `platform::Handle`).
static KNOWN: Mutex<Option<Libraries>> = Mutex::new(None);

/// Each with what its file was when it was loaded.
type Libraries = HashMap<FilePlace, (FileIdentity, Arc<Shared>)>;

/// What is known about a loaded file.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    /// A call returned `Fatal`.
    fatal: AtomicBool,
    /// A component was made.
    used: AtomicBool,
}

impl Shared {
    /// What is shared by all users of the library at `path`, which is about to be loaded.
    ///
    /// # Errors
    /// The file cannot be looked at, or it was written over since it was loaded: the loader would hand out the old code.
    pub(super) fn of(path: &Path) -> Result<Arc<Shared>, FmiError> {
        let metadata = path.metadata().map_err(FmiError::io("open", path))?;
        let identity = platform::file_identity(&metadata);
        let mut known = known();
        let entries = known.get_or_insert_default();
        match entries.get(&identity.place(path)) {
            Some((then, shared)) if then.same_content(&identity) => Ok(Arc::clone(shared)),
            Some(_) => Err(FmiError::written_over(path)),
            None => {
                let shared = Arc::<Shared>::default();
                entries.insert(identity.place(path), (identity, Arc::clone(&shared)));
                Ok(shared)
            }
        }
    }

    /// Forgets a library that could not be loaded, or is about to be unloaded.
    pub(super) fn forget(path: &Path) {
        if let Ok(metadata) = path.metadata() {
            let place = platform::file_identity(&metadata).place(path);
            if let Some(entries) = &mut *known() {
                entries.remove(&place);
            }
        }
    }

    /// Whether a call has returned `Fatal`: then nothing of this loaded file can be trusted any more.
    #[inline]
    pub(crate) fn is_fatal(&self) -> bool {
        self.fatal.load(Ordering::Relaxed)
    }

    /// Whether a component was ever made in this loaded file: then its static variables may have a past.
    #[inline]
    pub(crate) fn is_used(&self) -> bool {
        self.used.load(Ordering::Relaxed)
    }

    pub(super) fn set_used(&self) {
        self.used.store(true, Ordering::Relaxed);
    }

    pub(super) fn set_fatal(&self) {
        self.fatal.store(true, Ordering::Relaxed);
    }
}

fn known() -> MutexGuard<'static, Option<Libraries>> {
    KNOWN.lock().unwrap_or_else(PoisonError::into_inner)
}
