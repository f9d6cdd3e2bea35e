//! What the importer knows of a run by hand beside the FMU itself.

use super::schedule::{Schedule, TimedClock};
use crate::description::{Interval, Value};
use std::sync::Arc;

/// Saved with each state of the FMU, and brought back with it: all that a later run depends on.
#[derive(Debug, Clone, Default)]
pub(crate) struct Progress {
    /// Time of the initialization.
    pub(super) start: Option<f64>,
    /// Values set before the experiment is set up: the position of the variable, each once. They are set once
    /// more then, when the structural parameters have their values.
    pub(super) set_before_setup: Vec<(usize, Value)>,
    /// What the importer sets in event mode when it is there next (co-simulation).
    pub(super) waiting: Vec<(usize, Value)>,
    /// The model has asked for event mode and has not been there since (co-simulation).
    pub(super) is_event_asked: bool,
    /// The next time event of the model, or tick of a clock.
    pub(super) next_event: Option<f64>,
    /// Time of the last event as the model saw it: a rounding error later than that of the run at most, and
    /// never gone back behind.
    pub(super) floor: Option<f64>,
    /// The event indicators before inputs were set in continuous-time mode.
    pub(super) before_inputs: Option<Vec<f64>>,
    /// Intervals that clocks were given, by their positions.
    pub(super) intervals: Vec<(usize, Interval)>,
    /// The clocks whose ticks the importer schedules, and when they tick next.
    pub(super) clocks: Arc<[TimedClock]>,
    pub(super) schedules: Vec<Schedule>,
}

/// Notes the value of a variable, in the place of an earlier one.
pub(super) fn note<T>(values: &mut Vec<(usize, T)>, index: usize, value: T) {
    values.retain(|(known, _)| *known != index);
    values.push((index, value));
}

impl Progress {
    /// Times closer than this are one, in a run that has come to `time`.
    pub(super) fn time_tolerance(&self, time: f64) -> f64 {
        ode::time_tolerance(self.start.unwrap_or(time), time)
    }

    /// The next tick known.
    pub(super) fn next_tick(&self) -> Option<f64> {
        self.schedules.iter().filter_map(|schedule| schedule.next).min_by(f64::total_cmp)
    }

    /// The time at which the model stands after an event at `start`, or a rounding error before it.
    pub(super) fn time_at(&self, start: f64, tolerance: f64) -> f64 {
        self.floor.filter(|floor| *floor > start && floor - start <= tolerance).unwrap_or(start)
    }
}
