//! What can be done with the clocks of an instance by hand.

use super::plan::check_interval;
use crate::assign::resolve;
use crate::description::Interval;
use crate::error::FmiError;
use crate::instance::{EventMode, Initialization, Instance, Readable};
use crate::sys::{Qualifier, RawInstance};

impl<K> Instance<Initialization, K> {
    /// Gives a clock with fixed or tunable intervals the interval between its ticks.
    ///
    /// # Errors
    /// There is no such clock, or it cannot be given this interval; the FMU cannot, or refuses.
    pub fn set_clock_interval(&mut self, name: &str, interval: Interval) -> Result<(), FmiError> {
        let core = self.core();
        let fmu = core.fmu().clone();
        let variable = &fmu.description().variables[resolve(fmu.description(), name)?];
        check_interval(variable, interval)?;
        core.call(|raw| raw.set_interval(variable.value_reference, interval))
    }
}

impl Instance<EventMode> {
    /// Computes what the discrete states would be with the inputs as they are, without updating them: for importers that
    /// look for inputs between models that depend on each other (FMI 3.0). A simulation of one model never needs it.
    ///
    /// # Errors
    /// The FMU cannot, or refuses.
    pub fn evaluate_discrete_states(&mut self) -> Result<(), FmiError> {
        self.core().call(RawInstance::evaluate_discrete_states)
    }
}

impl<P: Readable, K> Instance<P, K> {
    /// What the model says about the interval before the next tick of a clock, in initialization or event mode; `None`
    /// while a countdown does not run.
    ///
    /// # Errors
    /// There is no such variable or it is no clock; the FMU cannot tell, or refuses.
    pub fn clock_interval(&mut self, name: &str) -> Result<Option<Interval>, FmiError> {
        let core = self.core();
        let fmu = core.fmu().clone();
        let variable = &fmu.description().variables[resolve(fmu.description(), name)?];
        let Some(timing) = &variable.clock else {
            return Err(FmiError::BadSetting { problem: format!("{name} is no clock") });
        };
        let (reference, fraction) = (variable.value_reference, timing.supports_fraction);
        let answer = core.call(|raw| raw.get_interval(reference, fraction))?;
        Ok((answer.qualifier != Qualifier::NotYetKnown).then_some(answer.interval))
    }
}
