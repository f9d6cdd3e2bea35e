//! The loaded copies of one library, for all who open its FMU in this process: lent to one owner at a time, and used again.
//!
//! Only libraries whose files show that nothing of them can be called later are unloaded: copies made for one run, and idle ones
//! beyond a number. All others are kept, and the store of a library stays in the process. What goes with its last user are the
//! idle instances and the folders.

use super::copies::{Defaults, LoadedCopy};
use super::copy_use::{CopyInUse, CopyOwner, CopyRequest, Release, State};
use super::files;
use super::linkage::Linkage;
use super::source::Source;
use super::verdict::{Reuse, Verdict};
use crate::archive::Snapshot;
use crate::error::FmiError;
use crate::platform::check_length;
use crate::simulation::Sharing;
use crate::sys::{InterfaceKind, Library, LoadFrom};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::Duration;

/// How long a thread that waits for a copy does not look whether it is to go on waiting.
const PATIENCE: Duration = Duration::from_millis(20);

/// The loaded copies of one library, and what is known about it.
pub(crate) struct CopyStore {
    state: Mutex<State>,
    changed: Condvar,
    /// Owners that wait.
    waiting: AtomicUsize,
    /// What the file says about loading it several times, and unloading it.
    linkage: OnceLock<Linkage>,
    /// The resources before anything was run.
    resources: OnceLock<Snapshot>,
    /// Copies have resources of their own: the model writes into them.
    private_resources: AtomicBool,
    /// What is known about resetting its instances.
    verdicts: [Mutex<Verdict>; 2],
    /// What new instances answer for the variables that were ever set.
    defaults: Mutex<Defaults>,
}

/// One owner that waits.
struct Waiting<'a>(&'a AtomicUsize);

impl<'a> Waiting<'a> {
    fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::SeqCst);
        Self(count)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// What is to be done about a request.
enum Action {
    Use(Arc<LoadedCopy>, u64, Source),
    Make {
        original: bool,
        source: Source,
    },
    /// Ask those who would not miss theirs before a further copy is made.
    Ask(Vec<Option<Weak<dyn CopyOwner>>>),
    Free(Vec<Option<Weak<dyn CopyOwner>>>),
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

    /// Lends a copy that nobody uses, or a new one. Where there are to be no more, takes one from an owner that is between
    /// two simulations, or waits for one that is in a simulation, as long as `wait` (asked every 20 ms) says so; `None`: it
    /// does not any more.
    ///
    /// # Errors
    /// The library cannot be loaded; all copies that there can be are with owners that keep them.
    pub(crate) fn lend(
        self: &Arc<Self>,
        request: &CopyRequest<'_>,
        wait: &mut dyn FnMut() -> bool,
    ) -> Result<Option<CopyLease>, FmiError> {
        let mut asked_pooled = false;
        loop {
            let seen = self.state().changes;
            match self.next_action(request, asked_pooled) {
                Action::Use(copy, id, source) => {
                    return self.make_lease(copy, id, request, &source).map(Some);
                }
                Action::Make { original, source } => {
                    let made = self.make(original, &source, request);
                    self.made(original, request, made)?;
                }
                Action::Ask(holders) => {
                    let mut owners = holders.iter().flatten().filter_map(Weak::upgrade);
                    asked_pooled =
                        !owners.any(|owner| owner.is_in_pool() && owner.release() == Release::Done);
                }
                Action::Free(holders) => {
                    let _waiting = Waiting::new(&self.waiting);
                    let asked = holders.iter().map(|holder| match holder {
                        None => Release::Kept,
                        Some(owner) => owner.upgrade().map_or(Release::Done, |owner| owner.release()),
                    });
                    let asked: Vec<Release> = asked.collect();
                    if asked.contains(&Release::Done) {
                        continue;
                    }
                    if !asked.is_empty() && !asked.contains(&Release::Busy) {
                        return Err(self.nothing_free());
                    }
                    let unchanged = |state: &mut State| state.changes == seen;
                    drop(self.changed.wait_timeout_while(self.state(), PATIENCE, unchanged));
                    if !wait() {
                        return Ok(None);
                    }
                }
            }
        }
    }

