//! Saved states of an instance: made, brought back, turned into bytes.

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use super::slots::SavedSlot;
use crate::sys::function::call;

impl RawInstance {
    /// Saves the state in a place whose token is gone, or a new one.
    pub(crate) fn save_state(&mut self) -> Result<SavedSlot, Fault> {
        let (index, mut pointer) = self.saved.vacant_slot();
        let outcome = run!(self, |library, c| call!(library.functions.save_state, c, &raw mut pointer));
        self.saved.fill_slot(index, pointer, self.time, outcome)
    }

    /// True if the token was made by this instance.
    pub(crate) fn owns(&self, saved: &SavedSlot) -> bool {
        self.saved.pointer(saved).is_some()
    }

    /// Brings a saved state back. The caller has checked [`owns`](Self::owns); a foreign token is a
    /// `Discard`.
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
    fn places_of_states_that_nobody_holds_are_used_again() {
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
