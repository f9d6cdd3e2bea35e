//! Reports of the driver during a run: samples, steps and events. The observer may stop the run.

use crate::system::{CallResult, EventCause};
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

/// An accepted step, or its part before an event, at whose times the outputs of the system can be evaluated.
/// The system is still in the state before the step is completed, so its outputs follow the interpolated
/// states.
pub struct StepOutputs<'a> {
    /// Time at its start.
    pub start: f64,
    /// Time at its end.
    pub end: f64,
    /// True if the times must be in the order of the integration.
    pub is_ordered: bool,
    evaluate: &'a mut dyn FnMut(f64, &mut [f64]) -> CallResult<()>,
}

impl<'a> StepOutputs<'a> {
    pub(crate) fn new(
        (start, end): (f64, f64),
        is_ordered: bool,
        evaluate: &'a mut dyn FnMut(f64, &mut [f64]) -> CallResult<()>,
    ) -> Self {
        Self { start, end, is_ordered, evaluate }
    }

    /// Fills in the outputs at a time between [`start`](Self::start) and [`end`](Self::end). At the start,
    /// fills in the values after any event; at the end, the left limit. `outputs` must have one element per
    /// output.
    ///
    /// # Errors
    /// Returns the error of the system. The observer returns it unchanged.
    pub fn outputs_at(&mut self, time: f64, outputs: &mut [f64]) -> CallResult<()> {
        (self.evaluate)(time, outputs)
    }
}

impl fmt::Debug for StepOutputs<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StepOutputs")
            .field("start", &self.start)
            .field("end", &self.end)
            .finish_non_exhaustive()
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

    /// True if [`outputs`](Self::outputs) should be called for accepted steps.
    fn needs_outputs(&self) -> bool {
        false
    }

    /// Receives an accepted step whose outputs can be evaluated, before the samples inside it. If the system
    /// discards one of its points, a shorter step with the same start follows, which replaces this one.
    ///
    /// # Errors
    /// Returns the error of [`StepOutputs::outputs_at`].
    fn outputs(&mut self, step: &mut StepOutputs<'_>) -> CallResult<()> {
        let _ = step;
        Ok(())
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
    fn needs_outputs(&self) -> bool {
        (**self).needs_outputs()
    }
    fn outputs(&mut self, step: &mut StepOutputs<'_>) -> CallResult<()> {
        (**self).outputs(step)
    }
    fn event(&mut self, event: &EventRecord) {
        (**self).event(event);
    }
    fn poll(&mut self) -> ControlFlow<()> {
        (**self).poll()
    }
}
