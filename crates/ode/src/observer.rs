//! Reports of the driver while it runs: samples and events. The observer may stop the run.

use crate::system::EventCause;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::ControlFlow;

/// On which side of an instant a sample was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The limit from the left: before the events of that instant.
    Left,
    /// The value after the events of that instant, or a point where nothing happens.
    Right,
}

/// States and outputs at one instant.
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Time.
    pub time: f64,
    /// Position in the list of requested times; `None` for a row that only records an event.
    pub index: Option<usize>,
    /// Left limit, or the value after everything that happens at this instant.
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

/// An accepted step, or the part of it before an event, to be looked into: between its ends the solution is
/// as accurate as at them. What the methods interpolate with are polynomials in time of degree 7 at most.
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

    /// Fills in the states at a time between [`start`](Self::start) and [`end`](Self::end) (the limit from
    /// the left there, before any event). `states` has one place per state.
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
    /// A sample; `Break` ends the run (a normal end: [`Termination::StoppedByObserver`](crate::Termination)).
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()>;

    /// True if [`step`](Self::step) is to be called with accepted steps. Methods whose interpolation costs
    /// extra evaluations (DOP853) make them for every step then.
    fn wants_steps(&self) -> bool {
        false
    }

    /// A step was accepted; told before the model is, and before any event at its end.
    fn step(&mut self, step: &StepView<'_>) {
        let _ = step;
    }

    /// An event has been handled.
    fn event(&mut self, event: &EventRecord) {
        let _ = event;
    }

    /// Asked before every trial step and every sample inside of a step; `Break` ends the run as for a sample.
    /// For limits that do not wait for one.
    fn poll(&mut self) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// Ignores everything: for runs whose final state alone matters.
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
    fn wants_steps(&self) -> bool {
        (**self).wants_steps()
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
