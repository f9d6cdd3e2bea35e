//! New instances for runs, and old ones reset.

use super::runner::Runner;
use super::verdict::Reuse;
use crate::description::QuirkKind;
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::instance::{Instance, Instantiated};
use crate::sys::{InterfaceKind, RawInstance};

impl Runner {
    /// A new instance; where saved states bring instances back, with the state to bring back.
    pub(crate) fn new_instance(&mut self) -> Result<RawInstance, FmiError> {
        if self.reuse() == Some(Reuse::Restore) {
            return self.new_with_origin();
        }
        self.instantiate()
    }

    /// A new instance, and no other in its copy of the library: an idle one is freed before. Some models can be instantiated only
    /// so often in one loaded copy; then in a new one.
    fn instantiate(&mut self) -> Result<RawInstance, FmiError> {
        let error = match self.instantiate_here() {
            Err(error)
                if self.lease.as_ref().is_some_and(|lease| lease.copy().is_used() && !lease.is_fatal()) =>
            {
                error
            }
            outcome => return outcome,
        };
        let Some(other) = self.new_copy() else { return Err(error) };
        if let Some(lease) = self.lease.replace(other) {
            lease.retire();
        }
        self.prepared = None;
        self.prepare()?;
        // Where that fails, too, it is not because the copy was used.
        let raw = self.instantiate_here().map_err(|_| error)?;
        let message = "a loaded copy of the library can be instantiated only so often: simulations go on in newly loaded ones";
        self.plan.fmu().note_quirk(QuirkKind::Promise, message);
        Ok(raw)
    }

    fn instantiate_here(&self) -> Result<RawInstance, FmiError> {
        if let Some(lease) = &self.lease {
            lease.copy().free_idle();
        }
        self.plan.fmu().instantiate_for_runs(self.library()?, self.plan.kind)
    }

    /// A new instance with its state saved, unless the FMU refuses that: then it is not asked again.
    pub(crate) fn new_with_origin(&mut self) -> Result<RawInstance, FmiError> {
        let mut raw = self.instantiate()?;
        if raw.save_origin().is_err() {
            self.refuse_restore();
            drop(raw);
            return self.instantiate();
        }
        Ok(raw)
    }

    /// Resets an instance, or makes a new one where that fails; and whether it was used before.
    pub(crate) fn reset_or_replace(
        &mut self,
        used: RawInstance,
        reuse: Reuse,
    ) -> Result<(RawInstance, bool), FmiError> {
        if reuse == Reuse::Restore && !used.has_origin() {
            drop(used);
            return Ok((self.new_instance()?, false));
        }
        if let Ok(raw) = reset(used, self.plan.fmu(), reuse) {
            return Ok((raw, true));
        }
        if !self.is_fatal() {
            self.give_up_reuse(reuse, "it fails");
        }
        Ok((self.new_instance()?, false))
    }

    /// A way of bringing instances back was found not to work: the next one is taken from now on, and the quirks say why.
    pub(crate) fn give_up_reuse(&self, reuse: Reuse, reason: &str) {
        let what = match reuse {
            Reuse::Restore => {
                self.refuse_restore();
                "setting a saved state"
            }
            _ => {
                self.set_reuse(Reuse::Reinstantiate);
                let is_fmi1 = self.plan.fmu().description().fmi_version.major < 2;
                if is_fmi1 && self.plan.kind == InterfaceKind::ModelExchange {
                    // FMI 1.0 has a reset function for co-simulation only.
                    return;
                }
                "the reset function"
            }
        };
        let message = format!("{what} does not bring instances back to their start: {reason}");
        self.plan.fmu().note_quirk(QuirkKind::Promise, message);
    }
}

/// Brings an instance with a past back to its beginning, by a saved state or the FMU's reset function.
pub(crate) fn reset(mut raw: RawInstance, fmu: &Fmu, reuse: Reuse) -> Result<RawInstance, FmiError> {
    if reuse != Reuse::Restore {
        return Instance::<Instantiated>::from_raw(raw, fmu.clone()).reset().map(|fresh| fresh.into_raw().0);
    }
    let outcome = raw.restore_origin();
    raw.clear_log();
    let mut instance = Instance::<Instantiated>::from_raw(raw, fmu.clone());
    instance.core().call(|_| outcome)?;
    Ok(instance.into_raw().0)
}
