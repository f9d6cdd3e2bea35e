//! State that the importer keeps for an instance that the user controls, in addition to the FMU's state.

use super::schedule::{Schedule, TimedClock};
use crate::description::{Interval, Value};
use std::sync::Arc;

/// Importer state on which a later run depends. It is saved and restored together with each FMU state.
#[derive(Debug, Clone, Default)]
pub(crate) struct Progress {
    /// Time of the initialization.
    pub(super) start: Option<f64>,
    /// Values set before the experiment is set up, at most one per variable index. They are set again
    /// afterwards, when the structural parameters have their values.
    pub(super) set_before_setup: Vec<(usize, Value)>,
    /// Values that the importer sets when event mode is next entered (co-simulation).
    pub(super) waiting: Vec<(usize, Value)>,
    /// True if the model has requested event mode and has not entered it since (co-simulation).
    pub(super) needs_event: bool,
    /// Next time event of the model or tick of a clock.
    pub(super) next_event: Option<f64>,
    /// Time of the last event as seen by the model. It is later than the time of the run by at most a
    /// rounding error. The model never returns to an earlier time.
    pub(super) floor: Option<f64>,
    /// Event indicators before inputs were set in continuous-time mode.
    pub(super) before_inputs: Option<Vec<f64>>,
    /// Intervals set for clocks, with the variable indices of the clocks.
    pub(super) intervals: Vec<(usize, Interval)>,
    /// Clocks whose ticks the importer schedules, and their next ticks.
    pub(super) clocks: Arc<[TimedClock]>,
    pub(super) schedules: Vec<Schedule>,
}

/// Stores the value of a variable, replacing an earlier value.
pub(super) fn note<T>(values: &mut Vec<(usize, T)>, index: usize, value: T) {
    values.retain(|(noted, _)| *noted != index);
    values.push((index, value));
}

impl Progress {
    /// Returns the difference below which two times count as equal in a run that has reached `time`.
    pub(super) fn time_tolerance(&self, time: f64) -> f64 {
        ode::time_tolerance(self.start.unwrap_or(time), time)
    }

    /// Returns the next known tick.
    pub(super) fn next_tick(&self) -> Option<f64> {
        self.schedules.iter().filter_map(|schedule| schedule.next).min_by(f64::total_cmp)
    }

    /// Returns the model's time for an event at `start`. This is the last event time if it is later by at
    /// most `tolerance`, otherwise `start`.
    pub(super) fn time_at(&self, start: f64, tolerance: f64) -> f64 {
        self.floor.filter(|floor| *floor > start && floor - start <= tolerance).unwrap_or(start)
    }
}
