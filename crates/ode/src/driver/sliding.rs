//! Steps along the border of a domain, where events would follow each other without end (sliding).

use super::chattering::ChatteringGuard;
use crate::options::ChatteringPolicy;

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
