//! Detection of events that follow each other while time hardly advances.

use crate::options::ChatteringPolicy;

/// Detects events that follow each other while time hardly advances (chattering, Zeno). The test uses the
/// elapsed time, not the number of events, because a model with many events far apart is valid.
#[derive(Debug)]
pub(super) struct ChatteringGuard {
    times: [f64; Self::EVENTS],
    next: usize,
}

impl ChatteringGuard {
    /// Number of consecutive events that must advance time.
    pub(super) const EVENTS: usize = 100;
    /// Threshold for state events: this fraction of the span, or this number of seconds if smaller. The
    /// allowed switching rate of a relay does not depend on the length of the run.
    pub(super) const STATE_EVENTS: (f64, f64) = (1e-6, 1e-3);
    /// Threshold for bounces of a body that may slide. The bounces are ten times shorter than a step of
    /// sliding. Rounding or errors within the tolerance may sustain them.
    pub(super) const BOUNCES: (f64, f64) = (10.0 * ChatteringPolicy::SLIDING_STEP, 1e-3);
    /// Threshold for time events: a clock may be fast, but time must advance.
    pub(super) const TIME_EVENTS: (f64, f64) = (1e-9, 1e-6);

    /// Returns the minimum time for [`EVENTS`](Self::EVENTS) events. `span` is the length of the run, and
    /// times closer than `time_tolerance` are equal.
    pub(super) fn least_in(limits: (f64, f64), span: f64, time_tolerance: f64) -> f64 {
        let (share, enough) = limits;
        (share * span).min(enough.max(Self::still(time_tolerance)))
    }

    /// Returns the time below which [`EVENTS`](Self::EVENTS) events do not advance time. An event is located
    /// to a few time tolerances.
    pub(super) fn still(time_tolerance: f64) -> f64 {
        10.0 * Self::EVENTS as f64 * time_tolerance
    }

    pub(super) fn new() -> Self {
        Self { times: [f64::NEG_INFINITY; Self::EVENTS], next: 0 }
    }

    /// Records an event at `t`. Returns the time in which the last [`EVENTS`](Self::EVENTS) events happened
    /// if it is less than `least`.
    pub(super) fn record(&mut self, t: f64, least: f64) -> Option<f64> {
        let within = t - self.times[self.next];
        self.times[self.next] = t;
        self.next = (self.next + 1) % Self::EVENTS;
        (within < least).then_some(within)
    }

    /// Forgets all events.
    pub(super) fn forget(&mut self) {
        self.times.fill(f64::NEG_INFINITY);
    }
}
