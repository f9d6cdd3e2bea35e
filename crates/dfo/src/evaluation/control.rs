//! What may end a run from outside while evaluations are under way.

use super::evaluator::Wait;
use crate::objective::CancelSignals;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// The calling thread looks for interrupts at least this often while others compute.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// What the outside may want while a batch is computed.
pub(crate) struct RunControl<'a> {
    pub(crate) signals: CancelSignals<'a>,
    poll: Option<&'a mut dyn FnMut() -> bool>,
    last_poll: Option<Instant>,
}

/// Why no more evaluations may start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StopCause {
    Interrupted,
    OutOfTime,
}

impl<'a> RunControl<'a> {
    pub(crate) fn new(
        cancel: &'a AtomicBool,
        deadline: Option<Instant>,
        poll: Option<&'a mut dyn FnMut() -> bool>,
    ) -> Self {
        Self { signals: CancelSignals::new(cancel, deadline), poll, last_poll: None }
    }

    /// Whether to go on; asks the user's poll function unless it was asked a moment ago.
    pub(crate) fn check(&mut self) -> Option<StopCause> {
        if self.signals.is_cancelled() {
            return Some(StopCause::Interrupted);
        }
        if self.signals.deadline.is_none() && self.poll.is_none() {
            return None;
        }
        let now = Instant::now();
        if let Some(poll) =
            self.poll.as_mut().filter(|_| self.last_poll.is_none_or(|t| now - t >= POLL_INTERVAL))
        {
            self.last_poll = Some(now);
            if poll() {
                return Some(StopCause::Interrupted);
            }
        }
        self.signals.deadline.filter(|d| now >= *d).map(|_| StopCause::OutOfTime)
    }

    /// How long the calling thread may wait for an answer before it must look up. `halted`: whether it knows of the
    /// deadline already.
    pub(crate) fn wait(&self, halted: bool) -> Wait<'a> {
        let soon = Instant::now() + POLL_INTERVAL;
        let until = self.signals.deadline.filter(|_| !halted).map_or(soon, |deadline| deadline.min(soon));
        Wait { until, signals: self.signals }
    }
}
