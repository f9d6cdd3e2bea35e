//! The table of the states that an instance has saved: the FMU's pointers, of which the outside holds tokens
//! only.

use super::fault::{Fault, Outcome};
use crate::sys::function::{Function, call};
use crate::sys::functions::GetState;
use crate::sys::types::{Component, StatePointer};
use std::sync::{Arc, Weak};

/// Place of a saved state in the table of its instance; alive while its token is.
#[derive(Debug)]
pub(crate) struct SavedSlot {
    owner: Arc<()>,
    slot: Arc<usize>,
    /// The time last set when it was saved.
    pub(super) time: Option<f64>,
}

/// The states an instance has saved.
#[derive(Default)]
pub(super) struct SavedStates {
    pub(super) slots: Vec<Slot>,
    identity: Arc<()>,
}

pub(super) struct Slot {
    pub(super) pointer: StatePointer,
    pub(super) token: Weak<usize>,
}

impl SavedStates {
    /// Frees them all.
    ///
    /// # Safety
    /// The component is alive, and they were made by it.
    pub(super) unsafe fn free(&mut self, function: &Function<GetState>, component: Component) {
        for slot in &mut self.slots {
            if !slot.pointer.is_null() {
                // SAFETY: the caller's promises; each is freed once. The status is of no use.
                let _ = call!(function, component, &raw mut slot.pointer);
            }
        }
        self.slots.clear();
    }

    /// True if a saved state is held, to which the run may be set back.
    pub(super) fn may_be_restored(&self) -> bool {
        self.slots.iter().any(|slot| slot.token.strong_count() > 0)
    }

    /// A place whose token is gone, or a new one; and the memory that it has.
    pub(super) fn vacant_slot(&mut self) -> (usize, StatePointer) {
        let vacant = self.slots.iter().position(|slot| slot.token.strong_count() == 0);
        let index = vacant.unwrap_or_else(|| {
            self.slots.push(Slot { pointer: StatePointer::NULL, token: Weak::new() });
            self.slots.len() - 1
        });
        (index, self.slots[index].pointer)
    }

    /// Notes what a call left in a place, and gives out a token if it went well.
    pub(super) fn fill_slot(
        &mut self,
        index: usize,
        pointer: StatePointer,
        time: Option<f64>,
        outcome: Outcome,
    ) -> Result<SavedSlot, Fault> {
        self.slots[index].pointer = pointer;
        outcome?;
        let slot = Arc::new(index);
        self.slots[index].token = Arc::downgrade(&slot);
        Ok(SavedSlot { owner: Arc::clone(&self.identity), slot, time })
    }

    /// The pointer behind a token; `None` if the token is of another instance.
    pub(super) fn pointer(&self, saved: &SavedSlot) -> Option<StatePointer> {
        if !Arc::ptr_eq(&saved.owner, &self.identity) {
            return None;
        }
        self.slots.get(*saved.slot).map(|slot| slot.pointer)
    }
}
