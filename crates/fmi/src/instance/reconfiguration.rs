//! Reconfiguration: the structural parameters of a running instance, and with them the sizes of its arrays,
//! are changed (FMI 3.0.x, sections 2.3.1 and 2.3.8).

use super::assignments::check_settable_in_reconfiguration;
use super::phases::{CoSimulation, EventMode, Instance, ModelExchange, Reconfiguration, StepMode};
use crate::description::Variable;
use crate::error::{FmiError, Result};
use crate::sys::RawInstance;

/// Enters the mode from whichever it may be entered from.
fn enter<P, K>(mut instance: Instance<P, K>) -> Result<Instance<Reconfiguration, K>> {
    let is_tunable = |v: &Variable| check_settable_in_reconfiguration(v).is_ok();
    if !instance.fmu().description().variables.iter().any(is_tunable) {
        let model = &instance.fmu().description().model_name;
        let problem =
            format!("{model} has no tunable structural parameters: there is nothing to reconfigure");
        return Err(FmiError::BadSetting(problem));
    }
    instance.core().call(RawInstance::enter_configuration)?;
    Ok(instance.into_phase())
}

impl Instance<EventMode, ModelExchange> {
    /// Enters reconfiguration mode, where tunable structural parameters can be set.
    ///
    /// # Errors
    /// The model has none, or refuses; the instance is freed then.
    pub fn enter_reconfiguration(self) -> Result<Instance<Reconfiguration, ModelExchange>> {
        enter(self)
    }
}

impl Instance<Reconfiguration, ModelExchange> {
    /// Goes back to event mode. The vectors of states and indicators have the lengths that follow from the
    /// structural parameters now.
    ///
    /// # Errors
    /// The FMU refuses, or has other sizes than its description promises.
    pub fn exit_reconfiguration(mut self) -> Result<Instance<EventMode, ModelExchange>> {
        self.core().call(RawInstance::exit_configuration)?;
        self.core().check_sizes()?;
        Ok(self.into_phase())
    }
}

impl Instance<StepMode, CoSimulation> {
    /// Enters reconfiguration mode, where tunable structural parameters can be set.
    ///
    /// # Errors
    /// The model has none, or refuses; the instance is freed then.
    pub fn enter_reconfiguration(self) -> Result<Instance<Reconfiguration, CoSimulation>> {
        enter(self)
    }
}

impl Instance<Reconfiguration, CoSimulation> {
    /// Goes back to step mode; arrays have the sizes that follow from the structural parameters now.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn exit_reconfiguration(self) -> Result<Instance<StepMode, CoSimulation>> {
        self.step_to(RawInstance::exit_configuration)
    }
}
