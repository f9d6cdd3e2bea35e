//! A loaded copy of a library: one file with static variables of its own, for both ways of running the model.

use super::original::OriginalLibrary;
use super::private_copy;
use crate::error::FmiError;
use crate::fair_lock::FairLock;
use crate::sys::{InterfaceKind, Library, LoadFrom};
use crate::value::VariableKind;
use std::any::Any;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Owner that keeps the folder of a copy on the disk.
pub(super) type FolderOwner = Arc<dyn Any + Send + Sync>;

/// A variable that runs set: whether before the initialization (or in it, and later), its type, its
/// reference.
pub(crate) type Setting = (bool, VariableKind, u32);

/// A loaded copy of a library.
pub(crate) struct LoadedLibrary {
    path: PathBuf,
    /// Every setting ever made in it, sorted; `None`: anything, by hand.
    set: Mutex<Option<Vec<Setting>>>,
    lock: Arc<FairLock>,
    /// One function table for each way of running the model, over the same static variables.
    tables: [Mutex<Option<Arc<Library>>>; 2],
    _folder: FolderOwner,
}

impl std::fmt::Debug for LoadedLibrary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LoadedLibrary({})", self.path.display())
    }
}

impl LoadedLibrary {
    /// A copy that is not loaded yet: of the file in a folder of its own, or the file itself, where nobody
    /// else has `owner`'s folder.
    ///
    /// # Errors
    /// The file cannot be copied.
    pub(super) fn of(source: &OriginalLibrary, owner: Option<FolderOwner>) -> Result<Self, FmiError> {
        let (path, folder) = match owner {
            Some(owner) => (source.library.clone(), owner),
            None => {
                let (path, folder) = private_copy::copy(source)?;
                (path, Arc::new(folder) as FolderOwner)
            }
        };
        let (lock, tables) = (source.lock(), Default::default());
        Ok(Self { path, set: Mutex::new(Some(Vec::new())), lock, tables, _folder: folder })
    }

    /// Number of a user's settings that were made in it before (`None`: users set anything, by hand); no
    /// answer where others were made.
    pub(super) fn n_set_of(&self, settings: Option<&[Setting]>) -> Option<usize> {
        match (&*self.set.lock().unwrap_or_else(PoisonError::into_inner), settings) {
            (None, None) => Some(1),
            (Some(set), None) => set.is_empty().then_some(0),
            (None, Some(_)) => None,
            (Some(set), Some(settings)) => {
                set.iter().all(|one| settings.binary_search(one).is_ok()).then_some(set.len())
            }
        }
    }

    /// Notes what a user sets in it.
    pub(super) fn note_set(&self, settings: Option<&[Setting]>) {
        let mut set = self.set.lock().unwrap_or_else(PoisonError::into_inner);
        *set = match (set.take(), settings) {
            (Some(mut set), Some(settings)) => {
                set.extend_from_slice(settings);
                set.sort_unstable();
                set.dedup();
                Some(set)
            }
            _ => None,
        };
    }

    /// The functions for one way of running the model, loaded by `open` if they are not yet.
    ///
    /// # Errors
    /// Those of `open`.
    pub(super) fn ensure_table(
        &self,
        kind: InterfaceKind,
        open: impl FnOnce(LoadFrom<'_>) -> Result<Library, FmiError>,
    ) -> Result<(), FmiError> {
        if self.table(kind).is_some() {
            return Ok(());
        }
        let known = [InterfaceKind::ModelExchange, InterfaceKind::CoSimulation];
        let other = known.into_iter().find_map(|kind| self.table(kind).clone());
        let library = match &other {
            Some(other) => open(LoadFrom::Loaded(other))?,
            None => open(LoadFrom::File(&self.path, &self.lock))?,
        };
        *self.table(kind) = Some(Arc::new(library));
        Ok(())
    }

    fn table(&self, kind: InterfaceKind) -> MutexGuard<'_, Option<Arc<Library>>> {
        self.tables[kind as usize].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The functions for one way of running the model.
    ///
    /// # Errors
    /// They were never loaded.
    pub(crate) fn functions(&self, kind: InterfaceKind) -> Result<Arc<Library>, FmiError> {
        self.table(kind).clone().ok_or_else(|| FmiError::LibraryUnusable(self.path.clone()))
    }

    /// Who is inside of it has a turn of this.
    pub(crate) fn lock(&self) -> &Arc<FairLock> {
        &self.lock
    }

    fn any(&self, holds: impl Fn(&Library) -> bool) -> bool {
        self.tables
            .iter()
            .any(|table| table.lock().unwrap_or_else(PoisonError::into_inner).as_deref().is_some_and(&holds))
    }

    /// True if a call has returned `Fatal`: it is never used again.
    pub(crate) fn is_fatal(&self) -> bool {
        self.any(Library::is_fatal)
    }

    /// True if an instance was ever made in it.
    pub(crate) fn is_used(&self) -> bool {
        self.any(Library::is_used)
    }
}
