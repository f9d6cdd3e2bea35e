//! Which copies of a library are idle, and who has the others.

use super::copies::LoadedCopy;
use super::source::Source;
use super::tenant::{CopyRequest, Tenant};
use crate::simulation::Sharing;
use std::sync::{Arc, Weak};

/// Idle copies that stay ready: more than a machine has cores, as a rule.
const KEPT_IDLE: usize = 64;

#[derive(Default)]
pub(super) struct State {
    /// FMUs that are open.
    pub(super) users: usize,
    pub(super) source: Option<Source>,
    pub(super) idle: Vec<Arc<LoadedCopy>>,
    pub(super) loans: Vec<Loan>,
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
pub(super) struct Loan {
    pub(super) copy: Arc<LoadedCopy>,
    pub(super) sharing: Sharing,
    pub(super) holders: Vec<(u64, Option<Weak<dyn Tenant>>)>,
}

impl State {
    /// An idle copy beyond those that are kept ready, which still has its folder.
    pub(super) fn surplus(&self) -> Option<Arc<LoadedCopy>> {
        if self.idle.len() <= KEPT_IDLE {
            return None;
        }
        self.idle.iter().find(|copy| copy.home().is_some()).cloned()
    }

    /// Notes a holder of a copy.
    pub(super) fn loan(&mut self, copy: &Arc<LoadedCopy>, request: &CopyRequest<'_>) -> u64 {
        self.last_lease += 1;
        let holder = (self.last_lease, request.tenant.clone());
        match self.loans.iter_mut().find(|loan| Arc::ptr_eq(&loan.copy, copy)) {
            Some(loan) => loan.holders.push(holder),
            None => self.loans.push(Loan {
                copy: Arc::clone(copy),
                sharing: request.sharing,
                holders: vec![holder],
            }),
        }
        self.last_lease
    }
}
