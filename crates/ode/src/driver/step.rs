//! One step: its size, the trial, and a smaller step if the trial failed.

use super::run::{Run, Space, Step, U, read_indicators};
use super::trial::{Shrink, Tried};
use crate::error::ErrorKind;
use crate::stepper::{Attempt, Equations, Trial};
use crate::system::{CallError, CallResult};

/// Maximum number of consecutive refused points in a run.
const MAX_DISCARDS: u32 = 12;

impl Run<'_> {
    /// Returns the next instant at which a step must end exactly: the end, a time event, or a kink or jump of
    /// an input.
    pub(super) fn target(&self) -> f64 {
        let mut target = self.end;
        for stop in [self.next_time_event, self.input_stop.map(|s| s.time)].into_iter().flatten() {
            if stop > self.t + self.time_tolerance && stop < target - self.time_tolerance {
                target = stop;
            }
        }
        target
    }

    /// Returns the step to try. The proposal of the controller is shortened or extended so that no tiny step
    /// remains before the target.
    pub(super) fn step_towards(&mut self, target: f64) -> f64 {
        let remaining = target - self.t;
        if let Some(step) = self.fixed_step {
            // Grid points are start + k * step, not sums, and events do not shift them. The current grid
            // point, up to rounding, is not the next one.
            let mut k = ((self.t - self.start) / step).floor() + 1.0;
            while self.start + k * step <= self.t + self.time_tolerance {
                k += 1.0;
            }
            let grid = self.start + k * step;
            let h = if grid >= target - self.time_tolerance { remaining } else { grid - self.t };
            let is_second_half = self.middle.take() == Some(self.t);
            if !self.options.halve_steps || is_second_half || h <= 8.0 * self.time_tolerance {
                return h;
            }
            self.middle = Some(self.t + 0.5 * h);
            return 0.5 * h;
        }
        if self.space.x.is_empty() && self.space.domains.len() == 0 {
            return remaining;
        }
        let h = self.sliding.step().unwrap_or(self.h).min(self.options.max_step.unwrap_or(f64::INFINITY));
        let h = h.max(self.least_step());
        if remaining < 1.1 * h && (self.options.max_step.is_none_or(|m| remaining <= m)) {
            remaining
        } else if remaining < 2.0 * h {
            0.5 * remaining
        } else {
            h
        }
    }

    /// Smallest meaningful step of an adaptive method. In a smaller step, rounding moves the end by more than
    /// a fraction of the step.
    fn least_step(&self) -> f64 {
        16.0 * U * self.t.abs().max(1e-6 * (self.end - self.start))
    }

    /// Tries the step and reads the event indicators at its end.
    pub(super) fn attempt(&mut self, end: f64, h: f64) -> Step<Tried> {
        let space = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x: &space.x };
        let mut equations =
            Equations { system: &mut *self.system, weights: &space.weights, stats: &mut self.stats };
        let tried = self.stepper.try_step(&mut equations, trial, &mut space.x_new);
        match tried {
            Ok(Attempt::Good) => {}
            Ok(Attempt::TooInexact { h }) => {
                self.worst_state = space.weights.worst(&space.x, &space.x_new, self.stepper.error());
                return Ok(Tried::Again { h, why: Shrink::TooInexact });
            }
            Ok(Attempt::NotSolved { h }) => return Ok(Tried::Again { h, why: Shrink::NotSolved }),
            Err(error) => return self.refused(h, error),
        }
        if space.domains.len() > 0 {
            self.stats.event_indicators += 1;
            if let Err(error) = read_indicators(self.system, end, &space.x_new, &mut space.domains.end) {
                return self.refused(h, error);
            }
        }
        Ok(Tried::Good)
    }

    /// Reports a point of a trial of size `h` that could not be evaluated. Requests a smaller step unless the
    /// model has failed.
    pub(super) fn refused(&mut self, h: f64, error: CallError) -> Step<Tried> {
        match error {
            CallError::Discard => Ok(Tried::Again { h: self.stepper.refused(h), why: Shrink::Refused }),
            CallError::Failed(error) => Err(error.into()),
        }
    }

    /// Continues with a smaller step. Returns an error if the step would be too small.
    pub(super) fn shrink(&mut self, h: f64, why: Shrink) -> Step<()> {
        self.stats.rejected_steps += 1;
        let discarded = why == Shrink::Refused;
        if why != Shrink::TooInexact {
            self.worst_state = None;
        }
        self.discards += u32::from(discarded);
        let hopeless = self.fixed_step.is_some() || (discarded && self.discards > MAX_DISCARDS);
        if h < self.least_step() || hopeless {
            return Err(match why {
                Shrink::NotSolved => ErrorKind::NoConvergence.into(),
                _ => ErrorKind::StepTooSmall { discarded }.into(),
            });
        }
        self.h = h;
        self.sliding.shrink(h);
        Ok(())
    }

    /// Prepares the interpolation inside the trial, once.
    pub(super) fn make_ready(&mut self, end: f64, h: f64, ready: &mut bool) -> CallResult<()> {
        if !std::mem::replace(ready, true) {
            let Space { x, x_new, weights, .. } = &*self.space;
            let trial = Trial { t: self.t, end, h, x };
            let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
            self.stepper.prepare_interpolation(&mut equations, trial, x_new)?;
        }
        Ok(())
    }
}
