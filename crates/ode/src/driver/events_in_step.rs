//! Event location inside a step that meets the tolerance, and shortening of the step to end at the event.

use super::run::{Run, Space, Step, U, no_retreat, read_indicators};
use super::trial::{Found, Inside, Return, Shrink, Tried};
use crate::observer::Observer;
use crate::stepper::{StepWithEvent, Trial};
use crate::system::{CallError, CallResult};

/// Maximum number of repetitions of a step for one event; three are usual.
const MAX_REPETITIONS: u32 = 12;

/// Maximum number of searches for the turning point of an indicator in a step. Each must be nearer to zero by
/// a factor of four, or the search ends.
const MAX_TURNS: u32 = 5;

/// Maximum number of additional points in a step at which the indicators are evaluated. They are used if the
/// known values do not show how the indicators change between them.
const MAX_LOOKS: u32 = 32;

impl Run<'_> {
    /// Finds the first crossing in the trial step and prepares the interpolation for samples. Afterwards,
    /// `x_new` contains the state at which the step is cut, and `domains.end` the indicators there.
    pub(super) fn look_inside(&mut self, end: f64, h: f64) -> Step<Inside> {
        let mut ready = false;
        self.space.domains.look();
        let behind = match self.look_for_return(end, h, &mut ready) {
            Ok(Return::Nothing) => None,
            Ok(Return::Found(at)) => Some(at),
            Ok(Return::Unseen { indicator, shorter }) => return self.unseen(indicator, shorter, h),
            Err(error) => return self.discard_or_fail(h, error),
        };
        let bracket = match self.bracket(behind, end, h, &mut ready) {
            Ok(bracket) => bracket,
            Err(error) => return self.discard_or_fail(h, error),
        };
        let sampled = self.space.sampler.due_before(self.times, end - self.time_tolerance).is_some();
        if (bracket.is_some() || sampled || self.observer.needs_steps() || self.observer.needs_outputs())
            && let Err(error) = self.make_ready(end, h, &mut ready)
        {
            return self.discard_or_fail(h, error);
        }
        let Some(at) = bracket else { return Ok(Inside::Nothing) };
        let inside = self.locate(at, end, h)?;
        let Inside::Crossing(Found { at, h, .. }) = inside else { return Ok(inside) };
        match self.contradiction(at) {
            Ok(None) => Ok(inside),
            Ok(Some(indicator)) => self.unseen(indicator, None, h),
            Err(error) => self.discard_or_fail(h, error),
        }
    }

    /// Returns the right end of a bracket of the first event in the trial, or of one of the first. The
    /// indicators are evaluated at the time `behind` of a return. They are also evaluated at interior points,
    /// if these are requested or the step is long, and where the indicators may have turned.
    fn bracket(
        &mut self,
        behind: Option<f64>,
        end: f64,
        h: f64,
        ready: &mut bool,
    ) -> CallResult<Option<f64>> {
        let requested = self.options.interior_samples.is_some();
        let points = if requested || !self.space.domains.changed() { self.interior_points() } else { 0 };
        let start = self.t;
        let inside = (1..=points).map(|i| start + h * i as f64 / (points + 1) as f64);
        for at in behind.into_iter().chain(inside) {
            if self.changed_at(at, end, h, ready)? {
                return Ok(Some(at));
            }
        }
        let mut left = if requested || points == 0 { 0 } else { MAX_LOOKS };
        let mut has_changed = self.space.domains.changed();
        for i in 0..self.space.domains.len() {
            if !has_changed && self.space.domains.keeps_clear(i, start, end) {
                continue;
            }
            loop {
                for _ in 0..MAX_TURNS {
                    if has_changed {
                        return Ok(Some(end));
                    }
                    let Some(at) = self.space.domains.turning_point(i, start, end) else { break };
                    if self.changed_at(at, end, h, ready)? {
                        return Ok(Some(at));
                    }
                    has_changed = self.space.domains.changed();
                }
                if left == 0 {
                    break;
                }
                let Some(at) = self.space.domains.unresolved(i, start, end, h / 32.0) else { break };
                left -= 1;
                if self.changed_at(at, end, h, ready)? {
                    return Ok(Some(at));
                }
                has_changed = self.space.domains.changed();
            }
        }
        Ok(has_changed.then_some(end))
    }

    /// Number of points inside the step at which the indicators are always evaluated.
    fn interior_points(&self) -> usize {
        if self.space.domains.len() == 0 {
            return 0;
        }
        let by_default =
            || if self.space.x.is_empty() { 0 } else { self.stepper.properties().interior_samples };
        self.options.interior_samples.unwrap_or_else(by_default) as usize
    }

    /// Evaluates the indicators at a point inside the trial, unless changes count only from a later point.
    /// Returns `true` if an indicator has an event before this point.
    fn changed_at(&mut self, at: f64, end: f64, h: f64, ready: &mut bool) -> CallResult<bool> {
        let since = self.space.domains.counts_since().unwrap_or(self.t);
        if at <= since || at >= end {
            return Ok(false);
        }
        self.make_ready(end, h, ready)?;
        let Space { x, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        self.stepper.interpolate(trial, (at - self.t) / h, x_mid);
        self.stats.event_indicators += 1;
        domains.changed_at(at, |t, z| read_indicators(self.system, t, x_mid, z))
    }

    fn discard_or_fail(&mut self, h: f64, error: CallError) -> Step<Inside> {
        match error {
            CallError::Discard => Ok(Inside::Again { h: self.stepper.refused(h), why: Shrink::Refused }),
            CallError::Failed(error) => Err(error.into()),
        }
    }

    /// Finds the first crossing up to `hi`, at which `domains.end` was read.
    fn locate(&mut self, hi: f64, end: f64, h: f64) -> Step<Inside> {
        let Space { x, x_new, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        // An event near requested times must be within the time tolerance of them.
        let tolerance =
            (100.0 * U * (self.t.abs() + h)).max(4.0 * U * end.abs()).min(0.25 * self.time_tolerance);
        let for_jumps = if self.options.loose_jump_indicators { 1e-10 * self.t.abs().max(h) } else { 0.0 };
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let lo = domains.counts_since().unwrap_or(self.t);
        let found = domains.locate(lo, hi, tolerance, for_jumps, |t, z| {
            stepper.interpolate(trial, (t - trial.t) / h, x_mid);
            read_indicators(system, t, x_mid, z)
        });
        let located = match found {
            Ok(located) => located,
            Err(error) => return self.discard_or_fail(h, error),
        };
        self.stats.event_indicators += located.evaluations;
        // An event this close to the end of the step is merged with the events there.
        if end - located.time <= self.time_tolerance {
            if located.time != end {
                self.stats.event_indicators += 1;
                read_indicators(system, end, x_new, &mut domains.end).map_err(no_retreat)?;
            }
            let before = domains.changed().then_some(located.before);
            return Ok(Inside::Crossing(Found { at: end, end, h, before }));
        }
        match self.stepper.properties().step_with_event {
            StepWithEvent::RepeatedToIt => return self.polish(located.time, hi, tolerance),
            StepWithEvent::RepeatedToBefore if located.before - self.t > self.time_tolerance => {
                return self.step_to_before(located.before, located.time);
            }
            _ => {}
        }
        stepper.interpolate(trial, (located.time - trial.t) / h, x_new);
        Ok(Inside::Crossing(Found { at: located.time, end, h, before: Some(located.before) }))
    }

    /// Repeats the step so that it ends just before the first event. The interpolant of the repeated step
    /// covers the remaining time, which is below the resolution of times. If this does not reach the event,
    /// the step ends without one.
    fn step_to_before(&mut self, before: f64, time: f64) -> Step<Inside> {
        let h = before - self.t;
        self.stepper.repeat();
        match self.attempt(before, h)? {
            Tried::Good => {}
            Tried::Again { h, why } => return Ok(Inside::Again { h, why }),
        }
        if let Err(error) = self.make_ready(before, h, &mut false) {
            return self.discard_or_fail(h, error);
        }
        if self.space.domains.changed() {
            // The better solution has the event earlier. The difference decreases with each repetition.
            return self.locate(before, before, h);
        }
        let Space { x, x_new, x_mid, domains, .. } = &mut *self.space;
        self.stepper.interpolate(Trial { t: self.t, end: before, h, x }, (time - self.t) / h, x_mid);
        self.stats.event_indicators += 1;
        if let Err(error) = read_indicators(self.system, time, x_mid, &mut domains.end) {
            return self.discard_or_fail(h, error);
        }
        if domains.changed() {
            std::mem::swap(x_new, x_mid);
            return Ok(Inside::Crossing(Found { at: time, end: before, h, before: Some(before) }));
        }
        self.stats.event_indicators += 1;
        match read_indicators(self.system, before, x_new, &mut domains.end) {
            Ok(()) => Ok(Inside::Crossing(Found { at: before, end: before, h, before: None })),
            Err(error) => self.discard_or_fail(h, error),
        }
    }

    /// Repeats the step so that it ends at the event, because the method is more accurate at the ends of its
    /// steps than inside them. The end of a repeated step is the event under two conditions. The indicators
    /// have changed there, and they have not changed significantly before it by the interpolant of that step.
    /// This interpolant is exact at its end.
    fn polish(&mut self, first_guess: f64, end: f64, tight: f64) -> Step<Inside> {
        let enough = tight.max(1e-3 * self.options.rtol_or_like() * (end - self.t));
        let (mut lo, mut hi) = (self.t, end);
        let mut guess = (first_guess + tight).min(end);
        let mut rounds = 0;
        loop {
            rounds += 1;
            let h = guess - self.t;
            self.stepper.repeat();
            match self.attempt(guess, h)? {
                Tried::Good => {}
                Tried::Again { h, why } => return Ok(Inside::Again { h, why }),
            }
            let crossed = self.space.domains.changed();
            let found = |before: f64| Found { at: guess, end: guess, h, before: crossed.then_some(before) };
            if guess >= hi || rounds >= MAX_REPETITIONS {
                return Ok(Inside::Crossing(found(lo.max(guess - 8.0 * enough))));
            }
            let root = if crossed {
                hi = guess;
                self.root_between(lo, guess, guess, h, tight)
            } else {
                lo = guess;
                self.root_beyond(guess, hi, h, tight)
            };
            let (before, root) = match root {
                Ok(root) => root,
                Err(error) => return self.discard_or_fail(h, error),
            };
            if crossed && guess - root <= enough {
                // The search overwrote the indicators with the values at its last point.
                let Space { x_new, domains, .. } = &mut *self.space;
                self.stats.event_indicators += 1;
                return match read_indicators(self.system, guess, x_new, &mut domains.end) {
                    Ok(()) => Ok(Inside::Crossing(found(before))),
                    Err(error) => self.discard_or_fail(h, error),
                };
            }
            // Just after the root, by more than the root is likely to move.
            let shift = (root - guess).abs();
            guess = (root + tight + 1e-2 * shift).min(hi);
            if guess <= lo {
                guess = (lo + tight).min(hi);
            }
            if rounds + 1 >= MAX_REPETITIONS {
                guess = hi;
            }
        }
    }

    /// Returns a bracket of the first crossing between `lo` and `hi`, from the interpolant of the trial of
    /// size `h` that ends at `end`. `domains.end` contains the indicators at `hi`, at least one of which has
    /// changed.
    fn root_between(&mut self, lo: f64, hi: f64, end: f64, h: f64, tight: f64) -> CallResult<(f64, f64)> {
        let Space { x, x_mid, domains, .. } = &mut *self.space;
        let lo = domains.counts_since().map_or(lo, |from| lo.max(from));
        let trial = Trial { t: self.t, end, h, x };
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let located = domains.locate(lo, hi, tight, 0.0, |t, z| {
            stepper.interpolate(trial, (t - trial.t) / h, x_mid);
            read_indicators(system, t, x_mid, z)
        })?;
        self.stats.event_indicators += located.evaluations;
        Ok((located.before, located.time))
    }

    /// Returns the first crossing after the end of the trial of size `h`. The interpolant of the trial is
    /// extrapolated in growing steps, up to a little more than 0.1 `h` and at most up to `hi`. If no crossing
    /// is found, returns a guess between the end and `hi`: the geometric mean of both step sizes.
    fn root_beyond(&mut self, end: f64, hi: f64, h: f64, tight: f64) -> CallResult<(f64, f64)> {
        let mut reach = tight;
        loop {
            let at = (end + reach).min(hi);
            let Space { x, x_mid, domains, .. } = &mut *self.space;
            self.stepper.interpolate(Trial { t: self.t, end, h, x }, (at - self.t) / h, x_mid);
            self.stats.event_indicators += 1;
            read_indicators(self.system, at, x_mid, &mut domains.end)?;
            if domains.changed() {
                return self.root_between(end, at, end, h, tight);
            }
            if at >= hi || reach > 0.1 * h {
                return Ok((end, self.t + (h * (hi - self.t)).sqrt()));
            }
            reach *= 32.0;
        }
    }
}
