//! What the driver tells the outside while it runs: samples and events. The outside may say "stop".

use crate::system::EventCause;
use std::ops::ControlFlow;

/// On which side of an instant a sample was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventRecord {
    /// Time of the event.
    pub time: f64,
    /// What made it.
    pub cause: EventCause,
}

/// Receives samples, in the order of time, and events.
pub trait Observer {
    /// A sample; `Break` ends the run (a normal end: [`Termination::StoppedByObserver`](crate::Termination)).
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()>;

    /// An event has been handled.
    fn event(&mut self, event: &EventRecord) {
        let _ = event;
    }

    /// Asked before every trial step; `Break` ends the run as for a sample. For limits that do not wait for one.
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
    fn event(&mut self, event: &EventRecord) {
        (**self).event(event);
    }
    fn poll(&mut self) -> ControlFlow<()> {
        (**self).poll()
    }
}
