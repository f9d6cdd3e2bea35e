//! Saved states of an instance: saving and restoring.

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use super::slots::SavedSlot;
use crate::sys::function::call;

impl RawInstance {
    /// Saves the state in a slot whose token was dropped, or in a new slot.
    pub(crate) fn save_state(&mut self) -> Result<SavedSlot, Fault> {
        let (index, mut pointer) = self.saved.vacant_slot();
        let outcome = run!(self, |library, c| call!(library.functions.save_state, c, &raw mut pointer));
        self.saved.fill_slot(index, pointer, self.time, outcome)
    }

    /// True if this instance created the token.
    pub(crate) fn owns(&self, saved: &SavedSlot) -> bool {
        self.saved.pointer(saved).is_some()
    }

    /// Restores a saved state. The caller has checked [`owns`](Self::owns). A token of another instance
    /// results in `Discard`.
    pub(crate) fn restore_state(&mut self, saved: &SavedSlot) -> Outcome {
        let function = self.library.functions.restore_state;
        let pointer = self.saved.pointer(saved).ok_or(Fault::Discard(function.name))?;
        self.time = saved.time;
        self.recover(|raw| run!(raw, |_library, c| call!(function, c, pointer)))
    }
}

#[cfg(test)]
mod tests {
    use crate::{InstanceOptions, sys::InterfaceKind};

    #[test]
    fn slots_of_dropped_states_are_reused() {
        let fmu = crate::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
        let options = InstanceOptions::default();
        let (core, _lease) = fmu.instantiate_by_hand(InterfaceKind::ModelExchange, &options).unwrap();
        let mut raw = core.raw;
        let saved = raw.save_state().unwrap();
        for _ in 0..100 {
            let other = raw.save_state().unwrap();
            assert!(raw.owns(&other));
        }
        raw.restore_state(&saved).unwrap();
        assert_eq!(raw.saved.slots.len(), 2);
    }
}
