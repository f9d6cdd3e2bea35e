//! The loaded copies of one library, for all who open its FMU in this process: lent to one owner at a time, and used again.
//!
//! Only libraries whose files show that nothing of them can be called later are unloaded: copies made for one run, and idle ones
//! beyond a number. All others are kept, and the store of a library stays in the process. What goes with its last user are the
//! idle instances and the folders.

use super::copies::{Defaults, LoadedCopy};
use super::copy_use::{CopyRequest, State};
use super::files;
use super::linkage::Linkage;
use super::source::Source;
use super::verdict::Verdict;
use crate::archive::Snapshot;
use crate::error::FmiError;
use crate::platform::check_length;
use crate::simulation::Sharing;
use crate::sys::{InterfaceKind, LoadFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};

/// The loaded copies of one library, and what is known about it.
pub(crate) struct CopyStore {
    state: Mutex<State>,
    pub(super) changed: Condvar,
    /// Owners that wait.
    pub(super) waiting: AtomicUsize,
    /// What the file says about loading it several times, and unloading it.
    linkage: OnceLock<Linkage>,
    /// The resources before anything was run.
    pub(super) resources: OnceLock<Snapshot>,
    /// Copies have resources of their own: the model writes into them.
    private_resources: AtomicBool,
    /// What is known about resetting its instances.
    verdicts: [Mutex<Verdict>; 2],
    /// What new instances answer for the variables that were ever set.
    defaults: Mutex<Defaults>,
}

