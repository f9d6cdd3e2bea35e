//! Functions of an instance that read and set its clocks.

use super::assignments::resolve;
use super::phases::{Initialization, Instance, Readable};
use super::progress::note;
use crate::description::{Causality, ClockKind, Interval, Variable};
use crate::error::{FmiError, Result};
use crate::sys::Qualifier;

impl<K> Instance<Initialization, K> {
    /// Sets the interval between the ticks of a clock with fixed or tunable intervals.
    ///
    /// # Errors
    /// Returns an error if there is no such clock, or its interval cannot be set to this value. Also returns
    /// an error if the FMU does not support clock intervals, or returns an error.
    pub fn set_clock_interval(&mut self, name: &str, interval: Interval) -> Result<()> {
        let core = self.core();
        let fmu = core.fmu().clone();
        let index = resolve(fmu.description(), name)?;
        let variable = &fmu.description().variables[index];
        check_interval(variable, interval)?;
        core.call(|raw| raw.set_interval(variable.value_reference, interval))?;
        note(&mut core.progress.intervals, index, interval);
        Ok(())
    }
}

impl<P: Readable, K> Instance<P, K> {
    /// Returns the interval before the next tick of a clock as reported by the model, in initialization or
    /// event mode. Returns `None` while a countdown is not running.
    ///
    /// # Errors
    /// Returns an error if there is no such variable, or it is not a clock. Also returns an error if the FMU
    /// does not report intervals, or returns an error.
    pub fn clock_interval(&mut self, name: &str) -> Result<Option<Interval>> {
        let core = self.core();
        let fmu = core.fmu().clone();
        let variable = &fmu.description().variables[resolve(fmu.description(), name)?];
        let Some(timing) = &variable.clock else {
            return Err(FmiError::BadSetting(format!("{name} is not a clock")));
        };
        let (reference, fraction) = (variable.value_reference, timing.supports_fraction);
        let answer = core.call(|raw| raw.get_interval(reference, fraction))?;
        Ok((answer.qualifier != Qualifier::NotYetKnown).then_some(answer.interval))
    }
}

/// Returns an error for intervals that the importer cannot set (FMI 3.0.x, section 2.2.8.3).
pub(crate) fn check_interval(variable: &Variable, interval: Interval) -> Result<()> {
    let name = &variable.name;
    let timing = variable.clock.as_deref().filter(|_| variable.causality == Causality::Input);
    let positive = interval.value() > 0.0 && interval.value().is_finite();
    let problem = match timing {
        Some(timing) if !matches!(timing.kind, ClockKind::Fixed | ClockKind::Tunable) => {
            format!("it has {} intervals; only fixed and tunable intervals can be set", timing.kind.name())
        }
        Some(timing) if matches!(interval, Interval::Fraction(..)) && !timing.supports_fraction => {
            "it does not support fractions".to_owned()
        }
        Some(_) if !positive => format!("{interval:?} is not positive and finite"),
        Some(_) => return Ok(()),
        None => "it is not a clock that the importer activates".to_owned(),
    };
    Err(FmiError::BadSetting(format!("cannot set the interval of {name}: {problem}")))
}
