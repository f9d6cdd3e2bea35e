//! Saved states of an instance: made, brought back, turned into bytes.

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use super::slots::SavedSlot;
use crate::error::Status;
use crate::sys::call::Call;
use crate::sys::types::StatePointer;

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
        let fmu = crate::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
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