impl CopyStore {
    pub(super) fn new() -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            waiting: AtomicUsize::new(0),
            linkage: OnceLock::new(),
            resources: OnceLock::new(),
            private_resources: AtomicBool::new(false),
            verdicts: Default::default(),
            defaults: Mutex::default(),
        }
    }

    pub(super) fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known about bringing back one kind of its instances.
    pub(crate) fn verdict(&self, kind: InterfaceKind) -> MutexGuard<'_, Verdict> {
        self.verdicts[kind as usize].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives up the idle copies that were used: their state is not that of a new one.
    pub(super) fn discard_used(&self) {
        let used: Vec<_> = self.state().idle.extract_if(.., |copy| copy.is_used()).collect();
        let may_unload = !used.is_empty() && self.may_unload();
        used.iter().filter(|_| may_unload).for_each(|copy| copy.unload_when_unused());
    }

    /// Loads the original file, or a copy of it.
    pub(super) fn make(
        &self,
        original: bool,
        source: &Source,
        request: &CopyRequest,
    ) -> Result<LoadedCopy, FmiError> {
        if original {
            self.linkage(source).siblings.iter().try_for_each(|sibling| check_length(sibling))?;
            let library = request.load(LoadFrom::File(&source.library))?;
            return Ok(LoadedCopy::new(library, request.kind, source.folder_owner.clone()));
        }
        if let Some(reason) = self.shared_state(source) {
            // What is left is unusable.
            return Err(FmiError::NoCopy { library: source.library.clone(), reason: reason.to_owned() });
        }
        let (path, folder) = files::copy(source, self.private_resources.load(Ordering::Relaxed))?;
        let library = request.load(LoadFrom::File(&path))?;
        Ok(LoadedCopy::new(library, request.kind, Some(Arc::new(folder))))
    }

    /// Takes in what was made. That no further copy could be made is an error only if there is no other.
    pub(super) fn made(
        &self,
        original: bool,
        request: &CopyRequest,
        made: Result<LoadedCopy, FmiError>,
    ) -> Result<(), FmiError> {
        let mut state = self.state();
        state.making -= 1;
        state.making_serial &= request.sharing != Sharing::Serial;
        let outcome = match made {
            Ok(copy) => {
                state.idle.push(Arc::new(copy));
                Ok(())
            }
            Err(error) if original => {
                state.original_taken = false;
                Err(error)
            }
            Err(error) => {
                let nothing_there = state.in_use.is_empty() && state.idle.is_empty() && state.making == 0;
                let reason = match error {
                    FmiError::NoCopy { reason, .. } => reason,
                    error => format!("no further copy of the library can be loaded: {error}"),
                };
                if state.refused.is_none() {
                    let library = state.source.as_ref().map(|source| source.library.display().to_string());
                    log::warn!("{}: {reason}", library.unwrap_or_default());
                }
                state.refused = Some(reason.clone());
                state.n_refused = state.in_use.len();
                let library = state.source.as_ref().map(|source| source.library.clone()).unwrap_or_default();
                if nothing_there {
                    let reason = format!("those that were loaded have answered fatal, and {reason}");
                    Err(FmiError::NoCopy { library, reason })
                } else {
                    Ok(())
                }
            }
        };
        drop(state);
        self.notify();
        outcome
    }

    /// Makes sure that a copy has its folder, as far as the library could miss it.
    pub(super) fn ensure_folder(&self, copy: &LoadedCopy, source: &Source) {
        let mut folder_owner = copy.folder_owner();
        if folder_owner.is_some() || copy.path() == source.library || !files::has_company(source) {
            return;
        }
        match files::restore(copy.path(), source) {
            Ok(folder) => *folder_owner = Some(Arc::new(folder)),
            Err(error) => {
                log::warn!("the folder of a loaded library has gone and cannot be made again: {error}")
            }
        }
    }

    /// Takes a copy back; after `Fatal` it is left alone for good.
    pub(super) fn give_back(&self, copy: &Arc<LoadedCopy>, id: u64) {
        let mut state = self.state();
        let place = state.in_use.iter().position(|in_use| Arc::ptr_eq(&in_use.copy, copy));
        let mut surplus = None;
        if let Some(place) = place {
            state.in_use[place].holders.retain(|(known, _)| *known != id);
            if state.in_use[place].holders.is_empty() {
                let in_use = state.in_use.swap_remove(place);
                if !copy.is_fatal() && !copy.is_retired() {
                    state.idle.push(in_use.copy);
                    surplus = state.surplus();
                }
                if state.in_use.len() < state.n_refused / 2 {
                    // What was used up is free again.
                    state.refused = None;
                }
            }
        }
        drop(state);
        if let Some(surplus) = surplus {
            surplus.free_idle();
            if self.may_unload() {
                surplus.unload_when_unused();
                self.state().idle.retain(|copy| !Arc::ptr_eq(copy, &surplus));
            } else {
                surplus.release_folder();
            }
        }
        self.notify();
    }

    /// Has waiting owners look again: a copy is back, or a simulation is over.
    pub(crate) fn notify(&self) {
        if self.waiting.load(Ordering::SeqCst) > 0 {
            self.state().changes += 1;
            self.changed.notify_all();
        }
    }

    /// What new instances answer for the variables that were ever set, as far as it was asked for.
    pub(super) fn defaults(&self) -> MutexGuard<'_, Defaults> {
        self.defaults.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn linkage(&self, source: &Source) -> &Linkage {
        self.linkage.get_or_init(|| Linkage::of(&source.library, &source.root))
    }

    /// Why copies would share static variables, where they would.
    pub(super) fn shared_state(&self, source: &Source) -> Option<&str> {
        self.linkage(source).shared_state.as_deref()
    }

    /// Whether copies that are not needed any more can be unloaded.
    pub(super) fn may_unload(&self) -> bool {
        let Some(source) = self.state().source.clone() else { return false };
        self.linkage(&source).may_be_unloaded
    }

    /// A file below the resources that was written, made or removed since the library was loaded, where all copies share them.
    pub(crate) fn written_resource(&self) -> Option<PathBuf> {
        match self.private_resources.load(Ordering::Relaxed) {
            true => None,
            false => self.resources.get()?.first_change(),
        }
    }

    /// Has copies made with resources of their own from now on.
    pub(crate) fn set_private_resources(&self) {
        self.private_resources.store(true, Ordering::Relaxed);
    }

    /// Where instances of a loaded copy find the resources: `shared`, or in the folder of the copy.
    pub(crate) fn resources_of(&self, library: &Path, shared: PathBuf) -> PathBuf {
        if !self.private_resources.load(Ordering::Relaxed) {
            return shared;
        }
        match &self.state().source {
            Some(source) if source.library != library => files::root_of(library, source).join("resources"),
            _ => shared,
        }
    }

    /// How owners that ask for copies share the process.
    pub(crate) fn sharing(&self) -> Sharing {
        let source = self.state().source.clone();
        let shares = source.is_some_and(|source| self.shared_state(&source).is_some());
        if shares || self.state().one_at_a_time.is_some() { Sharing::Serial } else { Sharing::Copies }
    }

    /// Whether a new copy could be loaded, as far as is known.
    pub(crate) fn may_copy(&self) -> bool {
        self.sharing() == Sharing::Copies && self.state().refused.is_none()
    }
}

impl std::fmt::Debug for CopyStore {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let state = self.state();
        f.debug_struct("CopyStore")
            .field("idle", &state.idle.len())
            .field("lent", &state.in_use.len())
            .field("one_at_a_time", &state.one_at_a_time)
            .field("refused", &state.refused)
            .finish_non_exhaustive()
    }
}
