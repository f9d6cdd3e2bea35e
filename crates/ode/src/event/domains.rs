//! Domain of each event indicator and its state since its last event.

use crate::system::Direction;

/// Number of steps without a crossing after which an indicator stops sliding.
pub(super) const CLEAN_STEPS: u32 = 100;

/// State of an indicator since its last event. `depth` is a value in the domain into which it crossed, with
/// the sign of that domain. Values up to `depth` are explained by the error of the event location.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum SinceEvent {
    /// The indicator is in the domain of its value.
    #[default]
    Settled,
    /// The indicator is near zero and has not moved yet.
    New { depth: f64 },
    /// The indicator is near zero, and its event has turned it back or stopped it. It must be seen in the
    /// domain it came from before it is seen beyond this depth. Otherwise it is lost.
    TurnedBack { depth: f64 },
}

impl SinceEvent {
    pub(super) fn depth(self) -> Option<f64> {
        match self {
            Self::Settled => None,
            Self::New { depth } | Self::TurnedBack { depth } => Some(depth),
        }
    }
}

/// True if a value is in the domain of this depth.
pub(super) fn is_behind(depth: f64, z: f64) -> bool {
    (z > 0.0) == depth.is_sign_positive()
}

#[inline]
pub(super) fn flipped(from: f64, to: f64) -> bool {
    (from > 0.0) != (to > 0.0)
}

/// True if any indicator changes its domain.
#[inline]
pub(super) fn any_flips(from: &[f64], to: &[f64]) -> bool {
    from.iter().zip(to).fold(false, |any, (from, to)| any | flipped(*from, *to))
}

/// True if the change of an indicator is an event.
pub(super) fn crosses(direction: Direction, from: f64, to: f64) -> bool {
    flipped(from, to)
        && match direction {
            Direction::Both | Direction::Either => true,
            Direction::Up => to > 0.0,
            Direction::Down => to <= 0.0,
        }
}

/// Domains of the indicators and the values that determine them.
#[derive(Debug, Default)]
pub(crate) struct Domains {
    /// Indicators at the start of the step (after all events there).
    pub(crate) base: Vec<f64>,
    /// Indicators at the end of the step being examined.
    pub(crate) end: Vec<f64>,
    pub(super) mid: Vec<f64>,
    pub(super) lo: Vec<f64>,
    pub(super) discarded: Vec<f64>,
    pub(super) directions: Vec<Direction>,
    /// Indicators and time at a point inside the step at which one changed its domain in a direction that is
    /// not an event. Later changes are counted from this point. `None`: from the start of the step.
    pub(super) from: Vec<f64>,
    pub(super) counts_since: Option<f64>,
    /// Times inside the step at which the indicators were evaluated, ascending, and their values, one time
    /// after the other.
    pub(super) looked_at: Vec<f64>,
    pub(super) looked: Vec<f64>,
    /// Indicators and time at the start of the previous step, if no event has happened since.
    pub(super) before: Vec<f64>,
    pub(super) before_time: Option<f64>,
    /// Crossing of each indicator: +1, -1 or 0. Set by [`mark`](Self::mark).
    pub(crate) crossings: Vec<i8>,
    /// Bound on the distance of an indicator from zero at its last located event.
    pub(super) near_zero: Vec<f64>,
    pub(super) since_event: Vec<SinceEvent>,
    /// Largest absolute values so far.
    pub(super) largest: Vec<f64>,
    /// True for indicators whose last event has changed states.
    pub(super) resets: Vec<bool>,
    /// True for indicators that came from the domain `z > 0` at their last event.
    pub(super) from_above: Vec<bool>,
    /// True for indicators that have stayed small since an event reversed them.
    pub(super) bounces: Vec<bool>,
    /// Slopes at the start of the step of indicators that may return in it; NaN if unused.
    pub(super) slopes: Vec<f64>,
    /// True for indicators that their event left near zero and that the flow leads on from there in the step.
    pub(super) onward: Vec<bool>,
    /// Remaining number of steps without a crossing in which an indicator slides; 0 if it does not slide. The
    /// crossings of sliding indicators count at the ends of steps.
    pub(super) sliding: Vec<u32>,
    /// True if all indicators are settled and none bounces, slides or continues from its event.
    pub(super) is_calm: bool,
}

