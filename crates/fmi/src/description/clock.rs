//! Timing of clocks as specified in the description (FMI 3.0.x, section 2.2.8.3).

use crate::macros::words;
use serde::{Deserialize, Serialize};

/// Timing of a clock from the model description.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ClockTiming {
    /// Source of the intervals between ticks.
    pub kind: ClockKind,
    /// The importer may omit ticks.
    pub can_be_deactivated: bool,
    /// The model reports intervals also as fractions.
    pub supports_fraction: bool,
    /// Interval between ticks in units of time, if the description specifies one.
    pub interval: Option<Interval>,
    /// Time from the start to the first tick.
    pub shift: Interval,
}

words! {
    /// Source of the intervals between the ticks of a clock.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum ClockKind {
        /// The description: periodic with a constant interval.
        Constant = "constant",
        /// Periodic with an interval that is known after the initialization.
        Fixed = "fixed",
        /// Periodic with an interval that depends on tunable parameters.
        Tunable = "tunable",
        /// The model, which reports the next interval at each tick.
        Changing = "changing",
        /// The model, which reports the time to the next tick at any event.
        Countdown = "countdown",
        /// Ticks are not known in advance. The importer triggers the clock, or the model does if the clock is
        /// not an input.
        Triggered = "triggered",
    }
}

/// Time span: a decimal number or an exact fraction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Interval {
    /// Number in units of time.
    Decimal(f64),
    /// Counter and resolution. Their quotient is the time span in units of time.
    Fraction(u64, u64),
}

impl Interval {
    /// Returns the nearest floating-point number.
    pub fn value(self) -> f64 {
        match self {
            Interval::Decimal(value) => value,
            Interval::Fraction(counter, resolution) => counter as f64 / resolution as f64,
        }
    }
}
