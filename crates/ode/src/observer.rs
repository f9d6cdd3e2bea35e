//! Reports of the driver during a run: samples, steps and events. The observer may stop the run.

use crate::system::EventCause;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::ControlFlow;

/// Side of an instant on which a sample was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The limit from the left: before the events of that instant.
    Left,
    /// The value after the events of that instant, or a value at a point without events.
    Right,
}

/// States and outputs at one instant.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Time.
    pub time: f64,
    /// Position in the list of requested times; `None` for a row that only records an event.
    pub index: Option<usize>,
    /// Left limit, or the value after all events of this instant.
    pub side: Side,
    /// The continuous states.
    pub states: &'a [f64],
    /// The outputs of the system.
    pub outputs: &'a [f64],
}

/// An event that happened.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EventRecord {
    /// Time of the event.
    pub time: f64,
    /// Causes of the event.
    pub cause: EventCause,
}

/// An accepted step, or its part before an event, for interpolation. Between its ends, the solution is as
/// accurate as at the ends. The interpolants are polynomials in time of degree 7 or less.
#[derive(Clone, Copy)]
pub struct StepView<'a> {
    /// Time at its start.
    pub start: f64,
    /// Time at its end.
    pub end: f64,
    interpolate: &'a dyn Fn(f64, &mut [f64]),
}

impl<'a> StepView<'a> {
    pub(crate) fn new(start: f64, end: f64, interpolate: &'a dyn Fn(f64, &mut [f64])) -> Self {
        Self { start, end, interpolate }
    }

    /// Fills in the states at a time between [`start`](Self::start) and [`end`](Self::end). At the end, fills
    /// in the left limit, before any event. `states` must have one element per state.
    pub fn states_at(&self, time: f64, states: &mut [f64]) {
        (self.interpolate)(time, states);
    }
}

impl fmt::Debug for StepView<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StepView").field("start", &self.start).field("end", &self.end).finish_non_exhaustive()
    }
}

/// Receives samples, in the order of time, and events.
pub trait Observer {
    /// Receives a sample. `Break` ends the run, which is a normal end:
    /// [`Termination::StoppedByObserver`](crate::Termination).
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()>;

    /// True if [`step`](Self::step) should be called for accepted steps. Methods whose interpolation needs
    /// extra evaluations (DOP853) then evaluate it for every step.
    fn needs_steps(&self) -> bool {
        false
    }

    /// Receives an accepted step, before the model is notified and before any event at its end.
    fn step(&mut self, step: &StepView<'_>) {
        let _ = step;
    }

    /// Receives an event after its handling.
    fn event(&mut self, event: &EventRecord) {
        let _ = event;
    }

    /// Called before every trial step and before every sample inside a step. `Break` ends the run as for a
    /// sample. Use this function for limits that must not wait for the next sample.
    fn poll(&mut self) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// Ignores all reports, for runs of which only the final state matters.
#[derive(Debug, Clone, Copy, Default)]
pub struct Ignore;

impl Observer for Ignore {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

impl<O: Observer + ?Sized> Observer for &mut O {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        (**self).sample(sample)
    }
    fn needs_steps(&self) -> bool {
        (**self).needs_steps()
    }
    fn step(&mut self, step: &StepView<'_>) {
        (**self).step(step);
    }
    fn event(&mut self, event: &EventRecord) {
        (**self).event(event);
    }
    fn poll(&mut self) -> ControlFlow<()> {
        (**self).poll()
    }
}
