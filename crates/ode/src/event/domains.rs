//! In which domain each event indicator is, and what is known of it since its last event.

use crate::system::Direction;

/// After so many steps without a crossing the sliding of an indicator has ended.
pub(super) const CLEAN_STEPS: u32 = 100;

/// State of an indicator since its last event. Its `depth` is a value in the domain that it crossed into,
/// with the sign of that domain, up to which the location of the event explains its values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum SinceEvent {
    /// It is in the domain that its value says.
    #[default]
    Settled,
    /// It is next to zero, and has not moved yet.
    New { depth: f64 },
    /// It is next to zero, and its event has turned it back, or stopped it: it will be seen in the domain it
    /// came from before it is seen beyond this depth, or it is lost.
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

/// True if any of the indicators changes its domain.
#[inline]
pub(super) fn any_flips(from: &[f64], to: &[f64]) -> bool {
    from.iter().zip(to).fold(false, |any, (from, to)| any | flipped(*from, *to))
}

/// True if a change of an indicator is an event.
pub(super) fn crosses(direction: Direction, from: f64, to: f64) -> bool {
    flipped(from, to)
        && match direction {
            Direction::Both | Direction::Either => true,
            Direction::Up => to > 0.0,
            Direction::Down => to <= 0.0,
        }
}

/// Domains of the indicators, and the values they were read from.
#[derive(Debug, Default)]
pub(crate) struct Domains {
    /// Indicators at the start of the step (after all events there).
    pub(crate) base: Vec<f64>,
    /// Indicators at the end of the step that is being looked at.
    pub(crate) end: Vec<f64>,
    pub(super) mid: Vec<f64>,
    pub(super) lo: Vec<f64>,
    pub(super) discarded: Vec<f64>,
    pub(super) directions: Vec<Direction>,
    /// Indicators at a point inside the step, and its time, where one has changed its domain in a direction
    /// that is no event: what happens behind it counts from there. `None`: from the start of the step.
    pub(super) from: Vec<f64>,
    pub(super) counts_since: Option<f64>,
    /// Times inside the step at which the indicators were looked at, ascending, and their values there, one
    /// time after the other.
    pub(super) looked_at: Vec<f64>,
    pub(super) looked: Vec<f64>,
    /// Indicators at the start of the step before, and that time, if nothing has happened since.
    pub(super) before: Vec<f64>,
    pub(super) before_time: Option<f64>,
    /// +1, -1 or 0 per indicator, once [`crossings`](Self::mark) has been called.
    pub(crate) crossings: Vec<i8>,
    /// Bound on the distance of an indicator from zero where its last event was located.
    pub(super) near_zero: Vec<f64>,
    pub(super) since_event: Vec<SinceEvent>,
    /// The largest absolute values so far.
    pub(super) largest: Vec<f64>,
    /// Those whose last event has changed states.
    pub(super) resets: Vec<bool>,
    /// Those that came from the domain `z > 0` at their last event.
    pub(super) from_above: Vec<bool>,
    /// Those that an event has turned back, and that were small since.
    pub(super) bounces: Vec<bool>,
    /// Slopes at the start of the step of the indicators that may come back in it; NaN: of no interest.
    pub(super) slopes: Vec<f64>,
    /// Those that their event has left next to zero, and that the flow leads on from there in the step.
    pub(super) onward: Vec<bool>,
    /// Indicators that chatter: their crossings count at the ends of steps. For so many more steps, if they
    /// do not cross; 0: they do not slide.
    pub(super) sliding: Vec<u32>,
    /// All are settled, and none bounces, goes on from its event or slides.
    pub(super) is_calm: bool,
}

impl Domains {
    /// Makes room for `n` indicators whose changes are events in these directions.
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

    /// A step is going to be looked into: changes count from its start.
    pub(crate) fn look(&mut self) {
        self.counts_since = None;
        self.looked_at.clear();
        self.looked.clear();
    }

    /// From when on changes count, if not from the start of the step.
    pub(crate) fn counts_since(&self) -> Option<f64> {
        self.counts_since
    }

    /// The indicators where changes begin to count.
    pub(super) fn reference(&self) -> &[f64] {
        if self.counts_since.is_some() { &self.from } else { &self.base }
    }

    /// True if the change of an indicator is an event that is to be located.
    pub(super) fn is_located(&self, i: usize, from: f64, to: f64) -> bool {
        !self.slides(i) && crosses(self.direction(i), from, to)
    }

    /// True if any indicator has an event between two points.
    #[inline]
    pub(super) fn any_crosses(&self, from: &[f64], to: &[f64]) -> bool {
        any_flips(from, to)
            && from.iter().zip(to).enumerate().any(|(i, (from, to))| self.is_located(i, *from, *to))
    }

    /// True if any indicator has left the domain it was in, so that it is an event.
    #[inline]
    pub(crate) fn changed(&self) -> bool {
        self.any_crosses(self.reference(), &self.end)
    }

    /// This indicator slides from now on.
    pub(crate) fn slide(&mut self, i: usize) {
        self.sliding[i] = CLEAN_STEPS;
        self.is_calm = false;
    }

    /// This indicator slides no more.
    pub(crate) fn release(&mut self, i: usize) {
        self.sliding[i] = 0;
        self.since_event[i] = SinceEvent::Settled;
    }

    /// True if this indicator slides.
    pub(crate) fn slides(&self, i: usize) -> bool {
        self.sliding[i] > 0
    }

    /// The step that began at `start` is over without an event: its end is the next start.
    pub(crate) fn advance(&mut self, start: f64) {
        std::mem::swap(&mut self.before, &mut self.base);
        std::mem::swap(&mut self.base, &mut self.end);
        self.before_time = Some(start);
    }

    /// The indicators go on from the current point without a past.
    pub(crate) fn forget(&mut self) {
        self.before_time = None;
    }

    /// True if indicator `i` is held at zero: it slides, and its events put it back by changing states.
    pub(crate) fn is_held(&self, i: usize) -> bool {
        self.slides(i) && self.resets[i]
    }

    /// True if the last event of indicator `i` has changed states.
    pub(crate) fn resets(&self, i: usize) -> bool {
        self.resets[i]
    }

    /// True if indicator `i` ends the trial where an event that has turned it back, or has stopped it, does
    /// not explain it.
    pub(crate) fn is_lost(&self, i: usize) -> bool {
        let is_beyond = |depth: f64| is_behind(depth, self.end[i]) && self.end[i].abs() > depth.abs();
        self.since_event[i].depth().is_some_and(is_beyond)
    }

    /// Direction in which a change of indicator `i` is an event: where going from next to zero back to the
    /// domain that it came from is none, the other direction alone counts until it has gone there.
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

    /// True if indicator `i`, of this value, is in the other domain than the one it came from.
    pub(super) fn is_beyond(&self, i: usize, z: f64) -> bool {
        (z > 0.0) != self.from_above[i]
    }
}
