//! Signals that end a run from outside during evaluations.

use super::evaluator::Wait;
use crate::problem::objective::{CancelSignals, NEVER};
use base::RunContext;
use std::cell::Cell;
use std::time::{Duration, Instant};

/// Maximum time between two checks for interrupts while other threads compute.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Checks the context of a run during the evaluation of a batch.
pub(crate) struct ContextPoller<'a> {
    context: RunContext<'a>,
    last_check: Cell<Option<Instant>>,
}

/// Reason why no more evaluations may start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StopCause {
    Interrupted,
    OutOfTime,
}

impl<'a> ContextPoller<'a> {
    pub(crate) fn new(context: RunContext<'a>) -> Self {
        Self { context, last_check: Cell::default() }
    }

    /// Returns the part of the context that evaluations on other threads see.
    pub(crate) fn signals(&self) -> CancelSignals<'a> {
        CancelSignals::new(self.context.flag().unwrap_or(&NEVER), self.context.end())
    }

    /// Returns the reason why the run must end, if any. Calls the function of the context unless it was
    /// called a moment ago.
    pub(crate) fn check(&self) -> Option<StopCause> {
        if self.signals().is_cancelled() {
            return Some(StopCause::Interrupted);
        }
        if self.context.end().is_none() && self.context.function().is_none() {
            return None;
        }
        let now = Instant::now();
        if let Some(ask) = self.context.function()
            && self.last_check.get().is_none_or(|t| now - t >= POLL_INTERVAL)
        {
            self.last_check.set(Some(now));
            if ask() {
                return Some(StopCause::Interrupted);
            }
        }
        self.context.end().filter(|d| now >= *d).map(|_| StopCause::OutOfTime)
    }

    /// Returns the time until which the calling thread may wait for an answer before it checks the signals
    /// again. `halted` is true if the deadline has already been noticed.
    pub(crate) fn wait(&self, halted: bool) -> Wait<'a> {
        let soon = Instant::now() + POLL_INTERVAL;
        let until = self.context.end().filter(|_| !halted).map_or(soon, |deadline| deadline.min(soon));
        Wait { until, signals: self.signals() }
    }
}
