//! What is done where events follow each other while time hardly advances.

use super::{ErrorKind, Run, Step};
use crate::event::ChatteringGuard;
use crate::observer::Observer;
use crate::options::ChatteringPolicy;
use crate::stepper::Stepper;
use crate::system::{EventCause, HybridSystem};

/// After so many steps without a state event the sliding has ended.
const CLEAN_STEPS: u32 = 100;

/// The guards, and whether the solution slides along the border of a domain.
#[derive(Debug)]
pub(super) struct Sliding {
    state_events: ChatteringGuard,
    time_events: ChatteringGuard,
    /// Length of a step while it slides.
    usual: f64,
    /// The step to try now, if it slides.
    step: Option<f64>,
    clean: u32,
}

impl Sliding {
    pub(super) fn new(span: f64) -> Self {
        Self {
            state_events: ChatteringGuard::new(ChatteringGuard::STATE_EVENTS * span),
            time_events: ChatteringGuard::new(ChatteringGuard::TIME_EVENTS * span),
            usual: ChatteringPolicy::SLIDING_STEP * span,
            step: None,
            clean: 0,
        }
    }

    /// The step to try, if the solution slides: crossings inside of it are not located.
    pub(super) fn step(&self) -> Option<f64> {
        self.step
    }

    /// A step was not good; the next trial has this size.
    pub(super) fn shrink(&mut self, h: f64) {
        self.step = self.step.map(|_| h);
    }

    fn begin(&mut self) {
        self.step = Some(self.usual);
        self.clean = 0;
    }

    /// A step was accepted, with a state event at its end or not.
    fn advance(&mut self, state_event: bool) {
        if self.step.is_some() {
            self.clean = if state_event { 0 } else { self.clean + 1 };
            self.step = (self.clean < CLEAN_STEPS).then_some(self.usual);
            if self.step.is_none() {
                self.state_events.forget();
            }
        }
    }
}

impl<S, M, O> Run<'_, S, M, O>
where
    S: HybridSystem + ?Sized,
    M: Stepper,
    O: Observer + ?Sized,
{
    /// Watches the events at the end of a step for chattering; `crossed` is an indicator that has crossed.
    pub(super) fn watch_events(&mut self, cause: EventCause, crossed: Option<usize>) -> Step<()> {
        let slides = self.sliding.step.is_some();
        self.sliding.advance(cause.state);
        let events = ChatteringGuard::EVENTS as u64;
        if cause.time && self.sliding.time_events.record(self.t).is_some() {
            return Err(ErrorKind::TimeEventLoop(events).into());
        }
        if !cause.state || slides {
            return Ok(());
        }
        let Some(within) = self.sliding.state_events.record(self.t) else { return Ok(()) };
        match self.options.chattering {
            ChatteringPolicy::Slide if self.fixed_step.is_none() && !self.space.x.is_empty() => {
                self.sliding.begin();
            }
            // Each event is located to a few times what tells two instants apart: so close, time stands still.
            ChatteringPolicy::Warn if within > 10.0 * events as f64 * self.same => {}
            _ => {
                let indicator = crossed.unwrap_or_default();
                return Err(ErrorKind::Chattering { events, within, indicator }.into());
            }
        }
        self.sliding.state_events.forget();
        self.stats.chattering += 1;
        Ok(())
    }
}
