//! Indicators that are near zero when a step begins, and may leave their domain and return within it.

use super::domains::{CLEAN_STEPS, Domains, SinceEvent, flipped, is_behind};
use crate::system::CallResult;
use crate::system::Direction;

/// Step of the differences for the slopes of indicators, as a fraction of the step of the method.
pub(crate) const SLOPE_STEP: f64 = 1.0 / 256.0;

/// Number of shorter differences to try if the indicators are not linear over that distance, each an eighth
/// of the one before. An indicator may turn many times in a step.
const SHORTER: i32 = 4;

/// Indicators below this fraction of their largest value so far are small. If events repeatedly turn a small
/// indicator back to zero, these may be the last of its bounces.
pub(super) const SMALL: f64 = 0.1;

/// Minimum fraction of an indicator's change in the step that the flow at the start must produce, after an
/// event that changed states. The indicator then continues. Otherwise, the event may have stopped it, and the
/// rest of its slope may be rounding.
const GOES_ON: f64 = 1.0 / 16.0;

impl Domains {
    /// Updates the indicators after an event. Indicators that crossed and are still near zero may have turned
    /// back. `reset`: the event has changed states.
    pub(crate) fn begin_after_event(&mut self, reset: bool) {
        for i in 0..self.len() {
            let leaves_origin = self.crossings[i] != 0 && (self.crossings[i] < 0) == self.from_above[i];
            if leaves_origin {
                self.resets[i] = reset || self.is_held(i);
            }
            let (z, near) = (self.base[i], self.near_zero[i]);
            self.largest[i] = self.largest[i].max(z.abs());
            let beyond = |size: f64| if self.from_above[i] { -size } else { size };
            let depth = match self.crossings[i] {
                0 => self.since_event[i].depth(),
                // A sliding indicator is at its value at the end of the step.
                _ if self.slides(i) => Some(beyond(z.abs())),
                _ => Some(beyond(z.abs() + near)).filter(|_| z.abs() <= near),
            };
            let stays = depth.is_some_and(|depth| is_behind(depth, z) && z.abs() <= depth.abs());
            self.since_event[i] = match depth {
                Some(depth) if stays && self.crossings[i] != 0 => SinceEvent::New { depth },
                _ if stays => self.since_event[i],
                _ => SinceEvent::Settled,
            };
        }
        self.is_calm = false;
    }

    /// Updates the indicators after a step, with or without events at its end. Indicators seen in the domain
    /// they came from are settled. The others have not been seen to continue.
    pub(crate) fn settle(&mut self) {
        for (largest, z) in self.largest.iter_mut().zip(&self.end) {
            *largest = if z.abs() > *largest { z.abs() } else { *largest };
        }
        if self.is_calm {
            return;
        }
        let mut is_calm = true;
        for i in 0..self.len() {
            let (z, depth) = (self.end[i], self.since_event[i].depth());
            let came_back = depth.is_some_and(|depth| !is_behind(depth, z));
            self.bounces[i] = (self.bounces[i] || came_back) && z.abs() <= SMALL * self.largest[i];
            if self.crossings[i] == 0 {
                self.since_event[i] = match depth {
                    // The flow leads on, but not yet beyond the error of the event location.
                    Some(depth) if !came_back && self.onward[i] => SinceEvent::New { depth },
                    Some(depth) if !came_back => SinceEvent::TurnedBack { depth },
                    _ => SinceEvent::Settled,
                };
            }
            self.onward[i] = false;
            is_calm &= self.since_event[i] == SinceEvent::Settled && !self.bounces[i] && !self.slides(i);
        }
        self.is_calm = is_calm;
    }

    /// True if indicator `i` crosses in the step and has been near zero since an event turned it back.
    pub(crate) fn crosses_in_bounces(&self, i: usize) -> bool {
        self.bounces[i] && self.is_located(i, self.reference()[i], self.end[i])
    }

    /// True if this slope of indicator `i` is opposite to its crossing.
    pub(crate) fn contradicts(&self, i: usize, slope: f64) -> bool {
        if self.end[i] > 0.0 { slope < 0.0 } else { slope > 0.0 }
    }