    /// A copy that nobody uses and for which `fits` holds, or a new one (for an owner that asks for copies); `None` where there is
    /// none without waiting.
    pub(crate) fn lend_if_free(
        self: &Arc<Self>,
        request: &CopyRequest<'_>,
        fits: impl Fn(&LoadedCopy) -> bool,
    ) -> Option<CopyLease> {
        let mut state = self.state();
        if state.one_at_a_time.is_some() {
            return None;
        }
        let source = state.source.clone()?;
        if let Some(place) = state.idle.iter().rposition(|copy| fits(copy)) {
            let copy = state.idle.remove(place);
            let id = state.note_use(&copy, request);
            drop(state);
            return self.make_lease(copy, id, request, &source).ok();
        }
        if state.refused.is_some() || request.sharing != Sharing::Copies {
            return None;
        }
        state.making += 1;
        drop(state);
        if self.shared_state(&source).is_some() {
            self.state().making -= 1;
            return None;
        }
        let made = self.make(false, &source, request);
        self.made(false, request, made).ok()?;
        let mut state = self.state();
        let place = state.idle.iter().rposition(|copy| fits(copy))?;
        let copy = state.idle.remove(place);
        let id = state.note_use(&copy, request);
        drop(state);
        self.make_lease(copy, id, request, &source).ok()
    }

    fn next_action(&self, request: &CopyRequest<'_>, asked_pooled: bool) -> Action {
        let source = self.state().source.clone();
        // Read from the file before anything of it is run, and before the lock: it takes a while.
        let reason = source.as_ref().and_then(|source| self.shared_state(source)).map(str::to_owned);
        if let Some(source) = &source {
            self.resources.get_or_init(|| Snapshot::of(&source.root.join("resources")));
        }
        let needs_new = reason.is_none() && self.verdict(request.kind).reuse == Some(Reuse::Reload);
        if needs_new {
            self.discard_used();
        }
        let mut state = self.state();
        let Some(source) = source else { return Action::Free(Vec::new()) };
        if let Some(reason) = reason
            && state.one_at_a_time.is_none()
        {
            log::info!("{}: simulations run one at a time: {reason}", source.library.display());
            state.one_at_a_time = Some(reason);
        }
        let all = state.one_at_a_time.is_some() && request.sharing != Sharing::Together;
        let serial = request.sharing == Sharing::Serial;
        let conflicts = |in_use: &&CopyInUse| all || (serial && in_use.sharing == Sharing::Serial);
        let holders = |in_use: &mut dyn Iterator<Item = &CopyInUse>| -> Vec<_> {
            in_use.flat_map(|in_use| in_use.holders.iter().map(|(_, owner)| owner.clone())).collect()
        };
        if request.sharing == Sharing::Together
            && let Some(in_use) = state
                .in_use
                .iter()
                .find(|in_use| in_use.sharing == Sharing::Together && !in_use.copy.is_fatal())
        {
            let copy = Arc::clone(&in_use.copy);
            return Action::Use(Arc::clone(&copy), state.note_use(&copy, request), source);
        }
        let occupied = holders(&mut state.in_use.iter().filter(conflicts));
        if !occupied.is_empty() || (state.making > 0 && (all || (serial && state.making_serial))) {
            return Action::Free(occupied);
        }
        // Somebody may just have given a used one back.
        if let Some(place) = state.idle.iter().rposition(|copy| !needs_new || !copy.is_used()) {
            let copy = state.idle.remove(place);
            let id = state.note_use(&copy, request);
            return Action::Use(copy, id, source);
        }
        let nothing_there = state.in_use.is_empty() && state.making == 0;
        let may_make = !state.original_taken
            || (state.refused.is_none() && state.one_at_a_time.is_none())
            || nothing_there;
        if may_make && state.original_taken && !asked_pooled {
            return Action::Ask(holders(&mut state.in_use.iter()));
        }
        if may_make {
            let original = !std::mem::replace(&mut state.original_taken, true);
            state.making += 1;
            state.making_serial |= serial;
            return Action::Make { original, source };
        }
        let all = holders(&mut state.in_use.iter());
        Action::Free(all)
    }

