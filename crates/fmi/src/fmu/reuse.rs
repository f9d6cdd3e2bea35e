//! Instances used again: those that nobody uses at present, and what is known about bringing them back to their beginning
//! and about several of them in one process.

use super::Fmu;
use crate::options::Kind;
use crate::plan::Setting;
use crate::sys::{InterfaceKind, RawInstance, Shared, Spares};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Instances kept for later, per FMU.
const MAX_IDLE: usize = 4;

/// Whether all of `set` is among `settings`; both are sorted.
fn are_covered(set: &[Setting], settings: &[Setting]) -> bool {
    set.iter().all(|one| settings.binary_search(one).is_ok())
}

/// Instances that nobody uses at present, each with everything that was ever set in it. Resetting may leave what was set
/// (the first-use test does not see variables that its plan does not set), so an instance goes only to plans that set all
/// of it again.
#[derive(Debug, Default)]
pub(super) struct Idle(Mutex<Vec<(RawInstance, Arc<[Setting]>)>>);

impl Idle {
    fn lock(&self) -> MutexGuard<'_, Vec<(RawInstance, Arc<[Setting]>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Spares for Idle {
    fn free_all(&self) {
        let idle = std::mem::take(&mut *self.lock());
        drop(idle);
    }
}

/// How the instances of an FMU are brought back to their beginning between simulations: the first of these ways that was
/// seen to be right. Right means that runs have the same bits as on a new instance, also after a run with other values;
/// which way is faster is never asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Reuse {
    /// By bringing back the state saved when the instance was new (model exchange, FMUs that can save states): it was seen to restore
    /// everything, bit for bit. All values are set again afterwards, and read back.
    Restore,
    /// By the FMU's reset function: it was seen to restore everything, bit for bit.
    Reset,
    /// By a new instance for every simulation: nothing else is offered, or it fails, or it leaves traces.
    Reinstantiate,
}

/// How several simulations of an FMU share a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Sharing {
    /// At the same time, with instances of one library: these were seen to leave each other alone.
    Together,
    /// At the same time, each with a copy of the library of its own, because instances of one library disturb each other
    /// or the FMU allows only one of them in a process. Every copy is a file of its own with globals of its own, and was
    /// seen to give the same bits; the files beside the library and the resources are linked along. Shared remain the
    /// libraries that it depends on and what the linker has marked as unique in the process: if that matters, the trial
    /// runs see it, and simulations run [one at a time](Self::OneAtATime). There are as many copies as simulators in use
    /// at once (and three for the trial runs), at most 64 in a process, for they are never unloaded and static
    /// thread-local storage is small. Where no further copy can be made, simulations take turns with the library itself.
    PrivateCopies,
    /// One after the other, each waiting for its turn: instances disturb each other, also those of private copies, or they
    /// write into the resources that all of them share.
    OneAtATime,
}

// Verdicts as the library stores them; 0: none.
const RESTORE: u8 = 1;
const RESET: u8 = 2;
const REINSTANTIATE: u8 = 3;

impl Fmu {
    /// How several simulations share the process; `None` before it was tried (by a [`Pool`](crate::Pool)).
    pub fn sharing_of(&self, kind: InterfaceKind) -> Option<Sharing> {
        let shared = self.shared(kind)?;
        match (shared.is_dependent(), shared.copies_work()) {
            (true, Some(true)) => Some(Sharing::PrivateCopies),
            (true, _) => Some(Sharing::OneAtATime),
            (false, _) if shared.is_reentrant() => Some(Sharing::Together),
            _ => None,
        }
    }

    /// An instance that was used before, in which nothing was set but what `settings` set again; to be reset before use.
    pub(crate) fn take_idle(&self, kind: InterfaceKind, settings: &[Setting]) -> Option<RawInstance> {
        let mut idle = self.side(kind).idle.lock();
        let place = idle.iter().rposition(|(_, set)| are_covered(set, settings))?;
        Some(idle.remove(place).0)
    }

