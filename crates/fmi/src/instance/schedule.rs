//! Schedule of a clock. Tick times are computed as multiples of the interval, never as sums, and fractions
//! stay exact as long as possible.

use crate::description::{ClockTiming, Interval, Variable};
use crate::error::{FmiError, Result};
use std::sync::Arc;

/// Clock whose ticks the importer schedules.
#[derive(Debug, Clone)]
pub(crate) struct TimedClock {
    pub(crate) reference: u32,
    pub(crate) name: Arc<str>,
    pub(crate) timing: ClockTiming,
    /// Interval that the importer sets in initialization mode.
    pub(crate) given: Option<Interval>,
}

impl TimedClock {
    /// Creates the schedule data of a clock of the model with this timing.
    pub(crate) fn new(variable: &Variable, timing: ClockTiming, given: Option<Interval>) -> Self {
        Self { reference: variable.value_reference, name: Arc::from(variable.name.as_str()), timing, given }
    }

    /// Returns an error for an interval or shift that is negative or not finite. If `positive` is true, 0 is
    /// also an error.
    pub(crate) fn check(&self, interval: Interval, positive: bool) -> Result<()> {
        let value = interval.value();
        if value.is_finite() && (value > 0.0 || (value == 0.0 && !positive)) {
            return Ok(());
        }
        let least = if positive { "positive" } else { "non-negative" };
        Err(FmiError::BadSetting(format!(
            "the {} clock {} has an interval or shift of {interval:?}; expected a finite, {least} value",
            self.timing.kind.name(),
            self.name
        )))
    }
}

/// Returns the earlier of a time event announced by the model and a clock tick. If both are equal within
/// `tolerance`, returns the announced time, because the model must see exactly that time.
pub(crate) fn next_instant(announced: Option<f64>, tick: Option<f64>, tolerance: f64) -> Option<f64> {
    match (announced, tick) {
        (Some(announced), Some(tick)) if announced > tick + tolerance => Some(tick),
        (announced, tick) => announced.or(tick),
    }
}

/// Times of the next ticks of a clock.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Schedule {
    origin: f64,
    shift: Interval,
    interval: Interval,
    /// Number of the next tick, counted from 0 at `origin + shift`.
    number: u64,
    /// Time of the next tick; `None` while it is unknown.
    pub(crate) next: Option<f64>,
}

impl Schedule {
    pub(crate) const IDLE: Schedule = Schedule {
        origin: 0.0,
        shift: Interval::Decimal(0.0),
        interval: Interval::Decimal(0.0),
        number: 0,
        next: None,
    };

    pub(crate) fn periodic(origin: f64, shift: Interval, interval: Interval, number: u64) -> Self {
        let mut schedule = Self { origin, shift, interval, number, next: None };
        schedule.next = Some(schedule.time_of(number));
        schedule
    }

    /// Creates a schedule with a single tick.
    pub(crate) fn once(time: f64) -> Self {
        Self { next: Some(time), ..Self::IDLE }
    }

    fn time_of(&self, number: u64) -> f64 {
        match (self.shift, self.interval) {
            (Interval::Fraction(shift, r), Interval::Fraction(interval, resolution)) if r == resolution => {
                // The counter stays below 2^128 for every possible number of ticks.
                let counter = u128::from(shift) + u128::from(number) * u128::from(interval);
                self.origin + counter as f64 / resolution as f64
            }
            (shift, Interval::Fraction(interval, resolution)) => {
                let counter = u128::from(number) * u128::from(interval);
                self.origin + (shift.value() + counter as f64 / resolution as f64)
            }
            (shift, Interval::Decimal(interval)) => self.origin + (shift.value() + number as f64 * interval),
        }
    }

    pub(crate) fn advance(&mut self) {
        self.number += 1;
        self.next = Some(self.time_of(self.number));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedule_computes_ticks_as_multiples_of_the_interval() {
        let mut schedule = Schedule::periodic(1.0, Interval::Decimal(0.25), Interval::Decimal(0.1), 0);
        for k in 0..1000u32 {
            assert_eq!(schedule.next, Some(1.0 + (0.25 + f64::from(k) * 0.1)));
            schedule.advance();
        }
        // The interval 1/3 is exact at every third tick.
        let mut third = Schedule::periodic(0.0, Interval::Fraction(0, 3), Interval::Fraction(1, 3), 0);
        for k in 0..3000u32 {
            assert_eq!(third.next, Some(f64::from(k) / 3.0));
            if k % 3 == 0 {
                assert_eq!(third.next, Some(f64::from(k / 3)));
            }
            third.advance();
        }
        let mixed = Schedule::periodic(2.0, Interval::Fraction(1, 4), Interval::Fraction(1, 8), 3);
        assert_eq!(mixed.next, Some(2.625));
    }
}
