//! Lending the loaded copies of a library: one that is idle, a new one, or one that another owner gives up.

use super::copies::LoadedCopy;
use super::copy_use::{CopyInUse, CopyOwner, CopyRequest, Release, State};
use super::source::Source;
use super::store::CopyStore;
use super::verdict::Reuse;
use crate::archive::Snapshot;
use crate::error::FmiError;
use crate::simulation::Sharing;
use crate::sys::Library;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How long a thread that waits for a copy does not look whether it is to go on waiting.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

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
    /// Lends a copy that nobody uses, or a new one. Where there are to be no more, takes one from an owner that is between
    /// two simulations, or waits for one that is in a simulation, as long as `wait` (asked every 20 ms) says so; `None`: it
    /// does not any more.
    ///
    /// # Errors
    /// The library cannot be loaded; all copies that there can be are with owners that keep them.
    pub(crate) fn lend(
        self: &Arc<Self>,
        request: &CopyRequest,
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
                    drop(self.changed.wait_timeout_while(self.state(), POLL_INTERVAL, unchanged));
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
        request: &CopyRequest,
        fits: impl Fn(&LoadedCopy) -> bool,
    ) -> Option<CopyLease> {
        let source = {
            let state = self.state();
            if state.one_at_a_time.is_some() {
                return None;
            }
            state.source.clone()?
        };
        if let Some(lease) = self.lend_idle(request, &source, &fits) {
            return Some(lease);
        }
        if self.state().refused.is_some()
            || request.sharing != Sharing::Copies
            || self.shared_state(&source).is_some()
        {
            return None;
        }
        self.state().making += 1;
        let made = self.make(false, &source, request);
        self.made(false, request, made).ok()?;
        self.lend_idle(request, &source, &fits)
    }

    /// An idle copy for which `fits` holds.
    fn lend_idle(
        self: &Arc<Self>,
        request: &CopyRequest,
        source: &Source,
        fits: &impl Fn(&LoadedCopy) -> bool,
    ) -> Option<CopyLease> {
        let mut state = self.state();
        let place = state.idle.iter().rposition(|copy| fits(copy))?;
        let copy = state.idle.remove(place);
        let id = state.note_use(&copy, request);
        drop(state);
        self.make_lease(copy, id, request, source).ok()
    }

    fn next_action(&self, request: &CopyRequest, asked_pooled: bool) -> Action {
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

    /// Makes the lease of a copy that is lent already.
    fn make_lease(
        self: &Arc<Self>,
        copy: Arc<LoadedCopy>,
        id: u64,
        request: &CopyRequest,
        source: &Source,
    ) -> Result<CopyLease, FmiError> {
        self.ensure_folder(&copy, source);
        match copy.library(request.kind, |from| request.load(from)) {
            Ok(library) => Ok(CopyLease { store: Arc::clone(self), copy, library, id }),
            Err(error) => {
                self.give_back(&copy, id);
                Err(error)
            }
        }
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
