//! Events at the current point of the run: one visit for all causes, then continuation or restart.

use super::chattering::ChatteringGuard;
use super::run::{Run, Space, Step, finish, no_retreat, read_indicators};
use crate::error::{ErrorKind, Termination};
use crate::observer::EventRecord;
use crate::options::ChatteringPolicy;
use crate::step_size::{first_step, probe_step};
use crate::stepper::{Consistency, Equations, Trial};
use crate::system::{CallError, CallResult, EventCause, EventOutcome, EventVisit};

/// Slopes count as equal if their difference moves no state in a step by more than this fraction of its
/// tolerance.
const SAME_SLOPE: f64 = 0.1;

/// Treats a slope that cannot be evaluated, just outside the domain of the model, as a change.
fn or_change(evaluated: CallResult<()>, slope: &mut [f64]) -> Step<()> {
    match evaluated {
        Ok(()) => Ok(()),
        Err(CallError::Discard) => {
            slope.fill(f64::NAN);
            Ok(())
        }
        Err(failed) => Err(no_retreat(failed)),
    }
}

impl Run<'_> {
    /// Checks the events at the end of a step for chattering. `crossed` is an indicator that has crossed; one
    /// that does not slide, if any.
    pub(super) fn watch_events(&mut self, cause: EventCause, crossed: Option<usize>) -> Step<()> {
        let slides = crossed.is_some_and(|i| self.space.domains.slides(i));
        if self.sliding.step().is_some() {
            self.sliding.advance(self.space.domains.go_on_sliding());
        }
        let events = ChatteringGuard::EVENTS as u64;
        if cause.time && self.sliding.time_events.record(self.t, self.sliding.ticks).is_some() {
            return Err(ErrorKind::TimeEventLoop(events).into());
        }
        if !cause.state || slides {
            return Ok(());
        }
        let can_slide = self.options.chattering == ChatteringPolicy::Slide
            && self.fixed_step.is_none()
            && !self.space.x.is_empty();
        let bounces = can_slide && crossed.is_some_and(|i| self.space.domains.resets(i));
        let least = if bounces { self.sliding.bounces } else { self.sliding.chatters };
        let Some(within) = self.sliding.state_events.record(self.t, least) else { return Ok(()) };
        match self.options.chattering {
            ChatteringPolicy::Slide if can_slide => {
                self.space.domains.slide_marked();
                self.sliding.begin();
            }
            ChatteringPolicy::Warn if within > self.sliding.standstill => {}
            _ => {
                let indicator = crossed.unwrap_or_default();
                return Err(ErrorKind::Chattering { events, within, indicator }.into());
            }
        }
        self.sliding.state_events.forget();
        self.stats.chattering += 1;
        Ok(())
    }

    /// Handles the events at the current time and restarts the method if they changed something.
    pub(super) fn visit_event(&mut self, cause: EventCause) -> Step<()> {
        if let Some(n) = self.options.limits.max_events
            && self.stats.events >= n
        {
            return Err(ErrorKind::TooManyEvents(n).into());
        }
        let space = &mut *self.space;
        space.x_mid.copy_from_slice(&space.x);
        // If two instants are equal within rounding, the model receives the later one. Otherwise its time
        // event would not be due.
        let announced = self.next_time_event.filter(|_| cause.time).unwrap_or(self.t);
        let time = self.t.max(announced);
        self.t = time.min(self.end);
        let visit = EventVisit { time, cause, crossings: &space.domains.crossings };
        let outcome = self.system.handle_event(&visit, &mut space.x);
        let outcome = self.with_states(outcome)?;
        self.count(cause);
        self.last_event = Some(self.t);
        self.observer.event(&EventRecord { time: self.t, cause });
        self.take_event_time(outcome.next_time)?;
        if outcome.nominals_changed {
            self.read_nominals()?;
        }
        if outcome.terminate {
            self.sample_here(true)?;
            return finish(Termination::StoppedByModel);
        }
        let resumed = self.resume(outcome, cause);
        self.space.domains.clear_marks();
        resumed
    }

    fn count(&mut self, cause: EventCause) {
        let stats = &mut self.stats;
        stats.events += 1;
        stats.state_events += u64::from(cause.state);
        stats.time_events += u64::from(cause.time);
        stats.step_events += u64::from(cause.step);
        stats.input_events += u64::from(cause.input);
    }

    /// Determines the right-hand side on the left side of an event without a crossing. It decides whether the
    /// method must restart. The right-hand side is evaluated if it is not known. The slopes of interpolants
    /// are too inaccurate for this decision, and can have any error near stiff components.
    pub(super) fn take_slope(&mut self, is_evaluated: bool) -> Step<()> {
        let Space { x, slope, weights, .. } = &mut *self.space;
        if is_evaluated
            || x.is_empty()
            || self.fixed_step.is_some()
            || self.stepper.properties().slopes_from_stepper_only
        {
            slope.copy_from_slice(self.stepper.derivative());
            return Ok(());
        }
        let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
        or_change(equations.derivatives(self.t, x, slope), slope)
    }

    /// Reads the right-hand side and the indicators after an event. The method continues if nothing has
    /// changed significantly, and otherwise restarts with a new step size. The test uses the states (`x_mid`
    /// contains those before the event), the slopes on both sides, and the indicators if one of them crossed.
    fn resume(&mut self, outcome: EventOutcome, cause: EventCause) -> Step<()> {
        let before = self.h;
        let on_zero = self.space.domains.crossed_on_zero();
        let Space { x, x_mid, weights, .. } = &*self.space;
        // Written so that a NaN counts as a change.
        let same_states = !outcome.states_changed || weights.distance(x, x, x_mid) < 1e-3;
        let reset = outcome.states_changed && x != x_mid;
        let mut is_unchanged = !self.evaluate_here(reset)? && same_states;
        if outcome.states_changed && self.sliding.step().is_some() && self.hold_at_zero()? {
            self.evaluate_here(true)?;
            is_unchanged = false;
        }
        // At the start, the first step is estimated after its events; fixed steps have no history.
        if before == 0.0 || self.fixed_step.is_some() {
            return Ok(());
        }
        is_unchanged =
            is_unchanged && !outcome.nominals_changed && (!cause.state || self.space.domains.unmoved());
        let Space { x, slope, weights, .. } = &*self.space;
        is_unchanged =
            is_unchanged && weights.are_close(x, self.stepper.derivative(), slope, SAME_SLOPE / before);
        if is_unchanged || (cause.state && on_zero) {
            is_unchanged &= self.goes_on_as_here(before)?;
        }
        if !is_unchanged {
            self.stats.restarts += 1;
            self.stepper.forget();
            if self.sliding.step().is_none() || self.stepper.properties().needs_second_derivative {
                self.estimate_step()?;
                self.h = self.h.min(before);
            }
        }
        Ok(())
    }

    /// Determines the right-hand side before a state event, at the time `before`. The trial of size `h` that
    /// ends at `end` has not been accepted yet. After this time, a right-hand side that depends on time may
    /// have switched.
    pub(super) fn take_slope_before(&mut self, before: f64, end: f64, h: f64) -> Step<()> {
        if self.space.x.is_empty() || self.fixed_step.is_some() {
            return Ok(());
        }
        let Space { x, x_mid, slope, weights, .. } = &mut *self.space;
        let before = before - self.time_tolerance;
        if before <= self.t || self.stepper.properties().slopes_from_stepper_only {
            slope.copy_from_slice(self.stepper.derivative());
            return Ok(());
        }
        self.stepper.interpolate(Trial { t: self.t, end, h, x }, (before - self.t) / h, x_mid);
        let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
        or_change(equations.derivatives(before, x_mid, slope), slope)
    }

    /// True if the right-hand side right after the event equals the one at the event, or differs only because
    /// the solution moves. A right-hand side that switches at the event may switch just after it. The new
    /// right-hand side is then used.
    fn goes_on_as_here(&mut self, h: f64) -> Step<bool> {
        let (behind, beyond) = (self.t + self.time_tolerance, self.t + 2.0 * self.time_tolerance);
        if self.space.x.is_empty() || beyond > self.end || self.stepper.properties().slopes_from_stepper_only
        {
            return Ok(true);
        }
        let Space { x, x_mid, x_new, slope, weights, .. } = &mut *self.space;
        let dx = self.stepper.derivative();
        let move_along = |to: &mut [f64], s: f64| {
            to.iter_mut().zip(x.iter().zip(dx)).for_each(|(to, (x, d))| *to = x + s * d);
        };
        let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
        move_along(x_mid, self.time_tolerance);
        or_change(equations.derivatives(behind, x_mid, x_new), x_new)?;
        if weights.are_close(x, dx, x_new, SAME_SLOPE / h) {
            return Ok(true);
        }
        // A change caused by the moving solution doubles at twice the distance; a switch does not.
        move_along(x_mid, 2.0 * self.time_tolerance);
        or_change(equations.derivatives(beyond, x_mid, slope), slope)?;
        if weights.distance(x, dx, slope) > 1.5 * weights.distance(x, dx, x_new) {
            return Ok(true);
        }
        if x_new.iter().all(|d| d.is_finite()) {
            move_along(x_mid, self.time_tolerance);
            self.stepper.evaluate(&mut equations, behind, x_mid).map_err(no_retreat)?;
        }
        Ok(false)
    }

    /// Evaluates the right-hand side and the event indicators at the current point. `reset`: an event has
    /// changed states here. Returns `true` if states were changed to satisfy the algebraic equations.
    pub(super) fn evaluate_here(&mut self, reset: bool) -> Step<bool> {
        let mut corrected = false;
        let space = &mut *self.space;
        if !space.x.is_empty() {
            let mut equations =
                Equations { system: &mut *self.system, weights: &space.weights, stats: &mut self.stats };
            let mut evaluated = self.stepper.evaluate(&mut equations, self.t, &space.x);
            if !space.x.iter().chain(self.stepper.derivative()).all(|v| v.is_finite()) {
                evaluated = evaluated.and(Err(CallError::Discard));
            }
            evaluated.map_err(|error| self.refused_here(error))?;
            let space = &mut *self.space;
            let mut equations =
                Equations { system: &mut *self.system, weights: &space.weights, stats: &mut self.stats };
            match self.stepper.make_consistent(&mut equations, self.t, &mut space.x).map_err(no_retreat)? {
                Consistency::Holds => {}
                Consistency::Corrected => {
                    corrected = true;
                    self.system.states_corrected(self.t, &space.x).map_err(no_retreat)?;
                }
                Consistency::Impossible { equation, residual } => {
                    return Err(ErrorKind::Inconsistent { equation, residual }.into());
                }
                Consistency::NoSlopes { equation, residual, is_singular } => {
                    return Err(ErrorKind::InconsistentSlopes { equation, residual, is_singular }.into());
                }
                Consistency::HigherIndex => return Err(ErrorKind::HigherIndex.into()),
            }
        }
        let space = &mut *self.space;
        if space.domains.len() > 0 {
            space.domains.forget();
            self.stats.event_indicators += 1;
            let read = read_indicators(self.system, self.t, &space.x, &mut space.domains.base);
            read.map_err(|error| self.refused_here(error))?;
            self.space.domains.begin_after_event(reset);
        }
        Ok(corrected)
    }

    /// Returns the step size of a system without states. No error is measured, so this step determines how
    /// often indicators that depend only on time are evaluated.
    pub(super) fn step_without_states(&self) -> f64 {
        (self.end - self.start) / 500.0
    }

    pub(super) fn estimate_step(&mut self) -> Step<()> {
        let span = self.end - self.start;
        let space = &mut *self.space;
        if self.fixed_step.is_some() {
            return Ok(());
        }
        if space.x.is_empty() {
            self.h = self.step_without_states();
            return Ok(());
        }
        let capacity = (self.target() - self.t).max(0.0).min(self.sliding.step().unwrap_or(f64::INFINITY));
        let space = &mut *self.space;
        let dx = self.stepper.derivative();
        let probe = probe_step(&space.weights, &space.x, dx, span).min(capacity);
        if probe.is_nan() || probe <= 0.0 {
            self.h = 1e-6 * span;
            return Ok(());
        }
        if self.stepper.properties().slopes_from_stepper_only {
            // As in DASSL: the step that changes the states by half their tolerances.
            let most = 0.5 / space.weights.norm(&space.x, dx);
            self.h = most.min(1e-3 * capacity);
            return Ok(());
        }
        for ((p, x), d) in space.x_mid.iter_mut().zip(&space.x).zip(dx) {
            *p = x + probe * d;
        }
        self.stats.right_hand_sides += 1;
        self.h = match self.system.derivatives(self.t + probe, &space.x_mid, &mut space.x_new) {
            Ok(()) => {
                let h = first_step(
                    &space.weights,
                    self.stepper.properties().order,
                    &space.x,
                    dx,
                    &space.x_new,
                    probe,
                );
                if self.sliding.step().is_some() {
                    // Over longer times, the right-hand side may switch.
                    self.stepper.begin_with(probe, &space.x_new);
                }
                h
            }
            Err(CallError::Discard) => 0.01 * probe,
            Err(CallError::Failed(error)) => return Err(error.into()),
        };
        if !self.h.is_finite() || self.h <= 0.0 {
            self.h = 0.01 * probe;
        }
        Ok(())
    }

    pub(super) fn read_nominals(&mut self) -> Step<()> {
        let space = &mut *self.space;
        self.system.nominals(&mut space.nominals).map_err(no_retreat)?;
        let (options, system) = (self.options, &*self.system);
        space.weights.set(options, &space.nominals, |i| system.is_unbounded(i));
        Ok(())
    }

    pub(super) fn take_event_time(&mut self, next: Option<f64>) -> Step<()> {
        if let Some(next) = next
            && (next.is_nan() || next < self.t - self.time_tolerance)
        {
            return Err(ErrorKind::EventInThePast(next).into());
        }
        self.next_time_event = next;
        Ok(())
    }

    /// Handles time events and input stops at the current instant for which the step did not end. The start
    /// or an event announced them for this instant, or they are too close to be separate targets. Returns
    /// `true` if there was an event. `is_evaluated`: the right-hand side is known here.
    pub(super) fn more_events_here(&mut self, is_evaluated: bool) -> Step<bool> {
        let mut any = false;
        let mut looks = 0;
        loop {
            let time = self.next_time_event.is_some_and(|next| next <= self.t + self.time_tolerance);
            let stop = self.input_stop.filter(|stop| stop.time <= self.t + self.time_tolerance);
            if let Some(stop) = stop {
                self.h = self.stepper.kink(self.h);
                self.input_stop = self.system.next_input_stop(stop.time);
            }
            let input = stop.is_some_and(|stop| stop.jump);
            looks += 1;
            if looks > ChatteringGuard::EVENTS {
                return Err(ErrorKind::TimeEventLoop(ChatteringGuard::EVENTS as u64).into());
            }
            if time || input {
                self.sample_left()?;
                self.take_slope(is_evaluated || any || self.stepper.properties().evaluates_ends)?;
                any = true;
                self.visit_event(EventCause { time, input, ..EventCause::default() })?;
            } else if stop.is_none() {
                return Ok(any);
            }
        }
    }
}
