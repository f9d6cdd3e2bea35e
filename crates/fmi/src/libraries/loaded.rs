//! A loaded copy of a library: one file with separate static variables, for both interfaces.

use super::original::OriginalLibrary;
use super::private_copy;
use crate::error::FmiError;
use crate::fair_lock::FairLock;
use crate::sys::{InterfaceKind, Library, LoadFrom};
use crate::value::VariableKind;
use std::any::Any;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Owner that keeps the folder of a copy from being removed.
pub(super) type FolderOwner = Arc<dyn Any + Send + Sync>;

/// A variable that runs set: a flag, its type, and its value reference. The flag is true if the variable is
/// set before the initialization, and false if it is set during the initialization or later.
pub(crate) type Setting = (bool, VariableKind, u32);

/// A loaded copy of a library.
pub(crate) struct LoadedLibrary {
    path: PathBuf,
    /// All settings ever made in the copy, sorted; `None` for any settings, made by the user.
    set: Mutex<Option<Vec<Setting>>>,
    lock: Arc<FairLock>,
    /// One function table for each interface, with shared static variables.
    tables: [Mutex<Option<Arc<Library>>>; 2],
    _folder: FolderOwner,
}

impl std::fmt::Debug for LoadedLibrary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LoadedLibrary({})", self.path.display())
    }
}

impl LoadedLibrary {
    /// Creates a copy that is not loaded yet. The copy is a file in a separate folder, or the original file
    /// if the folder of `owner` is not used otherwise.
    ///
    /// # Errors
    /// Returns an error if the file cannot be copied.
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

    /// Returns how many of the settings were made in the copy before. `None` as argument means any settings,
    /// made by the user. Returns `None` if other settings were made in the copy.
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

    /// Adds these settings to the record of settings made in this copy.
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

    /// Loads the functions for one interface with `open`, unless they are already loaded.
    ///
    /// # Errors
    /// Returns the errors of `open`.
    pub(super) fn ensure_table(
        &self,
        kind: InterfaceKind,
        open: impl FnOnce(LoadFrom<'_>) -> Result<Library, FmiError>,
    ) -> Result<(), FmiError> {
        if self.table(kind).is_some() {
            return Ok(());
        }
        let kinds = [InterfaceKind::ModelExchange, InterfaceKind::CoSimulation];
        let other = kinds.into_iter().find_map(|kind| self.table(kind).clone());
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

    /// Returns the functions for one interface.
    ///
    /// # Errors
    /// Returns an error if the functions were never loaded.
    pub(crate) fn functions(&self, kind: InterfaceKind) -> Result<Arc<Library>, FmiError> {
        self.table(kind).clone().ok_or_else(|| FmiError::LibraryUnusable(self.path.clone()))
    }

    /// Returns the lock that a thread must hold to use the library.
    pub(crate) fn lock(&self) -> &Arc<FairLock> {
        &self.lock
    }

    fn any(&self, holds: impl Fn(&Library) -> bool) -> bool {
        self.tables
            .iter()
            .any(|table| table.lock().unwrap_or_else(PoisonError::into_inner).as_deref().is_some_and(&holds))
    }

    /// True if a call has returned `Fatal`. The copy is then never used again.
    pub(crate) fn is_fatal(&self) -> bool {
        self.any(Library::is_fatal)
    }

    /// True if an instance was ever created in the copy.
    pub(crate) fn is_used(&self) -> bool {
        self.any(Library::is_used)
    }
}