    /// Returns the slope of indicator `i`, whose current value is `z0`, along the flow. `evaluate(s, z)`
    /// computes the indicators after the time `s` along the current flow. The slope is a difference over the
    /// time `step`. If the indicator is not straight over that time, shorter times are tried, then longer
    /// times up to `reach`. Returns 0 if no time is suitable.
    pub(crate) fn slope_along(
        &mut self,
        i: usize,
        z0: f64,
        step: f64,
        reach: f64,
        evaluate: &mut impl FnMut(f64, &mut [f64]) -> CallResult<()>,
    ) -> CallResult<f64> {
        let shorter = (0..=SHORTER).map(|k| step * 8f64.powi(-k));
        let longer = (1..).map(|k| step * 8f64.powi(k)).take_while(|s| 4.0 * s <= reach);
        for s in shorter.filter(|s| 4.0 * s <= reach).chain(longer) {
            let mut change = |s: f64| {
                evaluate(s, &mut self.mid)?;
                Ok(self.mid[i] - z0)
            };
            // Otherwise the difference is rounding.
            let is_twice = |d2: f64, d1: f64| d2 != 0.0 && (d2 - 2.0 * d1).abs() <= 0.25 * d2.abs();
            let (d1, d2) = (change(s)?, change(2.0 * s)?);
            if is_twice(d2, d1) && is_twice(change(4.0 * s)?, d2) {
                return Ok((4.0 * d1 - d2) / (2.0 * s));
            }
        }
        Ok(0.0)
    }

    /// True if indicator `i` may have left its domain and returned in the trial. It is still next to zero
    /// after its event, or starts next to zero and the time before the step is unknown.
    fn may_return(&self, i: usize) -> bool {
        let (z0, z2) = (self.base[i], self.end[i]);
        let may = match self.since_event[i].depth() {
            None => self.before_time.is_none() && z0.abs() < 1e-3 * z2.abs(),
            Some(depth) => is_behind(depth, z0),
        };
        may && z0 != z2 && !flipped(z0, z2) && !self.is_held(i)
    }

    /// True if any indicator [may have returned](Self::may_return).
    pub(crate) fn any_may_return(&self) -> bool {
        !(self.is_calm && self.before_time.is_some()) && (0..self.len()).any(|i| self.may_return(i))
    }

    /// Computes the slopes of these indicators at the start of the step of size `h`, if they point out of the
    /// domain. The slopes are differences along the flow: `evaluate(s, z)` computes the indicators after the
    /// time `s`, at most `reach`, with the flow at the start. Indicators that continue into their domain
    /// after their event are settled.
    pub(crate) fn find_slopes(
        &mut self,
        h: f64,
        reach: f64,
        mut evaluate: impl FnMut(f64, &mut [f64]) -> CallResult<()>,
    ) -> CallResult<()> {
        let step = SLOPE_STEP * h;
        self.is_calm = false;
        self.onward.fill(false);
        evaluate(step, &mut self.mid)?;
        for i in 0..self.len() {
            let (z0, z1, z2) = (self.base[i], self.mid[i], self.end[i]);
            // The indicator moves further into its domain, at a similar speed at the start and over the whole step.
            let goes_on = !self.resets[i]
                && z2.abs() > z0.abs()
                && (0.25..4.0).contains(&((z1 - z0) / step / ((z2 - z0) / h)));
            self.slopes[i] = match self.may_return(i) {
                true if goes_on => self.goes_on(i),
                true => 0.0,
                false => f64::NAN,
            };
        }
        for i in 0..self.len() {
            if self.slopes[i] != 0.0 {
                continue;
            }
            let z0 = self.base[i];
            self.slopes[i] = self.slope_along(i, z0, step, reach, &mut evaluate)?;
            let points_back = (z0 > 0.0) == (self.slopes[i] < 0.0);
            let is_new = matches!(self.since_event[i], SinceEvent::New { .. });
            if self.slopes[i] == 0.0 && self.since_event[i] == SinceEvent::Settled {
                self.slopes[i] = f64::NAN;
            } else if self.slopes[i] == 0.0 && is_new && self.flows_on(i, h, &mut evaluate)? {
                self.onward[i] = true;
                if !self.resets[i] || self.is_lost(i) {
                    self.slopes[i] = self.goes_on(i);
                }
            } else if self.slopes[i] != 0.0 && !points_back {
                let explains = self.slopes[i] * h / (self.end[i] - z0) > GOES_ON;
                self.onward[i] = explains && is_new;
                let explains = explains && self.is_lost(i);
                if !self.resets[i] || self.since_event[i] == SinceEvent::Settled || explains {
                    self.slopes[i] = self.goes_on(i);
                }
            } else if let (SinceEvent::New { depth }, true) = (self.since_event[i], self.slopes[i] != 0.0) {
                self.since_event[i] = SinceEvent::TurnedBack { depth };
                self.bounces[i] = true;
            }
        }
        Ok(())
    }

