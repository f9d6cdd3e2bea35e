//! Detection of events that follow each other while time hardly advances (chattering), and the steps of
//! sliding.

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
    const STATE_EVENTS: (f64, f64) = (1e-6, 1e-3);
    /// Bounces of a body that is to slide likewise: they are ten times shorter than a step of sliding, and
    /// may be kept up by rounding or by what the tolerance leaves.
    const BOUNCES: (f64, f64) = (10.0 * ChatteringPolicy::SLIDING_STEP, 1e-3);
    /// Time events likewise: a clock may be fast, but it must not stand still.
    const TIME_EVENTS: (f64, f64) = (1e-9, 1e-6);

    /// By how much they must, in a span in which times closer than `time_tolerance` are one.
    fn least_in(limits: (f64, f64), span: f64, time_tolerance: f64) -> f64 {
        let (share, enough) = limits;
        (share * span).min(enough.max(Self::still(time_tolerance)))
    }

    /// An event is located to a few times what tells two instants apart: in less time than this for all of
    /// them, time stands still.
    fn still(time_tolerance: f64) -> f64 {
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

/// The guards, and whether the solution slides along the border of a domain.
#[derive(Debug)]
pub(super) struct Sliding {
    pub(super) state_events: ChatteringGuard,
    pub(super) time_events: ChatteringGuard,
    /// In this time a hundred state events, bounces and time events are too many.
    pub(super) chatters: f64,
    pub(super) bounces: f64,
    pub(super) ticks: f64,
    /// In less time than this a hundred events do not go on.
    pub(super) stands_still: f64,
    /// Length of a step while it slides.
    usual: f64,
    /// The step to try now, if it slides.
    step: Option<f64>,
}

impl Sliding {
    pub(super) fn new(span: f64, time_tolerance: f64) -> Self {
        let least = |limits| ChatteringGuard::least_in(limits, span, time_tolerance);
        let ticks = least(ChatteringGuard::TIME_EVENTS);
        Self {
            state_events: ChatteringGuard::new(),
            time_events: ChatteringGuard::new(),
            chatters: least(ChatteringGuard::STATE_EVENTS),
            bounces: least(ChatteringGuard::BOUNCES),
            ticks,
            stands_still: ticks.max(ChatteringGuard::still(time_tolerance)),
            usual: ChatteringPolicy::SLIDING_STEP * span,
            step: None,
        }
    }

    /// The step to try, if the solution slides: crossings of the indicators that slide are not located in it.
    pub(super) fn step(&self) -> Option<f64> {
        self.step
    }

    /// A step was not good; the next trial has this size.
    pub(super) fn shrink(&mut self, h: f64) {
        self.step = self.step.map(|_| h);
    }

    /// Length of a step while it slides.
    pub(super) fn usual(&self) -> f64 {
        self.usual
    }

    /// Slides from now on; the length of the next step.
    pub(super) fn begin(&mut self) -> f64 {
        self.step = Some(self.usual);
        self.state_events.forget();
        self.usual
    }

    /// A step was accepted, after which some indicator slides or none.
    pub(super) fn advance(&mut self, any_slides: bool) {
        self.step = any_slides.then_some(self.usual);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_guard_looks_at_time_not_at_the_count() {
        let mut guard = ChatteringGuard::new();
        assert!((0..10_000).all(|i| guard.record(f64::from(i) * 1e-4, 1e-6).is_none()));
        let mut guard = ChatteringGuard::new();
        let caught = (0..200).position(|i| guard.record(f64::from(i) * 1e-10, 1e-6).is_some());
        assert_eq!(caught, Some(100));
    }
}
