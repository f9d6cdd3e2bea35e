//! Table of the saved states of an instance: the pointers of the FMU. The caller receives only tokens.

use super::fault::{Fault, Outcome};
use crate::sys::function::{Function, call};
use crate::sys::functions::GetState;
use crate::sys::types::{Component, StatePointer};
use std::sync::{Arc, Weak};

/// Token of a saved state in the table of its instance. The slot is in use while the token exists.
#[derive(Debug)]
pub(crate) struct SavedSlot {
    owner: Arc<()>,
    slot: Arc<usize>,
    /// Time set last before the state was saved.
    pub(super) time: Option<f64>,
}

/// Saved states of an instance.
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
    /// Frees all saved states.
    ///
    /// # Safety
    /// The component is alive and created these states.
    pub(super) unsafe fn free(&mut self, function: &Function<GetState>, component: Component) {
        for slot in &mut self.slots {
            if !slot.pointer.is_null() {
                // SAFETY: the caller upholds the requirements; each state is freed once. The status is not
                // needed.
                let _ = call!(function, component, &raw mut slot.pointer);
            }
        }
        self.slots.clear();
    }

    /// True if a saved state is in use, to which the run may be reset.
    pub(super) fn may_be_restored(&self) -> bool {
        self.slots.iter().any(|slot| slot.token.strong_count() > 0)
    }

    /// Returns a slot whose token was dropped, or a new slot, with its pointer.
    pub(super) fn vacant_slot(&mut self) -> (usize, StatePointer) {
        let vacant = self.slots.iter().position(|slot| slot.token.strong_count() == 0);
        let index = vacant.unwrap_or_else(|| {
            self.slots.push(Slot { pointer: StatePointer::NULL, token: Weak::new() });
            self.slots.len() - 1
        });
        (index, self.slots[index].pointer)
    }

    /// Stores the pointer that a call returned for a slot. Returns a token if the call succeeded.
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

    /// Returns the pointer of a token; `None` if the token belongs to another instance.
    pub(super) fn pointer(&self, saved: &SavedSlot) -> Option<StatePointer> {
        if !Arc::ptr_eq(&saved.owner, &self.identity) {
            return None;
        }
        self.slots.get(*saved.slot).map(|slot| slot.pointer)
    }
}
