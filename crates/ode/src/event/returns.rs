//! Indicators that are next to zero when a step begins, and may leave their domain and come back within it.

use super::{Domains, flipped};
use crate::system::{CallResult, Direction};

/// The slopes of indicators are differences over this share of a step.
const SLOPE_STEP: f64 = 1.0 / 256.0;

/// What [`Domains::find_slopes`] has found.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Slopes {
    /// There are some.
    pub(crate) any: bool,
    /// One that was on its way out before, and is so no more, without having been seen outside.
    pub(crate) turned: Option<usize>,
    /// Evaluations of the indicators it took.
    pub(crate) evaluations: u64,
}

impl Domains {
    /// Whether indicator `i` began next to zero, in a step after its event, after any event, or of a run, and ended in the
    /// domain where it began: it may have left that right behind the start, and come back.
    fn began_at_zero(&self, i: usize) -> bool {
        let (z0, z2) = (self.base[i], self.end[i]);
        let next_to_zero = || self.before_time.is_none() && z0.abs() < 1e-3 * z2.abs();
        let since_event =
            || self.overshoots[i].is_some() && (z0.abs() <= z2.abs() || self.was_at_zero(i, 0.0));
        !flipped(z0, z2) && (since_event() || next_to_zero())
    }

    /// Whether any indicator that slides, or else does not, [began at zero](Self::began_at_zero).
    pub(crate) fn any_began_at_zero(&self, slides: bool) -> bool {
        (0..self.len()).any(|i| self.sliding[i] == slides && self.began_at_zero(i))
    }

    /// Of these the slopes at the start of the step of size `h`, where they point out of the domain: by differences along
    /// the flow, `evaluate(s, z)` being the indicators after the time `s`, at most `reach`, if the flow stayed as it is at
    /// the start. Those of one that has just returned may be too small for this: a point as `far` as there is then tells
    /// where it is going.
    pub(crate) fn find_slopes(
        &mut self,
        (h, reach, far): (f64, f64, f64),
        slides: bool,
        mut evaluate: impl FnMut(f64, &mut [f64]) -> CallResult<()>,
    ) -> CallResult<Slopes> {
        let step = SLOPE_STEP * h;
        let mut slopes = Slopes { evaluations: 1, ..Slopes::default() };
        evaluate(step, &mut self.mid)?;
        for i in 0..self.len() {
            let (z0, z1, z2) = (self.base[i], self.mid[i], self.end[i]);
            // As fast at the start as in the whole step, on into the domain: it just goes on. Or it stays where it is.
            let goes_on = z2.abs() > z0.abs() && (0.25..4.0).contains(&((z1 - z0) / step / ((z2 - z0) / h)))
                || z1 == z0 && z2 == z0 && !self.was_at_zero(i, 0.0);
            let of_interest = self.sliding[i] == slides && self.began_at_zero(i);
            self.slopes[i] = if of_interest && !goes_on { 0.0 } else { f64::NAN };
            if of_interest && goes_on && self.leaving[i] {
                slopes.turned = Some(i);
            }
        }
        for i in 0..self.len() {
            if self.slopes[i].is_nan() {
                continue;
            }
            let (z0, mut s) = (self.base[i], step);
            while 2.0 * s <= reach && self.slopes[i] == 0.0 {
                evaluate(s, &mut self.mid)?;
                let d1 = self.mid[i] - z0;
                evaluate(2.0 * s, &mut self.mid)?;
                let d2 = self.mid[i] - z0;
                slopes.evaluations += 2;
                // Else it is rounding.
                if (d2 - 2.0 * d1).abs() <= 0.25 * d2.abs() {
                    self.slopes[i] = (4.0 * d1 - d2) / (2.0 * s);
                }
                s *= 8.0;
            }
            if (z0 > 0.0) == (self.slopes[i] < 0.0) && self.slopes[i] != 0.0 {
                slopes.any = true;
                continue;
            }
            if self.leaving[i] {
                slopes.turned = Some(i);
            } else if self.slopes[i] == 0.0 && self.returned[i] && self.was_at_zero(i, 0.0) {
                evaluate(far, &mut self.mid)?;
                slopes.evaluations += 1;
                let z = self.mid[i];
                if z != z0 && (z0 > 0.0) == (z < z0) {
                    slopes.turned = Some(i);
                }
            }
            self.slopes[i] = f64::NAN;
        }
        Ok(slopes)
    }

    /// The slope that [`find_slopes`](Self::find_slopes) has found.
    pub(crate) fn slope(&self, i: usize) -> Option<f64> {
        Some(self.slopes[i]).filter(|slope| !slope.is_nan())
    }

    /// When after the start the parabola through the value of such an indicator there, with its slope, and that at the
    /// time `s`, which is `z`, turns, and its value there.
    pub(crate) fn turn(&self, i: usize, (s, z): (f64, f64)) -> (f64, f64) {
        let (z0, slope) = (self.base[i], self.slopes[i]);
        let curvature = ((z - z0) / s - slope) / s;
        (-0.5 * slope / curvature, z0 - 0.25 * slope * slope / curvature)
    }

    /// Reads the indicators at a point inside the step; the value of indicator `i`.
    pub(crate) fn value_at(
        &mut self,
        i: usize,
        evaluate: impl FnOnce(&mut [f64]) -> CallResult<()>,
    ) -> CallResult<f64> {
        evaluate(&mut self.mid)?;
        Ok(self.mid[i])
    }

    /// Indicator `i` is on its way out of its domain.
    pub(crate) fn set_leaving(&mut self, i: usize) {
        self.leaving[i] = true;
    }

    /// Whether indicator `i` is in the other domain at this value.
    pub(crate) fn leaves(&self, i: usize, z: f64) -> bool {
        flipped(self.base[i], z)
    }

    /// Whether indicator `i` was next to zero at the start of the step: as its event was located, or no farther than
    /// `reach`.
    pub(crate) fn was_at_zero(&self, i: usize, reach: f64) -> bool {
        self.base[i].abs() <= self.overshoots[i].map_or(reach, |overshoot| reach.max(4.0 * overshoot))
    }

    /// An indicator that slides, and came back in the step: it counts as if it had begun in the other domain.
    pub(crate) fn count_as_returned(&mut self, i: usize) {
        self.base[i] = if self.base[i] > 0.0 { 0.0 } else { f64::MIN_POSITIVE };
    }

    /// To where indicator `i`, of this value behind zero, can be moved so that it does not cross again: its next crossing
    /// may be an event.
    pub(crate) fn next_to_zero(&self, i: usize, z: f64) -> f64 {
        let is_event = flipped(z, 0.0) && self.directions[i] == Direction::Both;
        if is_event { 1e-3 * z } else { 0.0 }
    }

    /// Whether indicator `i` has just crossed, slides, and is still behind zero after its event.
    pub(crate) fn is_behind(&self, i: usize) -> bool {
        self.sliding[i]
            && self.crossings[i] != 0
            && self.base[i] != 0.0
            && !flipped(self.base[i], self.end[i])
    }
}
