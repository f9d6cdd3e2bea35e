//! Events that follow each other while time hardly advances.

use crate::options::ChatteringPolicy;

/// Notices events that follow each other while time hardly advances (chattering, Zeno). The test is on the
/// time that passes, not on the number of events: many events far apart are a legal model.
#[derive(Debug)]
pub(super) struct ChatteringGuard {
    times: [f64; Self::EVENTS],
    next: usize,
}

impl ChatteringGuard {
    /// So many events in a row must advance time.
    pub(super) const EVENTS: usize = 100;
    /// State events by this share of the span, or by so many seconds if that is less: how often a relay may
    /// switch does not depend on how long it is watched.
    pub(super) const STATE_EVENTS: (f64, f64) = (1e-6, 1e-3);
    /// Bounces of a body that is to slide likewise: they are ten times shorter than a step of sliding, and
    /// may be kept up by rounding or by what the tolerance leaves.
    pub(super) const BOUNCES: (f64, f64) = (10.0 * ChatteringPolicy::SLIDING_STEP, 1e-3);
    /// Time events likewise: a clock may be fast, but it must not stand still.
    pub(super) const TIME_EVENTS: (f64, f64) = (1e-9, 1e-6);

    /// By how much they must, in a span in which times closer than `time_tolerance` are one.
    pub(super) fn least_in(limits: (f64, f64), span: f64, time_tolerance: f64) -> f64 {
        let (share, enough) = limits;
        (share * span).min(enough.max(Self::still(time_tolerance)))
    }

    /// An event is located to a few times what tells two instants apart: in less time than this for all of
    /// them, time stands still.
    pub(super) fn still(time_tolerance: f64) -> f64 {
        10.0 * Self::EVENTS as f64 * time_tolerance
    }

    pub(super) fn new() -> Self {
        Self { times: [f64::NEG_INFINITY; Self::EVENTS], next: 0 }
    }

    /// Records an event at `t`; returns the time in which the last [`EVENTS`](Self::EVENTS) happened if that
    /// is less than `least`.
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