    /// True if the flow at the start leads indicator `i` further into its domain during the whole step of
    /// size `h`. The flow must also explain the value at the end. This does not require a slope at zero
    /// (`v^3` has none, `sqrt(v)` has no finite one).
    fn flows_on(
        &mut self,
        i: usize,
        h: f64,
        evaluate: &mut impl FnMut(f64, &mut [f64]) -> CallResult<()>,
    ) -> CallResult<bool> {
        let (z0, way) = (self.base[i], self.end[i] - self.base[i]);
        let mut far = 0.0;
        for s in [0.25 * h, 0.5 * h, h] {
            evaluate(s, &mut self.mid)?;
            let further = (self.mid[i] - z0) / way;
            if !(further > 0.0 && further >= far) {
                return Ok(false);
            }
            far = further;
        }
        Ok(far > GOES_ON)
    }

    /// Returns the step size at which the slope of indicator `i` matters as much as its curvature. The slope
    /// leads further into the domain, but far more slowly than the step of size `h`.
    pub(crate) fn step_of_slope(&self, i: usize, h: f64) -> Option<f64> {
        let share = self.slopes[i] * h / (self.end[i] - self.base[i]);
        (share > 0.0 && self.slopes[i] != 0.0).then_some(2.0 * share * h)
    }

    /// Handles indicator `i` moving further into its domain. Right after its event, it continues and the
    /// returned slope is NaN (unused). An indicator that had turned back no longer does; the slope is then 0.
    fn goes_on(&mut self, i: usize) -> f64 {
        if matches!(self.since_event[i], SinceEvent::TurnedBack { .. }) {
            return 0.0;
        }
        self.since_event[i] = SinceEvent::Settled;
        f64::NAN
    }

    /// Slope computed by [`find_slopes`](Self::find_slopes).
    pub(crate) fn slope(&self, i: usize) -> Option<f64> {
        Some(self.slopes[i]).filter(|slope| !slope.is_nan())
    }

    /// Returns the turning point, relative to the start, of a parabola and its value there. The parabola
    /// passes through the value and slope of the indicator at the start and the value `z` at the time `s`.
    pub(crate) fn turn(&self, i: usize, s: f64, z: f64) -> (f64, f64) {
        let (z0, slope) = (self.base[i], self.slopes[i]);
        let curvature = ((z - z0) / s - slope) / s;
        (-0.5 * slope / curvature, z0 - 0.25 * slope * slope / curvature)
    }

    /// Reads the indicators at a point inside the step and returns the value of indicator `i`.
    pub(crate) fn value_at(
        &mut self,
        i: usize,
        evaluate: impl FnOnce(&mut [f64]) -> CallResult<()>,
    ) -> CallResult<f64> {
        evaluate(&mut self.mid)?;
        Ok(self.mid[i])
    }

    /// True if indicator `i` is in the other domain at this value.
    pub(crate) fn leaves(&self, i: usize, z: f64) -> bool {
        flipped(self.base[i], z)
    }

    /// Returns the value to which indicator `i`, now `z` beyond zero, can be moved so that it does not cross
    /// again. Its next crossing may be an event.
    pub(crate) fn next_to_zero(&self, i: usize, z: f64) -> f64 {
        let is_event = flipped(z, 0.0) && self.directions[i] == Direction::Both;
        if is_event { 1e-3 * z } else { 0.0 }
    }

    /// True if indicator `i` has just crossed, is held, and is still beyond zero after its event.
    pub(crate) fn is_behind(&self, i: usize) -> bool {
        self.is_held(i) && self.crossings[i] != 0 && self.base[i] != 0.0 && self.is_beyond(i, self.base[i])
    }

    /// Returns the fraction of the bounce of indicator `i` to add so that it returns to zero against its
    /// `curvature`. The bounce changed its slope from `before` to `after`. `None` if the indicator returns
    /// without it. `None` also if it is not a bouncing body, whose impact speed results from the curvature
    /// during the steps of sliding.
    pub(crate) fn share_of_bounce(
        &self,
        i: usize,
        step: f64,
        [before, after, curvature]: [f64; 3],
    ) -> Option<f64> {
        let outwards = if self.from_above[i] { -1.0 } else { 1.0 };
        let (impact, pull) = (before * outwards, curvature * outwards);
        let is_bounce = pull > 0.0 && impact <= f64::from(CLEAN_STEPS) * step * pull;
        let needed = (2.0 * pull * self.base[i].abs()).sqrt() + after * outwards;
        let share = needed / (impact - after * outwards);
        (is_bounce && share > 0.0 && share.is_finite()).then_some(share)
    }

    /// True if the event of indicator `i` has let it pass, so that it leads further away from the domain it
    /// came from. The slopes are those before and after the event.
    pub(crate) fn passes(&self, i: usize, after: f64, before: f64) -> bool {
        let outwards = if self.from_above[i] { -1.0 } else { 1.0 };
        after * outwards > 0.0 && after * outwards > 0.5 * before * outwards
    }
}
