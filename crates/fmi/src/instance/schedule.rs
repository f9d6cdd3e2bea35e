//! When a clock ticks next: ticks are multiples, never sums, and fractions are exact for as long as they can
//! be.

use crate::description::Interval;

/// When a clock ticks next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Schedule {
    origin: f64,
    shift: Interval,
    interval: Interval,
    /// Number of the next tick, counted from 0 at `origin + shift`.
    number: u64,
    /// The next tick; none while it is not known.
    pub(super) next: Option<f64>,
}

impl Schedule {
    pub(super) const IDLE: Schedule = Schedule {
        origin: 0.0,
        shift: Interval::Decimal(0.0),
        interval: Interval::Decimal(0.0),
        number: 0,
        next: None,
    };

    pub(super) fn periodic(origin: f64, shift: Interval, interval: Interval, number: u64) -> Self {
        let mut schedule = Self { origin, shift, interval, number, next: None };
        schedule.next = Some(schedule.time_of(number));
        schedule
    }

    /// One tick only.
    pub(super) fn once(time: f64) -> Self {
        Self { next: Some(time), ..Self::IDLE }
    }

    fn time_of(&self, number: u64) -> f64 {
        match (self.shift, self.interval) {
            (Interval::Fraction(shift, r), Interval::Fraction(interval, resolution)) if r == resolution => {
                // Below 2^128 for every number of ticks that a run can have.
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

    pub(super) fn advance(&mut self) {
        self.number += 1;
        self.next = Some(self.time_of(self.number));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_multiples_never_sums() {
        let mut schedule = Schedule::periodic(1.0, Interval::Decimal(0.25), Interval::Decimal(0.1), 0);
        for k in 0..1000u32 {
            assert_eq!(schedule.next, Some(1.0 + (0.25 + f64::from(k) * 0.1)));
            schedule.advance();
        }
        // A third: exact where the fraction is, at every third tick.
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