    /// Gives up the idle copies that were used: their state is not that of a new one.
    fn discard_used(&self) {
        let used: Vec<_> = self.state().idle.extract_if(.., |copy| copy.is_used()).collect();
        let may_unload = !used.is_empty() && self.may_unload();
        used.iter().filter(|_| may_unload).for_each(|copy| copy.unload_when_unused());
    }

    /// Loads the original file, or a copy of it.
    fn make(
        &self,
        original: bool,
        source: &Source,
        request: &CopyRequest<'_>,
    ) -> Result<LoadedCopy, FmiError> {
        if original {
            self.linkage(source).siblings.iter().try_for_each(|sibling| check_length(sibling))?;
            let library = (request.open)(LoadFrom::File(&source.library))?;
            return Ok(LoadedCopy::new(library, request.kind, source.folder_owner.clone()));
        }
        if let Some(reason) = self.shared_state(source) {
            // What is left is unusable.
            return Err(FmiError::NoCopy { library: source.library.clone(), reason: reason.to_owned() });
        }
        let (path, folder) = files::copy(source, self.private_resources.load(Ordering::Relaxed))?;
        let library = (request.open)(LoadFrom::File(&path))?;
        Ok(LoadedCopy::new(library, request.kind, Some(Arc::new(folder))))
    }

    /// Takes in what was made. That no further copy could be made is an error only if there is no other.
    fn made(
        &self,
        original: bool,
        request: &CopyRequest<'_>,
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

    /// Makes the lease of a copy that is lent already.
    fn make_lease(
        self: &Arc<Self>,
        copy: Arc<LoadedCopy>,
        id: u64,
        request: &CopyRequest<'_>,
        source: &Source,
    ) -> Result<CopyLease, FmiError> {
        self.ensure_folder(&copy, source);
        match copy.library(request.kind, request.open) {
            Ok(library) => Ok(CopyLease { store: Arc::clone(self), copy, library, id }),
            Err(error) => {
                self.give_back(&copy, id);
                Err(error)
            }
        }
    }

    /// Makes sure that a copy has its folder, as far as the library could miss it.
    fn ensure_folder(&self, copy: &LoadedCopy, source: &Source) {
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
    fn shared_state(&self, source: &Source) -> Option<&str> {
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

    #[cold]
    fn nothing_free(&self) -> FmiError {
        let state = self.state();
        let library = state.source.as_ref().map(|source| source.library.clone()).unwrap_or_default();
        let why = state.one_at_a_time.clone().or_else(|| state.refused.clone());
        let why = why.unwrap_or_else(|| "simulations were asked to run one at a time".to_owned());
        let reason = format!(
            "it is in use by an instance that was made by hand, or by a simulation that this thread is in or has \
             borrowed a simulator for: drop that one first ({why})"
        );
        FmiError::NoCopy { library, reason }
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

/// A loaded copy lent to one owner, for as long as it has instances; given back on drop, after them.
pub(crate) struct CopyLease {
    store: Arc<CopyStore>,
    library: Arc<Library>,
    /// After the library: a copy that is unloaded takes its folder with it.
    copy: Arc<LoadedCopy>,
    id: u64,
}

impl CopyLease {
    /// The functions of the copy.
    pub(crate) fn library(&self) -> &Arc<Library> {
        &self.library
    }

    /// The copy.
    pub(crate) fn copy(&self) -> &LoadedCopy {
        &self.copy
    }

    /// Gives the copy up for good, where it can be unloaded; else it is kept for others.
    pub(crate) fn retire(self) {
        if self.store.may_unload() {
            self.copy.free_idle();
            self.copy.unload_when_unused();
        }
    }

    /// The copies of this library.
    pub(crate) fn store(&self) -> &Arc<CopyStore> {
        &self.store
    }

    /// Whether a call of this copy has returned `Fatal`.
    #[inline]
    pub(crate) fn is_fatal(&self) -> bool {
        self.library.shared().is_fatal()
    }
}

impl Drop for CopyLease {
    fn drop(&mut self) {
        self.store.give_back(&self.copy, self.id);
    }
}

impl std::fmt::Debug for CopyLease {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CopyLease({})", self.library.path().display())
    }
}
