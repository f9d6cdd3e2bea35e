//! New instances for runs, and reset of the last run's instance.

use super::simulator::Simulator;
use crate::error::FmiError;
use crate::instance::{Instance, Instantiated};
use crate::libraries::Reuse;
use crate::simulation::running::no_instance;
use crate::sys::{InterfaceKind, RawInstance, is_worker};

impl Simulator {
    /// True if an instance is reset after its run and used in the next run.
    fn resets(&self) -> bool {
        let fmu = self.plan.fmu();
        // FMI 1.0 has a reset function only for co-simulation.
        let has_reset =
            fmu.description().fmi_version.major >= 2 || self.plan.kind == InterfaceKind::CoSimulation;
        has_reset && !self.reset_fails && (self.is_resetting || (is_worker() && fmu.reuse() == Reuse::Reset))
    }

    /// Returns a new instance, or the last run's instance after a reset. The flag is true if the instance was
    /// used before.
    pub(super) fn fresh_instance(&mut self) -> Result<(RawInstance, bool), FmiError> {
        self.retire();
        match self.was_reset.take().filter(|_| self.resets()) {
            Some(raw) => Ok((raw, true)),
            None => Ok((self.new_instance()?, false)),
        }
    }

    /// Terminates the last run's instance, and resets it if it will be used again.
    pub(super) fn retire(&mut self) {
        let Some(used) = self.engine.running().retire() else { return };
        if !self.resets() {
            return;
        }
        let instance = Instance::<Instantiated>::from_raw(used, self.plan.fmu().clone());
        match instance.reset() {
            Ok(instance) => self.was_reset = Some(instance.into_raw().0),
            Err(error) => {
                log::debug!(
                    "{}: {error}; each run uses a new instance",
                    self.plan.fmu().description().model_name
                );
                self.reset_fails = true;
            }
        }
    }

    /// Creates a new instance after freeing the last one.
    pub(super) fn new_instance(&mut self) -> Result<RawInstance, FmiError> {
        // Only one instance exists at a time, because the FMU may not support two.
        self.was_reset = None;
        drop(self.engine.running().retire());
        let library = self.library.as_mut().ok_or_else(no_instance)?;
        self.plan.fmu().instantiate_for_runs(library, self.plan.kind, &self.plan.settings)
    }
}
