//! Indicators that come back to zero within the first step after their event: a body that bounces less and less, or is
//! left behind the floor by its event, must not fall through the floor unseen.

use super::inside::Inside;
use super::step::Shrink;
use super::{ErrorKind, Run, Space, Step, no_retreat, read_indicators};
use crate::event::Slopes;
use crate::observer::Observer;
use crate::options::ChatteringPolicy;
use crate::stepper::{Stepper, Trial};
use crate::system::{CallError, CallResult, HybridSystem};

/// Slopes of indicators are told from rounding within this share of the span.
const SLOPE_REACH: f64 = 1e-3;

/// Whether an indicator next to zero at the start of a step leaves its domain and comes back within it.
pub(super) enum Return {
    Nothing,
    /// At this time it is in the other domain.
    Found(f64),
    /// It leads into the other domain at the start, and is in the domain where it began at the end, but no point of the
    /// step was found where it is in the other one. A step of this size may show it.
    Unseen {
        indicator: usize,
        shorter: Option<f64>,
    },
}

impl<S, M, O> Run<'_, S, M, O>
where
    S: HybridSystem + ?Sized,
    M: Stepper,
    O: Observer + ?Sized,
{
    /// Looks for such an indicator in the trial of size `h`. The slopes at its start decide; most often one evaluation of
    /// the indicators shows that those next to zero just go on. Those that slide count as having crossed at its end.
    pub(super) fn look_for_return(&mut self, end: f64, h: f64, ready: &mut bool) -> CallResult<Return> {
        if self.space.x.is_empty() {
            return Ok(Return::Nothing);
        }
        let Slopes { any, turned, .. } = self.find_slopes(true, end, h, ready)?;
        if any || turned.is_some() {
            for i in 0..self.space.domains.len() {
                if self.space.domains.slope(i).is_some() || turned == Some(i) {
                    self.space.domains.count_as_returned(i);
                }
            }
        }
        let mut first = f64::INFINITY;
        let Slopes { any, turned, .. } = self.find_slopes(false, end, h, ready)?;
        if any {
            for i in 0..self.space.domains.len() {
                match self.follow(i, end, h, ready)? {
                    Return::Nothing => {}
                    Return::Found(at) => first = first.min(at),
                    unseen @ Return::Unseen { .. } => return Ok(unseen),
                }
            }
        }
        Ok(match turned {
            Some(indicator) => Return::Unseen { indicator, shorter: None },
            None if first.is_finite() => Return::Found(first),
            None => Return::Nothing,
        })
    }

    /// The slopes of the indicators that began the trial next to zero, slide or do not, and may have come back in it.
    fn find_slopes(&mut self, slides: bool, end: f64, h: f64, ready: &mut bool) -> CallResult<Slopes> {
        if !self.space.domains.any_began_at_zero(slides) {
            return Ok(Slopes::default());
        }
        // With a mass matrix the right-hand side is not the slope of the states.
        let follows_trial = self.system.mass_matrix().is_some();
        if follows_trial {
            self.make_ready(end, h, ready)?;
        }
        let far = if follows_trial { h } else { self.end - self.t };
        let reach = far.min(h.max(SLOPE_REACH * (self.end - self.start)));
        let Space { x, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let found = domains.find_slopes((h, reach, far), slides, |s, z| {
            if follows_trial {
                stepper.interpolate(trial, s / h, x_mid);
            } else {
                move_along(x_mid, s, trial.x, stepper.derivative());
            }
            read_indicators(system, trial.t + s, x_mid, z)
        })?;
        self.stats.event_indicators += found.evaluations;
        Ok(found)
    }

    /// Follows such an indicator to where parabolas through its value and slope at the start turn, nearer and nearer to the
    /// start, until it is in the other domain.
    fn follow(&mut self, i: usize, end: f64, h: f64, ready: &mut bool) -> CallResult<Return> {
        let domains = &self.space.domains;
        let Some(slope) = domains.slope(i) else { return Ok(Return::Nothing) };
        let z_end = domains.end[i];
        let (first_turn, first_top) = domains.turn(i, (h, z_end));
        let reach = 8.0 * self.same * slope.abs().max((z_end - domains.base[i]).abs() / h);
        let is_inside = |turn: f64, s: f64| turn > 0.0 && turn < 0.99 * s;
        if domains.was_at_zero(i, reach) {
            self.space.domains.set_leaving(i);
        }
        if !is_inside(first_turn, h) {
            // It is still on its way.
            return Ok(Return::Nothing);
        }
        let (mut s, mut turn, mut top) = (h, first_turn, first_top);
        while is_inside(turn, s) && self.t + turn > self.t {
            self.make_ready(end, h, ready)?;
            let Space { x, x_mid, domains, .. } = &mut *self.space;
            let at = self.t + turn;
            // The very point that is looked at again.
            self.stepper.interpolate(Trial { t: self.t, end, h, x }, (at - self.t) / h, x_mid);
            self.stats.event_indicators += 1;
            let z = domains.value_at(i, |z| read_indicators(self.system, at, x_mid, z))?;
            if domains.leaves(i, z) {
                return Ok(Return::Found(at));
            }
            s = turn;
            (turn, top) = domains.turn(i, (s, z));
        }
        let domains = &self.space.domains;
        if !domains.leaves(i, top) && !domains.was_at_zero(i, reach) {
            // It turns before it reaches zero.
            return Ok(Return::Nothing);
        }
        let helps = self.fixed_step.is_none() && first_turn > self.same && domains.leaves(i, first_top);
        Ok(Return::Unseen { indicator: i, shorter: helps.then_some(first_turn) })
    }

    /// A trial of size `h` in which an indicator came back unseen: a shorter one, or the answer to chattering.
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

    /// After an event while indicators slide: where it has left one behind zero that goes back to zero, the states are moved
    /// to where it is zero, by as little as possible beside their sizes. `true`: some were.
    pub(super) fn hold_at_zero(&mut self) -> Step<bool> {
        let mut moved = false;
        for i in 0..self.space.domains.len() {
            if self.space.domains.is_behind(i) {
                match self.move_to_zero(i) {
                    Ok(()) => moved = true,
                    Err(CallError::Discard) => {}
                    Err(failed) => return Err(no_retreat(failed)),
                }
            }
        }
        Ok(moved)
    }

    /// One step of Newton's method.
    fn move_to_zero(&mut self, i: usize) -> CallResult<()> {
        let Space { x, x_mid, x_new: gradient, weights, domains, .. } = &mut *self.space;
        let (z0, t) = (domains.base[i], self.t);
        let step = 1e-3 * self.sliding.usual();
        move_along(x_mid, step, x, self.stepper.derivative());
        self.stats.event_indicators += 1 + x.len() as u64;
        let ahead = domains.value_at(i, |z| read_indicators(self.system, t + step, x_mid, z))?;
        if (ahead - z0) * z0.signum() >= 0.0 {
            return Ok(());
        }
        let mut sum = 0.0;
        for k in 0..x.len() {
            x_mid.copy_from_slice(x);
            x_mid[k] += f64::EPSILON.sqrt() * x[k].abs().max(weights.scale(k));
            let z = domains.value_at(i, |z| read_indicators(self.system, t, x_mid, z))?;
            let derivative = (z - z0) / (x_mid[k] - x[k]);
            gradient[k] = derivative * weights.scale(k) * weights.scale(k);
            sum += derivative * gradient[k];
        }
        if sum > 0.0 {
            let back = z0 - domains.next_to_zero(i, z0);
            x.iter_mut().zip(&*gradient).for_each(|(x, g)| *x -= back * g / sum);
        }
        Ok(())
    }
}

/// Where `x` is after the time `s` if it moves on as it does now.
fn move_along(to: &mut [f64], s: f64, x: &[f64], dx: &[f64]) {
    for ((to, x), d) in to.iter_mut().zip(x).zip(dx) {
        *to = x + s * d;
    }
}
