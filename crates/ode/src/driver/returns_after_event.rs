//! Indicators that return to zero within the first step after their event. Examples are a body that bounces
//! less and less, and a body that its event leaves outside the domain.

use super::run::{Run, Space, Step, no_retreat, read_indicators};
use super::trial::{Inside, Return, Shrink};
use crate::error::ErrorKind;
use crate::event::SLOPE_STEP;
use crate::options::ChatteringPolicy;
use crate::stepper::{Equations, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

/// Slopes of indicators are distinguished from rounding within this fraction of the span.
const SLOPE_REACH: f64 = 1e-3;

/// Minimum length of a step, in time tolerances, that shows whether an indicator continues.
const RESOLVED: f64 = 100.0;

impl Run<'_> {
    /// Looks for an indicator that returns in the trial of size `h`. The slopes at the start of the trial
    /// decide. In most cases, one evaluation of the indicators shows that those near zero continue. Sliding
    /// indicators are handled at the end of the step.
    pub(super) fn look_for_return(&mut self, end: f64, h: f64, ready: &mut bool) -> CallResult<Return> {
        if self.space.x.is_empty() || !self.space.domains.any_may_return() {
            return Ok(Return::Nothing);
        }
        self.find_slopes(end, h, ready)?;
        let mut first = f64::INFINITY;
        for i in 0..self.space.domains.len() {
            match self.follow(i, end, h, ready)? {
                Return::Nothing => {}
                _ if self.space.domains.slides(i) => {}
                Return::Found(at) => first = first.min(at),
                unseen @ Return::Unseen { .. } => return Ok(unseen),
            }
        }
        Ok(if first.is_finite() { Return::Found(first) } else { Return::Nothing })
    }

    /// Computes the slopes of the indicators that may have returned in the trial.
    fn find_slopes(&mut self, end: f64, h: f64, ready: &mut bool) -> CallResult<()> {
        // With a mass matrix, the right-hand side is not the slope of the states.
        let follows_trial = self.system.mass_matrix().is_some();
        if follows_trial {
            self.make_ready(end, h, ready)?;
        }
        let far = if follows_trial { h } else { self.end - self.t };
        let reach = far.min(h.max(SLOPE_REACH * (self.end - self.start)));
        let Space { x, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let count = &mut self.stats.event_indicators;
        domains.find_slopes(h, reach, |s, z| {
            *count += 1;
            let (at, s) = later(trial.t, s);
            if follows_trial {
                stepper.interpolate(trial, s / h, x_mid);
            } else {
                move_along(x_mid, s, trial.x, stepper.derivative());
            }
            read_indicators(system, at, x_mid, z)
        })
    }

    /// Returns a bouncing indicator whose located crossing contradicts the right-hand side there. Positions
    /// and speeds then differ by more than such small bounces allow, because of rounding or within the
    /// tolerance.
    pub(super) fn contradiction(&mut self, at: f64) -> CallResult<Option<usize>> {
        let h = at - self.t;
        let reach = h.max(SLOPE_REACH * (self.end - self.start));
        for i in 0..self.space.domains.len() {
            // With a mass matrix, the right-hand side is not the slope of the states.
            if !self.space.domains.crosses_in_bounces(i) || self.system.mass_matrix().is_some() {
                continue;
            }
            let Space { x_new, x_mid, slope, weights, domains, .. } = &mut *self.space;
            let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
            equations.derivatives(at, x_new, slope)?;
            let (system, count) = (&mut *self.system, &mut self.stats.event_indicators);
            let z = domains.end[i];
            let found = domains.slope_along(i, z, SLOPE_STEP * h, reach, &mut |s, z: &mut [f64]| {
                *count += 1;
                let (at, s) = later(at, s);
                move_along(x_mid, s, x_new, slope);
                read_indicators(system, at, x_mid, z)
            })?;
            if domains.contradicts(i, found) {
                return Ok(Some(i));
            }
        }
        Ok(None)
    }

    /// Follows an indicator to the turning point of the parabola through its value and slope at the start.
    /// Repeats this nearer and nearer to the start until the indicator is in the other domain.
    fn follow(&mut self, i: usize, end: f64, h: f64, ready: &mut bool) -> CallResult<Return> {
        let Some(slope) = self.space.domains.slope(i) else { return Ok(Return::Nothing) };
        if let Some(step) = self.space.domains.step_of_slope(i, h) {
            let shorter =
                Some(step).filter(|step| self.fixed_step.is_none() && *step > RESOLVED * self.time_tolerance);
            let lost = self.space.domains.is_lost(i);
            return Ok(if lost { Return::Unseen { indicator: i, shorter } } else { Return::Nothing });
        }
        let is_inside = |turn: f64, s: f64| turn > 0.0 && turn < 0.99 * s;
        let mut shorter = None;
        if slope != 0.0 {
            let (mut s, z_end) = (h, self.space.domains.end[i]);
            let (mut turn, top) = self.space.domains.turn(i, s, z_end);
            let helps =
                self.fixed_step.is_none() && turn > self.time_tolerance && self.space.domains.leaves(i, top);
            shorter = helps.then_some(turn).filter(|turn| is_inside(*turn, h));
            while is_inside(turn, s) && self.t + turn > self.t {
                self.make_ready(end, h, ready)?;
                let Space { x, x_mid, domains, .. } = &mut *self.space;
                let at = self.t + turn;
                // Later evaluations of this point use the same expression, so rounding is equal.
                self.stepper.interpolate(Trial { t: self.t, end, h, x }, (at - self.t) / h, x_mid);
                self.stats.event_indicators += 1;
                let z = domains.value_at(i, |z| read_indicators(self.system, at, x_mid, z))?;
                if domains.leaves(i, z) {
                    return Ok(Return::Found(at));
                }
                s = turn;
                (turn, _) = domains.turn(i, s, z);
            }
        }
        let lost = self.space.domains.is_lost(i);
        Ok(if lost { Return::Unseen { indicator: i, shorter } } else { Return::Nothing })
    }

    /// Handles a trial of size `h` in which an indicator returned unseen: a shorter step, or the chattering
    /// policy.
    pub(super) fn unseen(&mut self, indicator: usize, shorter: Option<f64>, h: f64) -> Step<Inside> {
        self.stepper.refused(h);
        let h = match shorter {
            Some(h) => h,
            None if self.options.chattering == ChatteringPolicy::Slide && self.fixed_step.is_none() => {
                self.space.domains.slide(indicator);
                self.stats.chattering += 1;
                self.sliding.begin()
            }
            None => return Err(ErrorKind::EventsAccumulate { indicator }.into()),
        };
        Ok(Inside::Again { h, why: Shrink::Returned })
    }

    /// Holds indicators at zero after an event while indicators slide. `x_mid` contains the states before the
    /// event. If the event left an indicator beyond zero without letting it pass, its change is scaled until
    /// the indicator returns. States that the event did not change are not moved. Returns `true` if states
    /// were moved.
    pub(super) fn hold_at_zero(&mut self) -> Step<bool> {
        let Space { x, x_mid, jump, .. } = &mut *self.space;
        jump.iter_mut().zip(x.iter().zip(&*x_mid)).for_each(|(jump, (x, before))| *jump = x - before);
        let mut moved = false;
        for i in 0..self.space.domains.len() {
            if self.space.domains.is_behind(i) {
                let share = match self.share_to_zero(i) {
                    Ok(share) => share,
                    Err(CallError::Discard) => continue,
                    Err(failed) => return Err(no_retreat(failed)),
                };
                let Space { x, jump, .. } = &mut *self.space;
                if let Some(share) = share {
                    x.iter_mut().zip(&*jump).for_each(|(x, jump)| *x += share * jump);
                    moved = true;
                }
            }
        }
        Ok(moved)
    }

    /// Returns the multiple of the event's change that brings indicator `i` back to zero when it is added
    /// again. If the indicator depends on a changed state, it returns at once. If only its slope does (a body
    /// that bounces), it returns along the flow. `None` if nothing is needed, or if the event has let the
    /// indicator pass, which then no longer slides.
    fn share_to_zero(&mut self, i: usize) -> CallResult<Option<f64>> {
        let Space { x, x_mid, x_new, jump, slope: before, domains, weights, .. } = &mut *self.space;
        let (z0, t, step) = (domains.base[i], self.t, self.sliding.usual());
        let dx = self.stepper.derivative();
        let system = &mut *self.system;
        let count = &mut self.stats.event_indicators;
        let mut change_along = |system: &mut dyn HybridSystem, s: f64, dx: &[f64]| {
            *count += 1;
            let (at, s) = later(t, s);
            move_along(x_mid, s, x, dx);
            domains.value_at(i, |z| read_indicators(system, at, x_mid, z)).map(|z| z - z0)
        };
        let mut slope_along = |dx: &[f64]| {
            let half = change_along(system, 0.5 * step, dx)?;
            Ok((4.0 * half - change_along(system, step, dx)?) / step)
        };
        let (after, before) = (slope_along(dx)?, slope_along(before)?);
        // The states before the event.
        move_along(x_mid, -1.0, x, jump);
        self.stats.event_indicators += 1;
        let by_event = z0 - domains.value_at(i, |z| read_indicators(self.system, t, x_mid, z))?;
        if domains.passes(i, after, before) {
            domains.release(i);
            return Ok(None);
        }
        if by_event != 0.0 {
            let share = (domains.next_to_zero(i, z0) - z0) / by_event;
            return Ok(Some(share).filter(|share| share.abs() <= 1.0));
        }
        let mut equations = Equations { system: &mut *self.system, weights, stats: &mut self.stats };
        let (at, s) = later(t, step);
        move_along(x_mid, s, x, dx);
        equations.derivatives(at, x_mid, x_new)?;
        x_new.iter_mut().zip(dx).for_each(|(d, dx)| *d = 0.5 * (*d + dx));
        move_along(x_mid, s, x, x_new);
        self.stats.event_indicators += 1;
        let z1 = domains.value_at(i, |z| read_indicators(self.system, at, x_mid, z))?;
        let curvature = 2.0 * (z1 - z0 - s * after) / (s * s);
        Ok(domains.share_of_bounce(i, step, [before, after, curvature]))
    }
}

/// Returns the time `s` after `t`, and the actual difference. The resolution of times is coarse far from
/// zero.
pub(super) fn later(t: f64, s: f64) -> (f64, f64) {
    (t + s, t + s - t)
}

/// Computes the states after the time `s` if `x` moves with constant slopes.
pub(super) fn move_along(to: &mut [f64], s: f64, x: &[f64], dx: &[f64]) {
    for ((to, x), d) in to.iter_mut().zip(x).zip(dx) {
        *to = x + s * d;
    }
}
