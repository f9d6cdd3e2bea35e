//! The loaded libraries of an open FMU, which nobody else has: private copies of its files, loaded when they
//! are first needed.
//!
//! Some tools keep parameters in static variables, which neither reset nor a new instance renews (Simulink):
//! so a simulator has a copy in which nothing was set that it does not set, and instances made by hand have
//! one of theirs.
//!
//! A library is never unloaded: threads, handlers and exit functions that it has left behind are code of it.

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

/// The loaded libraries of an open FMU, and what is known of its instances.
#[derive(Debug, Default)]
pub(crate) struct Libraries {
    /// The file for each way of running the model; found when it is first needed.
    sources: [Mutex<Option<Arc<OriginalLibrary>>>; 2],
    loaded: Mutex<Vec<Loaded>>,
    /// Files of the FMU's own private folder that are loaded as they are.
    originals: Mutex<Vec<PathBuf>>,
    reset_knowledge: [Mutex<ResetKnowledge>; 2],
    /// Who builds, finds or loads a library has a turn.
    making: Arc<FairLock>,
}

type Loaded = (Arc<OriginalLibrary>, Arc<LoadedLibrary>);

/// Copies of the libraries of one FMU.
const MOST: usize = 16;

/// Use for which a library is needed.
#[derive(Clone, Copy)]
pub(crate) struct Wanted<'a> {
    pub(crate) kind: InterfaceKind,
    /// Everything that is going to be set, sorted; `None`: anything, by hand.
    pub(crate) settings: Option<&'a [Setting]>,
    /// One that nobody uses: there can be one instance in it only.
    pub(crate) only_one: bool,
}

/// Functions and options with which a needed library is loaded.
pub(crate) struct Maker<'a> {
    pub(crate) archive: &'a Arc<Archive>,
    pub(crate) loader: LoaderOptions,
    /// Finds the file, or builds it.
    pub(crate) find: &'a dyn Fn() -> Result<LibraryFile, FmiError>,
    pub(crate) open: &'a dyn Fn(LoadFrom<'_>) -> Result<Library, FmiError>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Libraries {
    /// State of knowledge about the reset of instances of one interface.
    pub(crate) fn reset_knowledge(&self, kind: InterfaceKind) -> MutexGuard<'_, ResetKnowledge> {
        lock(&self.reset_knowledge[kind as usize])
    }

    /// A loaded copy of the library. Where another thread is making one, waits as long as `wait` (asked every
    /// 20 ms) says so. No lock is held meanwhile.
    ///
    /// # Errors
    /// Those of the maker; the file cannot be copied; [`FmiError::Cancelled`].
    pub(crate) fn get(
        &self,
        wanted: Wanted<'_>,
        maker: &Maker<'_>,
        wait: &mut dyn FnMut() -> bool,
    ) -> Result<Arc<LoadedLibrary>, FmiError> {
        let Wanted { kind, settings, only_one } = wanted;
        let _turn = self.making.enter_while(wait).ok_or(FmiError::Cancelled)?;
        let source = self.source(kind, maker.archive, maker.loader, maker.find)?;
        let known = self.find(&source, settings, only_one);
        let is_known = known.is_some();
        let library = match known {
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
        if !is_known {
            lock(&self.loaded).push((source, Arc::clone(&library)));
        }
        Ok(library)
    }

    /// The file of the library; found when it is first asked for.
    ///
    /// # Errors
    /// Those of `find`; the file cannot be looked at.
    pub(crate) fn source(
        &self,
        kind: InterfaceKind,
        archive: &Archive,
        loader: LoaderOptions,
        find: &dyn Fn() -> Result<LibraryFile, FmiError>,
    ) -> Result<Arc<OriginalLibrary>, FmiError> {
        let known = lock(&self.sources[kind as usize]).clone();
        if let Some(source) = known {
            return Ok(source);
        }
        let source = Arc::new(OriginalLibrary::new(find()?, archive, loader)?);
        Ok(Arc::clone(lock(&self.sources[kind as usize]).insert(source)))
    }

    /// A loaded copy that serves, the one in which most of the settings were set before.
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
        // Beyond a number of copies models are taken at their word.
        let first =
            || loaded.first().filter(|_| loaded.len() >= MOST && !only_one).map(|(_, library)| library);
        found.or_else(first).map(Arc::clone)
    }

    /// True if the file itself is to be loaded: it is in a private folder, and is not loaded yet.
    fn takes_original(&self, source: &OriginalLibrary, archive: &Archive) -> bool {
        if !(archive.is_private() && source.is_inside()) {
            return false;
        }
        let mut originals = lock(&self.originals);
        let is_new = !originals.contains(&source.library);
        originals.extend(is_new.then(|| source.library.clone()));
        is_new
    }

    /// Uses a library no more.
    pub(crate) fn give_up(&self, library: &Arc<LoadedLibrary>) {
        lock(&self.loaded).retain(|(_, known)| !Arc::ptr_eq(known, library));
    }
}
