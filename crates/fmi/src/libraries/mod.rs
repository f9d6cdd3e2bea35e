//! The loaded libraries of an open FMU, used by no other FMU: private copies of its files, loaded on first
//! use.
//!
//! Some tools (Simulink) keep parameters in static variables, which are not renewed by a reset or a new
//! instance. A simulator therefore uses a copy in which only variables were set that the simulator also sets.
//! Instances driven by the user have a separate copy.
//!
//! A library is never unloaded, because threads, handlers and exit functions that it has registered run its
//! code.

mod loaded;
mod original;
mod private_copy;
mod reset_knowledge;

pub(crate) use loaded::{LoadedLibrary, Setting};
pub use reset_knowledge::Reuse;
pub(crate) use reset_knowledge::{ResetKnowledge, StopTime};

use crate::archive::Archive;
use crate::error::FmiError;
use crate::fair_lock::FairLock;
use crate::sys::{InterfaceKind, Library, LoadFrom, LoaderOptions};
pub(crate) use original::LibraryFile;
use original::OriginalLibrary;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The loaded libraries of an open FMU, and the knowledge about its instances.
#[derive(Debug, Default)]
pub(crate) struct Libraries {
    /// Library file for each interface; found on first use.
    sources: [Mutex<Option<Arc<OriginalLibrary>>>; 2],
    loaded: Mutex<Vec<Loaded>>,
    /// Files in the FMU's own private folder that are loaded in place.
    originals: Mutex<Vec<PathBuf>>,
    reset_knowledge: [Mutex<ResetKnowledge>; 2],
    /// Held by the thread that builds, finds or loads a library.
    making: Arc<FairLock>,
}

type Loaded = (Arc<OriginalLibrary>, Arc<LoadedLibrary>);

/// Number of library copies of one FMU up to which the settings decide whether a copy is reused.
const MOST: usize = 16;

/// Intended use of a library.
#[derive(Clone, Copy)]
pub(crate) struct LibraryRequest<'a> {
    pub(crate) kind: InterfaceKind,
    /// All variables that will be set, sorted; `None` for any variables, set by the user.
    pub(crate) settings: Option<&'a [Setting]>,
    /// True if the copy must be unused, because it supports only one instance.
    pub(crate) only_one: bool,
}

/// Functions and options for loading a library.
pub(crate) struct Maker<'a> {
    pub(crate) archive: &'a Arc<Archive>,
    pub(crate) loader: LoaderOptions,
    /// Finds or builds the file.
    pub(crate) find: &'a dyn Fn() -> Result<LibraryFile, FmiError>,
    pub(crate) open: &'a dyn Fn(LoadFrom<'_>) -> Result<Library, FmiError>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Libraries {
    /// Returns the knowledge about the reset of instances of one interface.
    pub(crate) fn reset_knowledge(&self, kind: InterfaceKind) -> MutexGuard<'_, ResetKnowledge> {
        lock(&self.reset_knowledge[kind as usize])
    }

    /// Returns a loaded copy of the library. If another thread is loading one, waits while `wait` (called
    /// every 20 ms) returns true. No mutex is locked during the wait.
    ///
    /// # Errors
    /// Returns an error if the maker fails, if the file cannot be copied, or if the wait is cancelled
    /// ([`FmiError::Cancelled`]).
    pub(crate) fn get(
        &self,
        request: LibraryRequest<'_>,
        maker: &Maker<'_>,
        wait: &mut dyn FnMut() -> bool,
    ) -> Result<Arc<LoadedLibrary>, FmiError> {
        let LibraryRequest { kind, settings, only_one } = request;
        let _turn = self.making.enter_while(wait).ok_or(FmiError::Cancelled)?;
        let source = self.source(kind, maker.archive, maker.loader, maker.find)?;
        let loaded = self.find(&source, settings, only_one);
        let is_loaded = loaded.is_some();
        let library = match loaded {
            Some(library) => library,
            None => {
                source.check_unchanged()?;
                let owner =
                    self.takes_original(&source, maker.archive).then(|| Arc::clone(maker.archive) as _);
                Arc::new(LoadedLibrary::of(&source, owner)?)
            }
        };
        library.ensure_table(kind, maker.open)?;
        library.note_set(settings);
        if !is_loaded {
            lock(&self.loaded).push((source, Arc::clone(&library)));
        }
        Ok(library)
    }

    /// Returns the file of the library, which is found on first use.
    ///
    /// # Errors
    /// Returns an error if `find` fails or if the file cannot be inspected.
    pub(crate) fn source(
        &self,
        kind: InterfaceKind,
        archive: &Archive,
        loader: LoaderOptions,
        find: &dyn Fn() -> Result<LibraryFile, FmiError>,
    ) -> Result<Arc<OriginalLibrary>, FmiError> {
        let cached = lock(&self.sources[kind as usize]).clone();
        if let Some(source) = cached {
            return Ok(source);
        }
        let source = Arc::new(OriginalLibrary::new(find()?, archive, loader)?);
        Ok(Arc::clone(lock(&self.sources[kind as usize]).insert(source)))
    }

    /// Returns a suitable loaded copy. If there are several, returns the one with the largest number of
    /// matching earlier settings.
    fn find(
        &self,
        source: &Arc<OriginalLibrary>,
        settings: Option<&[Setting]>,
        only_one: bool,
    ) -> Option<Arc<LoadedLibrary>> {
        let is_unused = |library: &Arc<LoadedLibrary>| Arc::strong_count(library) == 1;
        let mut loaded = lock(&self.loaded);
        loaded.retain(|(_, library)| !library.is_fatal());
        let of_source =
            loaded.iter().filter(|(of, library)| of.is_same(source) && (!only_one || is_unused(library)));
        let rated = of_source.filter_map(|(_, library)| Some((library.n_set_of(settings)?, library)));
        let found = rated.max_by_key(|(n, _)| *n).map(|(_, library)| library);
        // Beyond this number of copies, a copy is reused regardless of its settings.
        let first =
            || loaded.first().filter(|_| loaded.len() >= MOST && !only_one).map(|(_, library)| library);
        found.or_else(first).map(Arc::clone)
    }

    /// True if the file itself should be loaded: it is in a private folder, and has not been loaded yet.
    fn takes_original(&self, source: &OriginalLibrary, archive: &Archive) -> bool {
        if !(archive.is_private() && source.is_inside()) {
            return false;
        }
        let mut originals = lock(&self.originals);
        let is_new = !originals.contains(&source.library);
        originals.extend(is_new.then(|| source.library.clone()));
        is_new
    }

    /// Stops using a library.
    pub(crate) fn give_up(&self, library: &Arc<LoadedLibrary>) {
        lock(&self.loaded).retain(|(_, other)| !Arc::ptr_eq(other, library));
    }
}
