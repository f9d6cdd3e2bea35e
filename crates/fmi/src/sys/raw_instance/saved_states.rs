//! Saved states of an instance: a table of the FMU's pointers, of which the outside holds tokens only.

use super::{Fault, Outcome, RawInstance};
use crate::sys::{Binding, Call, Component, StatePointer, Status};
use std::sync::{Arc, Weak};

/// Place of a saved state in the table of its instance; alive while its token is.
#[derive(Debug)]
pub(crate) struct SavedSlot {
    owner: Arc<()>,
    slot: Arc<usize>,
}

/// The states an instance has saved.
#[derive(Default)]
pub(super) struct SavedStates {
    slots: Vec<Slot>,
    /// The state it had when it was new, where somebody wants to go back to it.
    origin: Option<SavedSlot>,
    identity: Arc<()>,
}

struct Slot {
    pointer: StatePointer,
    token: Weak<usize>,
}

impl SavedStates {
    /// Frees them all.
    ///
    /// # Safety
    /// The component is alive, and they were made by it.
    pub(super) unsafe fn free(&mut self, binding: &dyn Binding, component: Component) {
        for slot in &mut self.slots {
            if !slot.pointer.is_null() {
                // SAFETY: the caller's promises; each is freed once. The status is of no use.
                let _ = unsafe { binding.free_state(component, &mut slot.pointer) };
            }
        }
        self.slots.clear();
    }

    /// Whether somebody holds a state of a point passed, to which this run may be taken back. The state that the instance
    /// had when it was new begins another run.
    pub(super) fn may_be_restored(&self) -> bool {
        let held = self.slots.iter().filter(|slot| slot.token.strong_count() > 0).count();
        held > usize::from(self.origin.is_some())
    }

    /// A place whose token is gone, or a new one; and the memory that it has.
    fn vacant_slot(&mut self) -> (usize, StatePointer) {
        let vacant = self.slots.iter().position(|slot| slot.token.strong_count() == 0);
        let index = vacant.unwrap_or_else(|| {
            self.slots.push(Slot { pointer: std::ptr::null_mut(), token: Weak::new() });
            self.slots.len() - 1
        });
        (index, self.slots[index].pointer)
    }

    /// Notes what a call left in a place, and gives out a token if it went well.
    fn fill_slot(
        &mut self,
        index: usize,
        pointer: StatePointer,
        outcome: Outcome,
    ) -> Result<SavedSlot, Fault> {
        self.slots[index].pointer = pointer;
        outcome?;
        let slot = Arc::new(index);
        self.slots[index].token = Arc::downgrade(&slot);
        Ok(SavedSlot { owner: Arc::clone(&self.identity), slot })
    }

    /// The pointer behind a token; `None` if the token is of another instance.
    fn pointer(&self, saved: &SavedSlot) -> Option<StatePointer> {
        if !Arc::ptr_eq(&saved.owner, &self.identity) {
            return None;
        }
        self.slots.get(*saved.slot).map(|slot| slot.pointer)
    }
}

impl RawInstance {
    /// Saves the state in a place whose token is gone, or a new one.
    pub(crate) fn save_state(&mut self) -> Result<SavedSlot, Fault> {
        let (index, mut pointer) = self.saved.vacant_slot();
        let outcome = run!(self, Call::SaveState, |b, c| b.save_state(c, &mut pointer));
        self.saved.fill_slot(index, pointer, outcome)
    }

    /// Makes a state of bytes written by [`serialize`](Self::serialize).
    pub(crate) fn deserialize(&mut self, bytes: &[u8]) -> Result<SavedSlot, Fault> {
        let (index, mut pointer) = self.saved.vacant_slot();
        // A new state is made, never one written over: fmi2DeSerializeFMUstate knows no reuse.
        if !pointer.is_null() {
            run!(self, Call::FreeState, |b, c| b.free_state(c, &mut pointer))?;
            pointer = std::ptr::null_mut();
            self.saved.slots[index].pointer = pointer;
        }
        let outcome = run!(self, Call::Deserialize, |b, c| b.deserialize(c, bytes, &mut pointer));
        self.saved.fill_slot(index, pointer, outcome)
    }

    /// Saves the state of a new instance, for [`restore_origin`](Self::restore_origin).
    pub(crate) fn save_origin(&mut self) -> Outcome {
        self.saved.origin = Some(self.save_state()?);
        Ok(())
    }

    /// Whether the state that it had when it was new is saved.
    pub(crate) fn has_origin(&self) -> bool {
        self.saved.origin.is_some()
    }

    /// Brings that state back; without one, a `Discard`.
    pub(crate) fn restore_origin(&mut self) -> Outcome {
        let Some(origin) = self.saved.origin.take() else {
            return Err(Fault::Discard(self.library.binding().name(Call::RestoreState)));
        };
        let outcome = self.restore_state(&origin);
        self.saved.origin = Some(origin);
        outcome
    }

    /// Whether the token was made by this instance.
    pub(crate) fn owns(&self, saved: &SavedSlot) -> bool {
        self.saved.pointer(saved).is_some()
    }

    /// Brings a saved state back. The caller has checked [`owns`](Self::owns); a foreign token is a `Discard`.
    pub(crate) fn restore_state(&mut self, saved: &SavedSlot) -> Outcome {
        let pointer = self.owned(Call::RestoreState, saved)?;
        self.time = None;
        run!(self, Call::RestoreState, |b, c| b.restore_state(c, pointer))
    }

    fn owned(&self, call: Call, saved: &SavedSlot) -> Result<StatePointer, Fault> {
        self.saved.pointer(saved).ok_or(Fault::Discard(self.library.binding().name(call)))
    }

    /// The bytes of a saved state.
    pub(crate) fn serialize(&mut self, saved: &SavedSlot) -> Result<Vec<u8>, Fault> {
        let pointer = self.owned(Call::Serialize, saved)?;
        let mut size = 0;
        run!(self, Call::SerializedSize, |b, c| b.serialized_size(c, pointer, &mut size))?;
        let mut bytes = Vec::new();
        if bytes.try_reserve_exact(size).is_err() {
            return Err(Fault::Failed(Box::new(
                self.failed(self.library.binding().name(Call::SerializedSize), Status::Error),
            )));
        }
        bytes.resize(size, 0);
        run!(self, Call::Serialize, |b, c| b.serialize(c, pointer, &mut bytes))?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use crate::{InstanceOptions, sys::InterfaceKind};

    #[test]
    fn places_of_states_that_nobody_holds_are_used_again() {
        let fmu = crate::Fmu::open(crate::example_fmu("dahlquist").unwrap()).unwrap();
        let options = InstanceOptions::default();
        let (core, _lease) = fmu.instantiate_by_hand(InterfaceKind::ModelExchange, &options).unwrap();
        let mut raw = core.raw;
        let saved = raw.save_state().unwrap();
        let bytes = raw.serialize(&saved).unwrap();
        for _ in 0..100 {
            let read = raw.deserialize(&bytes).unwrap();
            assert!(raw.owns(&read));
            assert_eq!(raw.serialize(&read).unwrap(), bytes);
        }
        drop(saved);
        let again = raw.deserialize(&bytes).unwrap();
        raw.restore_state(&again).unwrap();
        assert_eq!(raw.saved.slots.len(), 2);
    }
}
