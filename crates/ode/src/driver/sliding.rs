//! Sliding: steps along the border of a domain, where events would otherwise follow each other indefinitely.

use super::chattering::ChatteringGuard;
use crate::options::ChatteringPolicy;

/// The guards against chattering and the state of sliding along the border of a domain.
#[derive(Debug)]
pub(super) struct Sliding {
    pub(super) state_events: ChatteringGuard,
    pub(super) time_events: ChatteringGuard,
    /// A hundred state events, bounces or time events in less than these times are too many.
    pub(super) chatters: f64,
    pub(super) bounces: f64,
    pub(super) ticks: f64,
    /// A hundred events in less than this time do not advance time.
    pub(super) standstill: f64,
    /// Length of a step while sliding.
    usual: f64,
    /// The step to try now, while sliding.
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
            standstill: ticks.max(ChatteringGuard::still(time_tolerance)),
            usual: ChatteringPolicy::SLIDING_STEP * span,
            step: None,
        }
    }

    /// Step to try while sliding. Crossings of the sliding indicators are not located in it.
    pub(super) fn step(&self) -> Option<f64> {
        self.step
    }

    /// Sets the size of the next trial after a failed step.
    pub(super) fn shrink(&mut self, h: f64) {
        self.step = self.step.map(|_| h);
    }

    /// Length of a step while sliding.
    pub(super) fn usual(&self) -> f64 {
        self.usual
    }

    /// Starts sliding and returns the length of the next step.
    pub(super) fn begin(&mut self) -> f64 {
        self.step = Some(self.usual);
        self.state_events.forget();
        self.usual
    }

    /// Updates the step after an accepted step. `any_slides`: some indicator still slides.
    pub(super) fn advance(&mut self, any_slides: bool) {
        self.step = any_slides.then_some(self.usual);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chattering_guard_uses_elapsed_time() {
        let mut guard = ChatteringGuard::new();
        assert!((0..10_000).all(|i| guard.record(f64::from(i) * 1e-4, 1e-6).is_none()));
        let mut guard = ChatteringGuard::new();
        let caught = (0..200).position(|i| guard.record(f64::from(i) * 1e-10, 1e-6).is_some());
        assert_eq!(caught, Some(100));
    }
}
