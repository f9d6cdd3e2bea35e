//! Which copies of a library are idle, and who has the others.

use super::copies::LoadedCopy;
use super::source::Source;
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::simulation::Sharing;
use crate::sys::{InterfaceKind, Library, LoadFrom};
use std::sync::{Arc, Weak};

/// Idle copies that stay ready: more than a machine has cores, as a rule.
const KEPT_IDLE: usize = 64;

#[derive(Default)]
pub(super) struct State {
    /// FMUs that are open.
    pub(super) users: usize,
    pub(super) source: Option<Source>,
    pub(super) idle: Vec<Arc<LoadedCopy>>,
    pub(super) in_use: Vec<CopyInUse>,
    /// Copies being made; whether one of them is for owners that go one at a time.
    pub(super) making: usize,
    pub(super) making_serial: bool,
    /// The original file is loaded, or being loaded.
    pub(super) original_taken: bool,
    /// Why all owners go one at a time.
    pub(super) one_at_a_time: Option<String>,
    /// Why no further copy could be made.
    pub(super) refused: Option<String>,
    /// Copies in use then.
    pub(super) n_refused: usize,
    pub(super) last_lease: u64,
    /// Counts what a waiting owner waits for.
    pub(super) changes: u64,
}

/// A copy in use.
pub(super) struct CopyInUse {
    pub(super) copy: Arc<LoadedCopy>,
    pub(super) sharing: Sharing,
    pub(super) holders: Vec<(u64, Option<Weak<dyn CopyOwner>>)>,
}

impl State {
    /// An idle copy beyond those that are kept ready, which still has its folder.
    pub(super) fn surplus(&self) -> Option<Arc<LoadedCopy>> {
        if self.idle.len() <= KEPT_IDLE {
            return None;
        }
        self.idle.iter().find(|copy| copy.folder_owner().is_some()).cloned()
    }

    /// Notes a holder of a copy.
    pub(super) fn note_use(&mut self, copy: &Arc<LoadedCopy>, request: &CopyRequest) -> u64 {
        self.last_lease += 1;
        let holder = (self.last_lease, request.owner.clone());
        match self.in_use.iter_mut().find(|in_use| Arc::ptr_eq(&in_use.copy, copy)) {
            Some(in_use) => in_use.holders.push(holder),
            None => self.in_use.push(CopyInUse {
                copy: Arc::clone(copy),
                sharing: request.sharing,
                holders: vec![holder],
            }),
        }
        self.last_lease
    }
}

/// An owner that can be asked to give its copy up between two of its calls.
pub(crate) trait CopyOwner: Send + Sync {
    /// Gives the copy up, if no call is under way.
    fn release(&self) -> Release;

    /// Whether nothing is lost when it does: it is a simulator that lies in a pool.
    fn is_in_pool(&self) -> bool;
}

/// What became of a request to give a copy up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Release {
    /// It was given up, or is just being given up.
    Done,
    /// A simulation is under way; it will end.
    Busy,
    /// The owner keeps it, and waiting for that would be in vain: it is this very thread, or an instance made by hand.
    Kept,
}

/// Who wants a copy, and how.
pub(crate) struct CopyRequest {
    pub(crate) fmu: Fmu,
    pub(crate) kind: InterfaceKind,
    pub(crate) sharing: Sharing,
    /// `None`: the owner does not give it up.
    pub(crate) owner: Option<Weak<dyn CopyOwner>>,
}

impl CopyRequest {
    /// Of an owner that does not give its copy up.
    pub(crate) fn for_good(fmu: &Fmu, kind: InterfaceKind) -> Self {
        Self { fmu: fmu.clone(), kind, sharing: Sharing::Copies, owner: None }
    }

    /// Loads the library.
    pub(super) fn load(&self, from: LoadFrom<'_>) -> Result<Library, FmiError> {
        self.fmu.load(from, self.kind)
    }
}
