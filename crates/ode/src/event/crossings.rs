//! Indicators that have crossed in a step, and sliding indicators.

use super::domains::{CLEAN_STEPS, Domains, any_flips, crosses, flipped, is_behind};
use super::returns_within_step::SMALL;
use crate::system::{CallResult, Direction};

/// An indicator below this fraction of its largest value may cross zero soon.
const NEXT_TO_ZERO: f64 = 1e-6;

impl Domains {
    /// Records the direction of every crossing in the step, of duration `elapsed`, that is an event. Returns
    /// the first indicator that crossed, with those that do not slide first. Times within `tolerance` are
    /// equal.
    pub(crate) fn mark(&mut self, elapsed: f64, tolerance: f64) -> Option<usize> {
        // Filling an empty vector takes 30 ns on some processors (a masked store without elements).
        if self.crossings.is_empty() {
            return None;
        }
        if self.is_calm && !any_flips(self.reference(), &self.end) {
            self.crossings.fill(0);
            return None;
        }
        let mut has_any = false;
        for i in 0..self.len() {
            let (base, end) = (self.base[i], self.end[i]);
            let has_crossed = if !self.slides(i) {
                let from = self.reference()[i];
                flipped(from, end) && crosses(self.direction(i), from, end)
            } else if self.resets[i] {
                self.falls(i) || (self.directions[i] == Direction::Both && flipped(base, end))
            } else {
                // An indicator that returned in the step may have started in the domain in which it ends.
                self.is_lost(i) || crosses(self.direction(i), base, end)
            };
            has_any |= has_crossed;
            self.crossings[i] = match (has_crossed, end > 0.0) {
                (true, true) => 1,
                (true, false) => -1,
                _ => 0,
            };
            if has_crossed {
                self.find_origin(i);
                let slope = (end - base) / elapsed;
                // An indicator that jumps is not near zero.
                let jumps = end.abs() > SMALL * self.largest[i];
                self.near_zero[i] = if jumps { 0.0 } else { end.abs() + (tolerance * slope).abs() };
            }
        }
        if !has_any {
            return None;
        }
        let crossed = |i: &usize| self.crossings[*i] != 0;
        (0..self.len()).filter(crossed).min_by_key(|i| self.slides(*i))
    }

    /// Lets all marked indicators slide from now on.
    pub(crate) fn slide_marked(&mut self) {
        for i in 0..self.len() {
            if self.crossings[i] != 0 {
                self.slide(i);
            }
        }
    }

    /// True if a marked indicator is zero: the crossing is at this point or still to come.
    pub(crate) fn crossed_on_zero(&self) -> bool {
        self.end.iter().zip(&self.crossings).any(|(end, crossing)| *end == 0.0 && *crossing != 0)
    }

    /// Updates the sliding indicators after a step: those that have crossed in it continue to slide. Returns
    /// `false` if no indicator slides any more.
    pub(crate) fn go_on_sliding(&mut self) -> bool {
        for (left, crossing) in self.sliding.iter_mut().zip(&self.crossings) {
            *left = if *left > 0 && *crossing != 0 { CLEAN_STEPS } else { left.saturating_sub(1) };
        }
        self.sliding.iter().any(|left| *left > 0)
    }

    /// True if the event at the end of the step has not changed the indicators. `base` contains their values
    /// after the event.
    pub(crate) fn unmoved(&self) -> bool {
        self.base.iter().zip(&self.end).all(|(after, before)| (after - before).abs() <= 1e-3 * before.abs())
    }

    /// Clears all marks.
    pub(crate) fn clear_marks(&mut self) {
        self.crossings.fill(0);
    }

    /// True if an indicator is very small relative to its largest value so far. Such an indicator is usually
    /// near zero in time, unless it passes through all its values in a tiny part of a run.
    pub(crate) fn any_next_to_zero(&self) -> bool {
        self.base.iter().zip(&self.largest).any(|(z, largest)| z.abs() < NEXT_TO_ZERO * largest)
    }

    /// True if an indicator has an event between the start of the next step and a later point. `evaluate`
    /// fills in the indicators at that point.
    pub(crate) fn crosses_up_to(
        &mut self,
        evaluate: impl FnOnce(&mut [f64]) -> CallResult<()>,
    ) -> CallResult<bool> {
        evaluate(&mut self.mid)?;
        Ok(self.any_crosses(&self.base, &self.mid))
    }

    /// Records the domain from which the crossing indicator `i` comes. This is the domain it leaves, unless
    /// an event left it there near zero.
    pub(super) fn find_origin(&mut self, i: usize) {
        let ends_above = self.end[i] > 0.0;
        let was_left_behind = self.since_event[i].depth().is_some_and(|depth| !is_behind(depth, self.end[i]));
        if !was_left_behind && !self.is_held(i) {
            self.from_above[i] = !ends_above;
        }
    }

    /// True if indicator `i`, which is held, leaves the domain it came from in the step, or moves further
    /// away from it.
    pub(super) fn falls(&self, i: usize) -> bool {
        let (base, end) = (self.base[i], self.end[i]);
        self.is_beyond(i, end) && (!self.is_beyond(i, base) || end.abs() > base.abs())
    }
}