    /// Keeps an instance, in which `settings` were set, for later; frees another one if there are many.
    pub(crate) fn put_idle(&self, kind: InterfaceKind, raw: RawInstance, settings: &Arc<[Setting]>) {
        if raw.is_dead() || raw.is_stale() {
            return;
        }
        let surplus = {
            let mut idle = self.side(kind).idle.lock();
            idle.push((raw, Arc::clone(settings)));
            (idle.len() > MAX_IDLE).then(|| idle.remove(0))
        };
        drop(surplus);
    }

    /// Frees the idle instances.
    pub(crate) fn drop_idle(&self, kind: InterfaceKind) {
        self.side(kind).idle.free_all();
    }

    /// What all users of the library share; `None` before it is loaded.
    pub(crate) fn shared(&self, kind: InterfaceKind) -> Option<Arc<Shared>> {
        let slot = self.side(kind).library.lock().unwrap_or_else(PoisonError::into_inner);
        slot.as_ref().map(|library| Arc::clone(library.shared()))
    }

    /// How instances are brought back to their beginning, for the interface that is used where nothing else is asked for;
    /// `None` before it was tried.
    pub fn reuse(&self) -> Option<Reuse> {
        self.choose(Kind::Auto).ok().and_then(|kind| self.reuse_of(kind))
    }

    /// How instances are brought back to their beginning; `None` before it was tried.
    pub fn reuse_of(&self, kind: InterfaceKind) -> Option<Reuse> {
        match self.shared(kind)?.reuse(kind) {
            RESTORE => Some(Reuse::Restore),
            RESET => Some(Reuse::Reset),
            REINSTANTIATE => Some(Reuse::Reinstantiate),
            _ => None,
        }
    }

    /// The same for plans that set `settings`; `None` before it was tried with all or some of these.
    pub(crate) fn reuse_for(&self, kind: InterfaceKind, settings: &[Setting]) -> Option<Reuse> {
        let reuse = self.reuse_of(kind)?;
        let proven = self.proven(kind);
        let is_proven = || proven.iter().any(|(way, set)| *way == reuse && are_covered(set, settings));
        (reuse == Reuse::Reinstantiate || is_proven()).then_some(reuse)
    }

    fn proven(&self, kind: InterfaceKind) -> MutexGuard<'_, Vec<(Reuse, Arc<[Setting]>)>> {
        self.side(kind).proven.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stores what trial runs of a plan that sets `settings` have shown.
    pub(crate) fn set_reuse(&self, kind: InterfaceKind, reuse: Reuse, settings: &Arc<[Setting]>) {
        if let Some(shared) = self.shared(kind) {
            // Once found out, a broken reset stays broken.
            let verdict = match reuse {
                Reuse::Restore if shared.is_restore_refused(kind) => return,
                Reuse::Restore => RESTORE,
                Reuse::Reset => RESET,
                Reuse::Reinstantiate => REINSTANTIATE,
            };
            shared.worsen_reuse(kind, verdict);
        }
        if reuse == Reuse::Reinstantiate {
            return self.drop_idle(kind);
        }
        let mut proven = self.proven(kind);
        // What was shown while more was set is shown by this, too.
        proven.retain(|(way, set)| *way != reuse || !are_covered(settings, set));
        proven.push((reuse, Arc::clone(settings)));
    }

    /// Whether instances may be brought back by a saved state, as far as is known. Not in co-simulation: some models abort
    /// the process when they are initialized after it (seen in Dymola's, whose solver is no part of the state), and reset
    /// is as fast.
    pub(crate) fn may_restore(&self, kind: InterfaceKind) -> bool {
        kind == InterfaceKind::ModelExchange
            && self.interface(kind).is_some_and(|interface| interface.capabilities.can_get_and_set_state)
            && self.shared(kind).is_none_or(|shared| !shared.is_restore_refused(kind))
    }

    /// Saved states were found not to bring instances back.
    pub(crate) fn refuse_restore(&self, kind: InterfaceKind) {
        if let Some(shared) = self.shared(kind) {
            shared.refuse_restore(kind, RESTORE);
        }
    }
}
