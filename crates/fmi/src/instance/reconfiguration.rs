//! Reconfiguration: changes the structural parameters of a running instance, which determine its array sizes
//! (FMI 3.0.x, sections 2.3.1 and 2.3.8).

use super::assignments::check_settable_in_reconfiguration;
use super::phases::{CoSimulation, EventMode, Instance, ModelExchange, Reconfiguration, StepMode};
use crate::description::Variable;
use crate::error::{FmiError, Result};
use crate::sys::RawInstance;

/// Enters reconfiguration mode from any phase that permits it.
fn enter<P, K>(mut instance: Instance<P, K>) -> Result<Instance<Reconfiguration, K>> {
    let is_tunable = |v: &Variable| check_settable_in_reconfiguration(v).is_ok();
    if !instance.fmu().description().variables.iter().any(is_tunable) {
        let model = &instance.fmu().description().model_name;
        let problem = format!("{model} has no tunable structural parameters to reconfigure");
        return Err(FmiError::BadSetting(problem));
    }
    instance.core().call(RawInstance::enter_configuration)?;
    Ok(instance.into_phase())
}

impl Instance<EventMode, ModelExchange> {
    /// Enters reconfiguration mode, in which tunable structural parameters can be set.
    ///
    /// # Errors
    /// Returns an error if the model has no tunable structural parameters, or returns an error. The instance
    /// is then freed.
    pub fn enter_reconfiguration(self) -> Result<Instance<Reconfiguration, ModelExchange>> {
        enter(self)
    }
}

impl Instance<Reconfiguration, ModelExchange> {
    /// Returns to event mode. The lengths of the state and indicator vectors now follow from the structural
    /// parameters.
    ///
    /// # Errors
    /// Returns an error if the FMU returns an error, or its sizes differ from those in the description.
    pub fn exit_reconfiguration(mut self) -> Result<Instance<EventMode, ModelExchange>> {
        self.core().call(RawInstance::exit_configuration)?;
        self.core().check_sizes()?;
        Ok(self.into_phase())
    }
}

impl Instance<StepMode, CoSimulation> {
    /// Enters reconfiguration mode, in which tunable structural parameters can be set.
    ///
    /// # Errors
    /// Returns an error if the model has no tunable structural parameters, or returns an error. The instance
    /// is then freed.
    pub fn enter_reconfiguration(self) -> Result<Instance<Reconfiguration, CoSimulation>> {
        enter(self)
    }
}

impl Instance<Reconfiguration, CoSimulation> {
    /// Returns to step mode. The array sizes now follow from the structural parameters.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn exit_reconfiguration(self) -> Result<Instance<StepMode, CoSimulation>> {
        self.step_to(RawInstance::exit_configuration)
    }
}
