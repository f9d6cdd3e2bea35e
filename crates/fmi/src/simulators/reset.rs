//! New instances for runs, and old ones brought back to their start.

use super::simulator::Simulator;
use crate::description::QuirkKind;
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::instance::{Instance, Instantiated};
use crate::libraries::Reuse;
use crate::simulation::running::no_instance;
use crate::sys::{InterfaceKind, RawInstance};

impl Simulator {
    /// A new instance, or the last run's, brought back in a way that is known to be right; and whether it was
    /// used before.
    pub(super) fn fresh_instance(&mut self) -> Result<(RawInstance, bool), FmiError> {
        self.bring_back();
        match self.brought_back.take() {
            // Another simulator may have found out that this is no way.
            Some((raw, reuse)) if self.reuse() == Some(reuse) => Ok((raw, true)),
            _ => Ok((self.new_instance()?, false)),
        }
    }

    /// Ends the last run's instance; keeps it, brought back to its start, where a way is known to be right.
    pub(super) fn bring_back(&mut self) {
        let Some(used) = self.engine.running().retire() else { return };
        let Some(reuse) = self.reuse().filter(|reuse| *reuse < Reuse::Reinstantiate) else { return };
        // Made when nobody thought of bringing it back.
        if reuse == Reuse::Restore && !used.has_origin() {
            return;
        }
        match reset(used, self.plan.fmu(), reuse) {
            Ok(raw) => self.brought_back = Some((raw, reuse)),
            Err(_) if !self.is_fatal() => self.give_up_reuse(reuse, "it fails"),
            Err(_) => {}
        }
    }

    /// A new instance, after the last one; where saved states bring instances back, with the state to bring
    /// back.
    pub(super) fn new_instance(&mut self) -> Result<RawInstance, FmiError> {
        self.new_instance_for(self.reuse())
    }

    /// A new instance, after the last one, which can be brought back in this way.
    pub(super) fn new_instance_for(&mut self, reuse: Option<Reuse>) -> Result<RawInstance, FmiError> {
        // One at a time: the FMU may not allow two.
        self.brought_back = None;
        drop(self.engine.running().retire());
        let mut raw = self.instantiate()?;
        if reuse == Some(Reuse::Restore) && raw.save_origin().is_err() {
            self.plan.fmu().reset_knowledge(self.plan.kind).no_restore = true;
            drop(raw);
            raw = self.instantiate()?;
        }
        Ok(raw)
    }

    fn instantiate(&mut self) -> Result<RawInstance, FmiError> {
        let library = self.library.as_mut().ok_or_else(no_instance)?;
        self.plan.fmu().instantiate_for_runs(library, self.plan.kind, &self.plan.settings)
    }

    /// True if instances may be reset by a saved state, as far as is known. Not in co-simulation: some models
    /// abort the process when they are initialized after it (seen in Dymola's, whose solver is no part of the
    /// state), and reset is as fast.
    pub(super) fn may_restore(&self) -> bool {
        let (fmu, kind) = (self.plan.fmu(), self.plan.kind);
        kind == InterfaceKind::ModelExchange
            && fmu.interface(kind).is_some_and(|interface| interface.capabilities.can_get_and_set_state)
            && !fmu.reset_knowledge(kind).no_restore
    }

    /// A way of bringing instances back was found not to work: the next one is taken from now on, and the
    /// quirks say why.
    pub(super) fn give_up_reuse(&mut self, reuse: Reuse, reason: &str) {
        let (fmu, kind) = (self.plan.fmu(), self.plan.kind);
        let (what, instead) = match reuse {
            Reuse::Restore => {
                fmu.reset_knowledge(kind).no_restore = true;
                ("setting a saved state", "they are reset by its function")
            }
            _ => {
                fmu.reset_knowledge(kind).note(Reuse::Reinstantiate);
                if fmu.description().fmi_version.major < 2 && kind == InterfaceKind::ModelExchange {
                    // FMI 1.0 has a reset function for co-simulation only.
                    return;
                }
                ("the reset function", "each has a new instance, which takes longer")
            }
        };
        let message = format!(
            "{what} does not bring instances back to their start: {reason}. Nothing is to be done: simulations are right, {instead}"
        );
        fmu.note_quirk(QuirkKind::Promise, message);
    }
}

/// Brings an instance with a past back to its beginning, by a saved state or the FMU's reset function.
pub(super) fn reset(mut raw: RawInstance, fmu: &Fmu, reuse: Reuse) -> Result<RawInstance, FmiError> {
    if reuse != Reuse::Restore {
        return Instance::<Instantiated>::from_raw(raw, fmu.clone()).reset().map(|fresh| fresh.into_raw().0);
    }
    let outcome = raw.restore_origin();
    raw.clear_log();
    let mut instance = Instance::<Instantiated>::from_raw(raw, fmu.clone());
    instance.core().call(|_| outcome)?;
    Ok(instance.into_raw().0)
}
