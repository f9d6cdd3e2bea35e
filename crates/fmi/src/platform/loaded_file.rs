//! What all users of one loaded library file have in common, whichever way they opened it: the loader gives the same code
//! and the same static variables to everybody in the process.

use super::system::{FileIdentity, FilePlace, file_identity};
use crate::error::FmiError;
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The library files of this process. An entry goes when its library is unloaded, which few are (see `platform::Handle`).
static KNOWN: Mutex<Option<Libraries>> = Mutex::new(None);

#[derive(Default)]
struct Libraries {
    /// Each with what its file was when it was loaded.
    files: HashMap<FilePlace, (FileIdentity, Arc<Shared>)>,
    /// The paths by which they were opened, letter by letter.
    paths: HashMap<OsString, FilePlace>,
}

impl Libraries {
    /// A path to open a file by. The loader of glibc takes a path for that of the library that it has loaded by the same one,
    /// also when another file has taken its place; written otherwise, it makes it look at the file.
    fn path_to_open(&mut self, path: &Path, place: &FilePlace) -> OsString {
        let mut written = path.as_os_str().to_owned();
        let mut steps = String::new();
        while self.paths.get(&written).is_some_and(|known| known != place)
            && let (Some(folder), Some(name)) = (path.parent(), path.file_name())
        {
            // To where one stands.
            steps.push_str("/.");
            written = folder.as_os_str().to_owned();
            written.push(&steps);
            written.push("/");
            written.push(name);
        }
        self.paths.insert(written.clone(), place.clone());
        written
    }
}

/// What is known about a loaded file.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Under which it is known.
    place: FilePlace,
    /// How often it was opened and not closed; changed under the lock of [`KNOWN`] only.
    n_open: AtomicUsize,
    /// A call returned `Fatal`.
    fatal: AtomicBool,
    /// A component was made.
    used: AtomicBool,
}

impl Shared {
    /// What is shared by all users of the library at `path`, which is about to be loaded. Whoever closes it again, or could
    /// not load it, says so by [`closed`](Self::closed). And the path by which the loader finds that file.
    ///
    /// # Errors
    /// The file cannot be looked at, or it was written over since it was loaded: the loader would hand out the old code.
    pub(crate) fn of(path: &Path) -> Result<(Arc<Shared>, OsString), FmiError> {
        let metadata = path.metadata().map_err(FmiError::io("open", path))?;
        let identity = file_identity(&metadata);
        let mut known = known();
        let libraries = known.get_or_insert_default();
        let place = identity.place(path);
        let shared = match libraries.files.get(&place) {
            Some((then, shared)) if then.same_content(&identity) => Arc::clone(shared),
            Some(_) => return Err(FmiError::written_over(path)),
            None => {
                let shared = Arc::new(Shared {
                    place: place.clone(),
                    n_open: AtomicUsize::new(0),
                    fatal: AtomicBool::new(false),
                    used: AtomicBool::new(false),
                });
                libraries.files.insert(place, (identity, Arc::clone(&shared)));
                shared
            }
        };
        shared.n_open.fetch_add(1, Ordering::Relaxed);
        let path = libraries.path_to_open(path, &shared.place);
        Ok((shared, path))
    }

    /// One user could not load the library, or is about to close it: with the last one it is forgotten, before the place of
    /// its file on the disk can be given to another file.
    pub(crate) fn closed(&self) {
        let mut known = known();
        if self.n_open.fetch_sub(1, Ordering::Relaxed) == 1
            && let Some(libraries) = &mut *known
        {
            libraries.files.remove(&self.place);
            libraries.paths.retain(|_, place| *place != self.place);
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

    pub(crate) fn set_used(&self) {
        self.used.store(true, Ordering::Relaxed);
    }

    pub(crate) fn set_fatal(&self) {
        self.fatal.store(true, Ordering::Relaxed);
    }
}

fn known() -> MutexGuard<'static, Option<Libraries>> {
    KNOWN.lock().unwrap_or_else(PoisonError::into_inner)
}
