//! Looking inside a step that meets the tolerance: crossings of indicators, and the step that ends at one.

use super::step::{Shrink, Tried};
use super::{Run, Space, Step, U, kind_of, no_retreat, read_indicators};
use crate::observer::Observer;
use crate::stepper::{Equations, Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

/// So many repetitions of a step for one event; three are usual.
const MAX_REPETITIONS: u32 = 12;

/// What there was inside a step.
pub(super) enum Inside {
    Nothing,
    Crossing(Found),
    /// The step cannot stand; one of this size may.
    Again {
        h: f64,
        why: Shrink,
    },
}

/// Where a good step is cut.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    /// The point to go on from.
    pub(super) at: f64,
    /// End and size of the trial that the stepper holds now.
    pub(super) end: f64,
    pub(super) h: f64,
    /// An indicator has changed its domain there.
    pub(super) crossed: bool,
}

impl<S, M, O> Run<'_, S, M, O>
where
    S: HybridSystem + ?Sized,
    M: Stepper,
    O: Observer + ?Sized,
{
    /// Looks for the first crossing in the trial step and makes ready to sample in it; the state where the step is cut
    /// is in `x_new`, the indicators there are in `domains.end`.
    pub(super) fn look_inside(&mut self, end: f64, h: f64) -> Step<Inside> {
        let mut ready = false;
        self.space.domains.look();
        if self.sliding.step().is_some() {
            return self.slide_over(end, h);
        }
        let mut bracket = self.space.domains.changed().then_some(end);
        let points = if bracket.is_none() { self.interior_points(end) } else { 0 };
        for i in 0..points + self.space.domains.len() {
            if bracket.is_some() {
                break;
            }
            let at = if i < points {
                Some(self.t + h * (i + 1) as f64 / (points + 1) as f64)
            } else {
                self.space.domains.turning_point(i - points, self.t, end)
            };
            if let Some(at) = at.filter(|at| *at > self.t && *at < end) {
                match self.changed_at(at, end, h, &mut ready) {
                    Ok(found) => bracket = found,
                    Err(error) => return self.cannot_stand(h, error),
                }
            }
        }
        if bracket.is_none() {
            match self.right_behind_the_start(end, h, &mut ready) {
                Ok(found) => bracket = found,
                Err(error) => return self.cannot_stand(h, error),
            }
        }
        let sampled = self.space.sampler.due_before(self.times, end - self.same).is_some();
        if (bracket.is_some() || sampled || self.observer.wants_steps())
            && let Err(error) = self.make_ready(end, h, &mut ready)
        {
            return self.cannot_stand(h, error);
        }
        match bracket {
            Some(at) => self.locate(at, end, h),
            None => Ok(Inside::Nothing),
        }
    }

    /// Looks for a way out of a domain and back that is much shorter than the first step after an event: a ball that
    /// bounces less and less would fall through the floor there. The right end of what brackets it.
    fn right_behind_the_start(&mut self, end: f64, h: f64, ready: &mut bool) -> CallResult<Option<f64>> {
        let indicators = 0..self.space.domains.len();
        let leaves_zero = |i| self.space.domains.leaves_zero(i);
        if self.options.interior_samples == Some(0)
            || self.space.x.is_empty()
            || !indicators.clone().any(leaves_zero)
        {
            return Ok(None);
        }
        let mid = self.t + 0.5 * h;
        if mid <= self.t || mid >= end {
            return Ok(None);
        }
        if let Some(found) = self.changed_at(mid, end, h, ready)? {
            return Ok(Some(found));
        }
        let turn = indicators.filter_map(|i| self.space.domains.return_point(i, self.t, mid, end)).next();
        turn.map_or(Ok(None), |at| self.changed_at(at, end, h, ready))
    }

    /// While the solution slides a crossing counts where the step ends.
    fn slide_over(&mut self, end: f64, h: f64) -> Step<Inside> {
        let sampled = self.space.sampler.due_before(self.times, end - self.same).is_some();
        if (sampled || self.observer.wants_steps())
            && let Err(error) = self.make_ready(end, h, &mut false)
        {
            return self.cannot_stand(h, error);
        }
        let crossed = self.space.domains.changed();
        Ok(if crossed { Inside::Crossing(Found { at: end, end, h, crossed }) } else { Inside::Nothing })
    }

    /// At how many points inside the step the indicators are looked at whatever they were.
    fn interior_points(&self, end: f64) -> usize {
        let domains = &self.space.domains;
        if domains.len() == 0 {
            return 0;
        }
        let long = || {
            !self.space.x.is_empty()
                && (self.stepper.takes_long_steps()
                    || (self.fixed_step.is_none() && domains.growth(self.t, end).is_some_and(|g| g > 3.0)))
        };
        self.options.interior_samples.map_or_else(|| usize::from(long()), |k| k as usize)
    }

    /// Has the method interpolate inside the trial, once.
    fn make_ready(&mut self, end: f64, h: f64, ready: &mut bool) -> CallResult<()> {
        if !std::mem::replace(ready, true) {
            let Space { x, x_new, weights, .. } = &*self.space;
            let trial = Trial { t: self.t, end, h, x };
            let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
            self.stepper.prepare_interpolation(&mut equations, trial, x_new)?;
        }
        Ok(())
    }

    /// Looks at the indicators at a point inside the trial; the right end of what brackets an event.
    fn changed_at(&mut self, at: f64, end: f64, h: f64, ready: &mut bool) -> CallResult<Option<f64>> {
        self.make_ready(end, h, ready)?;
        let Space { x, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        self.stepper.interpolate(trial, (at - self.t) / h, x_mid);
        self.stats.event_indicators += 1;
        domains.changed_at(at, end, |t, z| read_indicators(self.system, t, x_mid, z))
    }

    fn cannot_stand(&mut self, h: f64, error: CallError) -> Step<Inside> {
        match error {
            CallError::Discard => Ok(Inside::Again { h: self.stepper.refused(h), why: Shrink::Refused }),
            CallError::Failed(e) => Err(kind_of(e).into()),
        }
    }

    /// Finds the first crossing up to `hi`, where `domains.end` was read.
    fn locate(&mut self, hi: f64, end: f64, h: f64) -> Step<Inside> {
        let Space { x, x_new, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        let tolerance = (100.0 * U * (self.t.abs() + h)).max(4.0 * U * end.abs());
        let for_jumps = if self.options.loose_jump_indicators { 1e-10 * self.t.abs().max(h) } else { 0.0 };
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let lo = domains.counts_since().unwrap_or(self.t);
        let found = domains.locate(lo, hi, (tolerance, for_jumps), |t, z| {
            stepper.interpolate(trial, (t - trial.t) / h, x_mid);
            read_indicators(system, t, x_mid, z)
        });
        let located = match found {
            Ok(located) => located,
            Err(error) => return self.cannot_stand(h, error),
        };
        self.stats.event_indicators += located.evaluations;
        // An event this close to the end of the step is one with whatever happens there.
        if end - located.time <= self.same {
            if located.time != end {
                self.stats.event_indicators += 1;
                read_indicators(system, end, x_new, &mut domains.end).map_err(no_retreat)?;
            }
            let crossed = domains.changed();
            return Ok(Inside::Crossing(Found { at: end, end, h, crossed }));
        }
        if self.stepper.repeats_step_at_event() {
            return self.polish(located.time, hi, tolerance);
        }
        stepper.interpolate(trial, (located.time - trial.t) / h, x_new);
        Ok(Inside::Crossing(Found { at: located.time, end, h, crossed: true }))
    }

    /// Repeats the step so that it ends at the event, because the method is more exact at the ends of its steps than
    /// inside them. The end of a repeated step is the event when the indicators have changed there and, by the interpolant
    /// of that very step (which is exact at its end), not before it to speak of.
    fn polish(&mut self, first_guess: f64, end: f64, tight: f64) -> Step<Inside> {
        let enough = tight.max(1e-3 * self.options.relative_tolerance * (end - self.t));
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
            let found = Found { at: guess, end: guess, h, crossed };
            if guess >= hi || rounds >= MAX_REPETITIONS {
                return Ok(Inside::Crossing(found));
            }
            let root = if crossed {
                hi = guess;
                self.root_between(lo, guess, guess, h, tight)
            } else {
                lo = guess;
                self.root_beyond(guess, hi, h, tight)
            };
            let root = match root {
                Ok(root) => root,
                Err(error) => return self.cannot_stand(h, error),
            };
            if crossed && guess - root <= enough {
                // The search has left the indicators of its own last point behind.
                let Space { x_new, domains, .. } = &mut *self.space;
                self.stats.event_indicators += 1;
                return match read_indicators(self.system, guess, x_new, &mut domains.end) {
                    Ok(()) => Ok(Inside::Crossing(found)),
                    Err(error) => self.cannot_stand(h, error),
                };
            }
            // Just behind the root, by more than it is still likely to move.
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

    /// The first crossing between `lo` and `hi` by the interpolant of the trial of size `h` that ends at `end`;
    /// `domains.end` holds the indicators at `hi`, of which at least one has changed.
    fn root_between(&mut self, lo: f64, hi: f64, end: f64, h: f64, tight: f64) -> CallResult<f64> {
        let Space { x, x_mid, domains, .. } = &mut *self.space;
        let lo = domains.counts_since().map_or(lo, |from| lo.max(from));
        let trial = Trial { t: self.t, end, h, x };
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let located = domains.locate(lo, hi, (tight, 0.0), |t, z| {
            stepper.interpolate(trial, (t - trial.t) / h, x_mid);
            read_indicators(system, t, x_mid, z)
        })?;
        self.stats.event_indicators += located.evaluations;
        Ok(located.time)
    }

    /// The first crossing after the end of the trial of size `h` by its interpolant, continued up to `hi` at most.
    fn root_beyond(&mut self, end: f64, hi: f64, h: f64, tight: f64) -> CallResult<f64> {
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
                return Ok(hi);
            }
            reach *= 32.0;
        }
    }
}
