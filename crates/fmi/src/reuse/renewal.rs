//! New instances for runs, and old ones reset.

use super::Reuse;
use crate::error::FmiError;
use crate::instance;
use crate::simulation::Runner;
use crate::sys::RawInstance;

impl Runner {
    /// A new instance; where saved states bring instances back, with the state to bring back.
    pub(crate) fn new_instance(&self) -> Result<RawInstance, FmiError> {
        if self.reuse() == Some(Reuse::Restore) {
            return self.new_with_origin();
        }
        self.instantiate()
    }

    /// A new instance, and no other in its copy of the library: an idle one is freed before.
    fn instantiate(&self) -> Result<RawInstance, FmiError> {
        if let Some(lease) = &self.lease {
            lease.copy().free_idle();
        }
        self.plan.fmu().instantiate_for_runs(self.library()?, self.plan.kind)
    }

    /// A new instance with its state saved, unless the FMU refuses that: then it is not asked again.
    pub(crate) fn new_with_origin(&self) -> Result<RawInstance, FmiError> {
        let mut raw = self.instantiate()?;
        if raw.save_origin().is_err() {
            self.refuse_restore();
            drop(raw);
            return self.instantiate();
        }
        Ok(raw)
    }

    /// Resets an instance, or makes a new one where that fails; and whether it was used before.
    pub(crate) fn renew_or_replace(
        &self,
        used: RawInstance,
        reuse: Reuse,
    ) -> Result<(RawInstance, bool), FmiError> {
        if reuse == Reuse::Restore && !used.has_origin() {
            drop(used);
            return Ok((self.new_instance()?, false));
        }
        if let Ok(raw) = instance::renew(used, self.plan.fmu(), reuse) {
            return Ok((raw, true));
        }
        match reuse {
            Reuse::Restore => self.refuse_restore(),
            _ => self.set_reuse(Reuse::Reinstantiate),
        }
        Ok((self.new_instance()?, false))
    }
}
