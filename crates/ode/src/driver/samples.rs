//! Samples during a run: inside a step, left of an event, and after all events at an instant.

use super::returns_after_event::{later, move_along};
use super::run::{Run, Space, Step, finish, no_retreat, read_indicators};
use crate::error::Termination;
use crate::observer::{Observer, StepOutputs, StepView};
use crate::sampling::Here;
use crate::stepper::Trial;
use crate::system::{CallError, CallResult};
use std::ops::ControlFlow;

impl Run<'_> {
    /// Delivers the samples inside the step, before `at`. Returns `false` if the model refused a sample
    /// point. The step is then not accepted yet, so a smaller step can follow.
    pub(super) fn sample_before(&mut self, at: f64, end: f64, h: f64) -> Step<bool> {
        while let Some(t) = self.space.sampler.due_before(self.times, at - self.time_tolerance) {
            self.check_stop()?;
            let Space { x, x_mid, sampler, .. } = &mut *self.space;
            let theta = ((t - self.t) / h).clamp(0.0, 1.0);
            self.stepper.interpolate(Trial { t: self.t, end, h, x }, theta, x_mid);
            let here = Here { t, x: x_mid, time_tolerance: 0.0, record: false };
            match sampler.deliver(self.system, self.times, &here, self.observer) {
                Err(CallError::Discard) => return Ok(false),
                flow => follow(flow)?,
            }
        }
        Ok(true)
    }

    /// Passes the step of size `h` that ends at `end`, up to `at`, to an observer that requests outputs.
    /// Returns `false` if the model refused one of its points.
    pub(super) fn show_outputs(&mut self, at: f64, end: f64, h: f64) -> Step<bool> {
        if !self.observer.needs_outputs() {
            return Ok(true);
        }
        let (stepper, system, began) = (&*self.stepper, &mut *self.system, self.t);
        let Space { x, x_mid, .. } = &mut *self.space;
        let trial = Trial { t: began, end, h, x };
        let is_ordered = system.outputs_in_order();
        let mut evaluate = |t: f64, outputs: &mut [f64]| {
            stepper.interpolate(trial, ((t - began) / h).clamp(0.0, 1.0), x_mid);
            system.outputs(t, x_mid, outputs)
        };
        match self.observer.outputs(&mut StepOutputs::new((began, at), is_ordered, &mut evaluate)) {
            Err(CallError::Discard) => Ok(false),
            shown => shown.map(|()| true).map_err(no_retreat),
        }
    }

    /// Delivers the left limit at the current time if the time is listed twice or events are recorded.
    pub(super) fn sample_left(&mut self) -> Step<()> {
        let Space { x, sampler, .. } = &mut *self.space;
        let here =
            Here { t: self.t, x, time_tolerance: self.time_tolerance, record: self.options.record_events };
        follow(sampler.deliver_left(self.system, self.times, &here, self.observer))
    }

    /// Records the row after an event while the samples at the current time wait for another event.
    pub(super) fn record_here(&mut self, after_event: bool) -> Step<()> {
        if !(after_event && self.options.record_events) {
            return Ok(());
        }
        let Space { x, sampler, .. } = &mut *self.space;
        let here = Here { t: self.t, x, time_tolerance: self.time_tolerance, record: true };
        follow(sampler.record(self.system, &here, self.observer))
    }

    /// True if samples are due at the current time and an indicator also crosses there, within rounding after
    /// it. The samples then follow the crossing.
    pub(super) fn is_about_to_cross(&mut self) -> Step<bool> {
        let Space { x, x_mid, domains, sampler, .. } = &mut *self.space;
        let is_due = sampler.due_before(self.times, self.t + self.time_tolerance).is_some();
        if !is_due || !domains.any_next_to_zero() {
            return Ok(false);
        }
        // With a mass matrix, the right-hand side is not the slope of the states.
        if self.system.mass_matrix().is_some() {
            return Ok(true);
        }
        let (at, s) = later(self.t, 2.0 * self.time_tolerance);
        move_along(x_mid, s, x, self.stepper.derivative());
        self.stats.event_indicators += 1;
        match domains.crosses_up_to(|z| read_indicators(self.system, at, x_mid, z)) {
            Err(CallError::Discard) => Ok(false),
            crosses => crosses.map_err(no_retreat),
        }
    }

    /// Delivers all samples still due at the current time, after all events there.
    pub(super) fn sample_here(&mut self, after_event: bool) -> Step<()> {
        let Space { x, sampler, .. } = &mut *self.space;
        let record = after_event && self.options.record_events;
        let here = Here { t: self.t, x, time_tolerance: self.time_tolerance, record };
        follow(sampler.deliver_here(self.system, self.times, &here, self.observer))
    }

    /// Passes the step of size `h` that ends at `end`, up to `at`, to an observer that requests steps.
    pub(super) fn show_step(&mut self, at: f64, end: f64, h: f64) {
        if self.observer.needs_steps() {
            let (stepper, began) = (&*self.stepper, self.t);
            let trial = Trial { t: began, end, h, x: &self.space.x };
            let inside = |t: f64, x: &mut [f64]| {
                stepper.interpolate(trial, ((t - began) / h).clamp(0.0, 1.0), x);
            };
            self.observer.step(&StepView::new(began, at, &inside));
        }
    }
}

/// Converts the answer of the observer to a sample.
fn follow(flow: CallResult<ControlFlow<()>>) -> Step<()> {
    match flow.map_err(no_retreat)? {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => finish(Termination::StoppedByObserver),
    }
}
