//! Intervals and shifts of clocks (FMI 3.0.x, section 2.2.8.3).

use super::component::RawInstance;
use super::fault::{Fault, Outcome};
use crate::description::Interval;
use crate::sys::function::call;
use crate::sys::types::{IntervalAnswer, Qualifier};

impl RawInstance {
    /// Returns the interval until the next tick of a clock as reported by the model, as a fraction or a
    /// decimal number.
    pub(crate) fn get_interval(&mut self, clock: u32, fraction: bool) -> Result<IntervalAnswer, Fault> {
        let (clock, mut qualifier) = (&raw const clock, 0);
        let (mut interval, mut counter, mut resolution) = (0.0, 0, 0);
        let interval = if fraction {
            run!(self, |library, c| {
                let (function, fraction) =
                    (&library.functions.interval_fraction, (&raw mut counter, &raw mut resolution));
                call!(function, c, clock, 1, fraction.0, fraction.1, &raw mut qualifier)
            })?;
            Interval::Fraction(counter, resolution)
        } else {
            run!(self, |library, c| {
                let function = &library.functions.interval_decimal;
                call!(function, c, clock, 1, &raw mut interval, &raw mut qualifier)
            })?;
            Interval::Decimal(interval)
        };
        let qualifier = match qualifier {
            1 => Qualifier::Unchanged,
            2 => Qualifier::Changed,
            _ => Qualifier::NotYetKnown,
        };
        Ok(IntervalAnswer { qualifier, interval })
    }

    /// Sets the interval of a clock.
    pub(crate) fn set_interval(&mut self, clock: u32, interval: Interval) -> Outcome {
        let clock = &raw const clock;
        run!(self, |library, c| match interval {
            Interval::Decimal(value) => {
                call!(library.functions.set_interval_decimal, c, clock, 1, &raw const value)
            }
            Interval::Fraction(counter, resolution) => {
                let (counter, resolution) = (&raw const counter, &raw const resolution);
                call!(library.functions.set_interval_fraction, c, clock, 1, counter, resolution)
            }
        })
    }

    /// Returns the time from the start to the first tick of a clock, as a fraction or a decimal number.
    pub(crate) fn get_shift(&mut self, clock: u32, fraction: bool) -> Result<Interval, Fault> {
        let clock = &raw const clock;
        let (mut shift, mut counter, mut resolution) = (0.0, 0, 0);
        run!(self, |library, c| {
            let functions = &library.functions;
            if fraction {
                call!(functions.shift_fraction, c, clock, 1, &raw mut counter, &raw mut resolution)
            } else {
                call!(functions.shift_decimal, c, clock, 1, &raw mut shift)
            }
        })?;
        Ok(if fraction { Interval::Fraction(counter, resolution) } else { Interval::Decimal(shift) })
    }
}
