//! When clocks tick, as far as the description says it (FMI 3.0.x, section 2.2.8.3).

use crate::macros::words;
use serde::{Deserialize, Serialize};

/// Timing of a clock, from the model description.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ClockTiming {
    /// Who knows the intervals between ticks, and when.
    pub kind: ClockKind,
    /// The importer may leave ticks out.
    pub can_be_deactivated: bool,
    /// Intervals can be asked for as fractions.
    pub supports_fraction: bool,
    /// Interval between ticks in units of time, where the description gives one.
    pub interval: Option<Interval>,
    /// From the start to the first tick.
    pub shift: Interval,
}

words! {
    /// Who knows the intervals between the ticks of a clock, and when.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    #[non_exhaustive]
    pub enum ClockKind {
        /// The description: periodic, always with the same interval.
        Constant = "constant",
        /// Periodic with an interval that is known after the initialization.
        Fixed = "fixed",
        /// Periodic with an interval that tunable parameters can change.
        Tunable = "tunable",
        /// The model, at each tick, for the next one.
        Changing = "changing",
        /// The model, at any event, some time before the tick.
        Countdown = "countdown",
        /// Nobody beforehand: the importer triggers it, or, if it is no input, the model.
        Triggered = "triggered",
    }
}

/// A span of time: a number, or a fraction that no number may be able to hold.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Interval {
    /// In units of time.
    Decimal(f64),
    /// Counter and resolution: their quotient in units of time.
    Fraction(u64, u64),
}

impl Interval {
    /// The nearest number.
    pub fn value(self) -> f64 {
        match self {
            Interval::Decimal(value) => value,
            Interval::Fraction(counter, resolution) => counter as f64 / resolution as f64,
        }
    }
}