impl Domains {
    /// Allocates `n` indicators whose changes are events in these directions.
    pub(crate) fn begin(&mut self, n: usize, direction: impl Fn(usize) -> Direction) {
        for v in [
            &mut self.base,
            &mut self.end,
            &mut self.mid,
            &mut self.lo,
            &mut self.discarded,
            &mut self.before,
            &mut self.from,
            &mut self.slopes,
            &mut self.near_zero,
            &mut self.largest,
        ] {
            v.clear();
            v.resize(n, 0.0);
        }
        self.crossings.clear();
        self.crossings.resize(n, 0);
        self.since_event.clear();
        self.since_event.resize(n, SinceEvent::Settled);
        self.sliding.clear();
        self.sliding.resize(n, 0);
        for v in [&mut self.bounces, &mut self.resets, &mut self.from_above, &mut self.onward] {
            v.clear();
            v.resize(n, false);
        }
        self.directions.clear();
        self.directions.extend((0..n).map(direction));
        self.before_time = None;
        self.counts_since = None;
        self.is_calm = true;
    }

    pub(crate) fn len(&self) -> usize {
        self.base.len()
    }

    /// Starts the examination of a step: changes count from its start.
    pub(crate) fn look(&mut self) {
        self.counts_since = None;
        self.looked_at.clear();
        self.looked.clear();
    }

    /// Time from which changes count, if not the start of the step.
    pub(crate) fn counts_since(&self) -> Option<f64> {
        self.counts_since
    }

    /// Indicators at the point from which changes count.
    pub(super) fn reference(&self) -> &[f64] {
        if self.counts_since.is_some() { &self.from } else { &self.base }
    }

    /// True if the change of an indicator is an event to be located.
    pub(super) fn is_located(&self, i: usize, from: f64, to: f64) -> bool {
        !self.slides(i) && crosses(self.direction(i), from, to)
    }

    /// True if any indicator has an event between two points.
    #[inline]
    pub(super) fn any_crosses(&self, from: &[f64], to: &[f64]) -> bool {
        any_flips(from, to)
            && from.iter().zip(to).enumerate().any(|(i, (from, to))| self.is_located(i, *from, *to))
    }

    /// True if any indicator has left its domain and the change is an event.
    #[inline]
    pub(crate) fn changed(&self) -> bool {
        self.any_crosses(self.reference(), &self.end)
    }

    /// Lets this indicator slide from now on.
    pub(crate) fn slide(&mut self, i: usize) {
        self.sliding[i] = CLEAN_STEPS;
        self.is_calm = false;
    }

    /// Stops the sliding of this indicator.
    pub(crate) fn release(&mut self, i: usize) {
        self.sliding[i] = 0;
        self.since_event[i] = SinceEvent::Settled;
    }

    /// True if this indicator slides.
    pub(crate) fn slides(&self, i: usize) -> bool {
        self.sliding[i] > 0
    }

    /// Advances to the next step after one without an event, which began at `start`. Its end is the new
    /// start.
    pub(crate) fn advance(&mut self, start: f64) {
        std::mem::swap(&mut self.before, &mut self.base);
        std::mem::swap(&mut self.base, &mut self.end);
        self.before_time = Some(start);
    }

    /// Discards the history of the indicators.
    pub(crate) fn forget(&mut self) {
        self.before_time = None;
    }

    /// True if indicator `i` is held at zero: it slides, and its events move it back by changing states.
    pub(crate) fn is_held(&self, i: usize) -> bool {
        self.slides(i) && self.resets[i]
    }

    /// True if the last event of indicator `i` has changed states.
    pub(crate) fn resets(&self, i: usize) -> bool {
        self.resets[i]
    }

    /// True if indicator `i` ends the trial at a value that an event which turned it back, or stopped it,
    /// does not explain.
    pub(crate) fn is_lost(&self, i: usize) -> bool {
        let is_beyond = |depth: f64| is_behind(depth, self.end[i]) && self.end[i].abs() > depth.abs();
        self.since_event[i].depth().is_some_and(is_beyond)
    }

    /// Direction in which a change of indicator `i` is an event. If the return from near zero to the domain
    /// it came from is not an event, only the other direction counts until it has returned.
    pub(super) fn direction(&self, i: usize) -> Direction {
        match (self.directions[i], self.since_event[i].depth()) {
            (Direction::Either, Some(depth)) if self.resets[i] => {
                if depth.is_sign_positive() {
                    Direction::Up
                } else {
                    Direction::Down
                }
            }
            (direction, _) => direction,
        }
    }

    /// True if this value of indicator `i` is not in the domain the indicator came from.
    pub(super) fn is_beyond(&self, i: usize, z: f64) -> bool {
        (z > 0.0) != self.from_above[i]
    }
}
