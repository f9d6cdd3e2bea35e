//! Sizes of parameters of which nothing is known: they start at zero or next to it, without a nominal value
//! and without a box.
//!
//! Zero does not say how large a parameter is, and a simplex whose sides are wrong by many magnitudes ends at
//! wrong points. So each such parameter is moved alone, by steps that grow or shrink tenfold, to where the
//! cost is least along it; where no step lowers the cost, to where it changes by no more than its own size.
//! What such a search has found is looked at once more from the point where the tests pass: a parameter that
//! did not matter at the start may matter there.

use crate::method_interface::interface::Batch;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Ratio of two steps that follow one another.
const RATIO: f64 = 10.0;
/// Number of steps larger or smaller than the first that are tried: parameters in SI units lie between a
/// capacitance of 1e-12 F and a modulus of elasticity of 1e11 Pa.
const LARGEST: i32 = 12;
/// Number of smaller ones where the simplex has shrunk to a point, and has seen small steps itself.
const SMALLEST_BESIDE: i32 = -2;
/// A change of the cost below this share of it counts as none: simulations at usual tolerances change it by
/// as much.
const NO_CHANGE: f64 = 1e-6;

/// Effect of a step on the cost, compared with the least seen along the parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum Change {
    Lower,
    None,
    /// Or there is no cost.
    Higher,
}

/// A step that was looked at, and its cost.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Step {
    exponent: i32,
    side: f64,
    cost: f64,
}

/// The search along one parameter.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Line {
    k: usize,
    /// The first step; the others are this one times powers of [`RATIO`].
    unit: f64,
    smallest: i32,
    exponent: i32,
    side: f64,
    /// Effect of the step of the same length to the other side, once that is known.
    opposite: Option<Change>,
    /// 1 while steps grow, -1 while they shrink, 0 before either.
    trend: i32,
    best: Option<Step>,
    /// The largest step that raises the cost by no more than its own size.
    moderate: Option<Step>,
    /// True if any step has changed the cost.
    has_effect: bool,
    is_over: bool,
}

/// The search along all parameters of unknown size at once, each from the same point.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SizeSearch {
    base: Vec<f64>,
    f_base: f64,
    /// Largest change of the cost that counts as none.
    threshold: f64,
    lines: Vec<Line>,
    best: Option<(Vec<f64>, f64)>,
    x: Vec<f64>,
}

/// Result of a search along one parameter.
pub(crate) struct SizeFound {
    pub(crate) k: usize,
    pub(crate) size: f64,
    /// The parameter's value there and the cost, if that step has one.
    pub(crate) vertex: Option<(f64, f64)>,
}

impl SizeSearch {
    /// From the start point, with steps of every magnitude.
    pub(crate) fn from_start(space: &Space, x0: &[f64], f_0: f64) -> Self {
        Self::new(space, (x0, f_0), NO_CHANGE * f_0.abs(), -LARGEST)
    }

    /// From the best vertex of a simplex that has become small: with steps of the sizes and smaller, and
    /// larger ones where these change nothing. `threshold` is the spread of costs at which the tests pass. A
    /// parameter that an earlier search found to matter, and that has come to a value of about its size,
    /// needs no further look.
    pub(crate) fn beside(space: &Space, best: (&[f64], f64), threshold: f64, earlier: Option<&Self>) -> Self {
        let mut search = Self::new(space, best, threshold, SMALLEST_BESIDE);
        let matters = |k: usize| earlier.is_some_and(|e| e.lines.iter().all(|l| l.k != k || l.has_effect));
        search.lines.retain(|line| {
            let ratio = (best.0[space.free()[line.k]] / line.unit).abs();
            !(matters(line.k) && (1.0 / RATIO..=RATIO).contains(&ratio))
        });
        search
    }

    fn new(space: &Space, (base, f_base): (&[f64], f64), threshold: f64, smallest: i32) -> Self {
        let line = |k: usize| Line {
            k,
            unit: space.unit(k),
            smallest,
            exponent: 0,
            side: 1.0,
            opposite: None,
            trend: 0,
            best: None,
            moderate: None,
            has_effect: false,
            is_over: false,
        };
        let lines = (0..space.n_free()).filter(|&k| space.size_is_unknown(k)).map(line).collect();
        let mut search = Self { base: base.to_vec(), f_base, threshold, lines, best: None, x: base.to_vec() };
        (0..search.lines.len()).for_each(|number| search.skip(number, space));
        search
    }

    pub(crate) fn base(&self) -> (&[f64], f64) {
        (&self.base, self.f_base)
    }

    pub(crate) fn is_over(&self) -> bool {
        self.lines.iter().all(|line| line.is_over)
    }

    /// The best point that was looked at, if it is better than the one that the search started from.
    pub(crate) fn best(&self) -> Option<(&[f64], f64)> {
        self.best.as_ref().map(|(x, cost)| (&x[..], *cost))
    }

    /// True if a step lowers the cost by more than the threshold.
    pub(crate) fn is_lower(&self) -> bool {
        self.lines.iter().any(|line| line.best.is_some())
    }

    /// Parameters whose size is still unknown: no step has changed the cost.
    pub(crate) fn without_effect<'a>(&'a self, space: &'a Space) -> impl Iterator<Item = usize> + 'a {
        let is_inert = |line: &&Line| line.is_over && !line.has_effect && space.size_is_unknown(line.k);
        self.lines.iter().filter(is_inert).map(|line| space.free()[line.k])
    }

    /// Asks for one point on each line that is not at its end; `asked` is given the number of the line.
    pub(crate) fn ask(&mut self, space: &Space, batch: &mut Batch, mut asked: impl FnMut(usize)) {
        for number in (0..self.lines.len()).filter(|&number| !self.lines[number].is_over) {
            let line = &self.lines[number];
            let i = space.free()[line.k];
            self.x[i] = line.value(self.base[i], line.exponent, line.side);
            // How much a step raises the cost matters as far as that is the cost itself, and not at all beside a lower one.
            let cutoff = match line.best {
                Some(best) => best.cost + self.threshold,
                None => (self.f_base + self.threshold).max(self.f_base + self.f_base.abs()),
            };
            batch.push(&self.x, cutoff);
            self.x[i] = self.base[i];
            asked(number);
        }
    }

    /// Takes the cost of the point asked for on a line; none if it failed or is above the cutoff.
    pub(crate) fn see(&mut self, space: &Space, number: usize, cost: Option<f64>) {
        let line = &mut self.lines[number];
        let change = line.change(cost, self.f_base, self.threshold);
        let step = cost.map(|cost| Step { exponent: line.exponent, side: line.side, cost });
        line.has_effect |= change != Change::None;
        if let Some(step) = step.filter(|step| step.cost < self.best.as_ref().map_or(self.f_base, |b| b.1)) {
            let i = space.free()[line.k];
            let mut x = self.base.clone();
            x[i] = line.value(x[i], step.exponent, step.side);
            self.best = Some((x, step.cost));
        }
        if change == Change::Higher && line.moderate.is_none() {
            line.moderate = step.filter(|step| step.cost <= self.f_base + self.f_base.abs());
        }
        line.go_on(change, step);
        self.skip(number, space);
    }

    /// Passes over steps that lead out of the bounds or are too small to be seen beside the base: they change
    /// nothing.
    fn skip(&mut self, number: usize, space: &Space) {
        let line = &mut self.lines[number];
        let i = space.free()[line.k];
        let (lower, upper) = (space.bounds().lower()[i], space.bounds().upper()[i]);
        while !line.is_over {
            let value = line.value(self.base[i], line.exponent, line.side);
            if value != self.base[i] && lower <= value && value <= upper && value.is_finite() {
                return;
            }
            line.go_on(Change::None, None);
        }
    }

    pub(crate) fn found(&self, space: &Space) -> Vec<SizeFound> {
        let found = |line: &Line| {
            let base = self.base[space.free()[line.k]];
            let vertex = |step: Step| (line.value(base, step.exponent, step.side), step.cost);
            let step = line.best.or(line.moderate);
            let exponent = step.map_or_else(|| line.last_with_effect(), |step| step.exponent);
            SizeFound { k: line.k, size: line.length(exponent), vertex: step.map(vertex) }
        };
        self.lines.iter().filter(|line| line.has_effect).map(found).collect()
    }

    pub(crate) fn is_sound(&self, space: &Space) -> bool {
        (self.base.len(), self.x.len()) == (space.n(), space.n())
            && self.best.as_ref().is_none_or(|(x, _)| x.len() == space.n())
            && self.lines.iter().all(|line| line.k < space.n_free())
    }
}

impl Line {
    fn length(&self, exponent: i32) -> f64 {
        self.unit * RATIO.powi(exponent)
    }

    fn value(&self, base: f64, exponent: i32, side: f64) -> f64 {
        base + side * self.length(exponent)
    }

    fn change(&self, cost: Option<f64>, f_base: f64, threshold: f64) -> Change {
        let least = self.best.map_or(f_base, |best| best.cost);
        match cost {
            Some(cost) if cost < least - threshold => Change::Lower,
            Some(cost) if cost <= least + threshold => Change::None,
            _ => Change::Higher,
        }
    }

    /// The smallest step that changes the cost, where none lowers it or raises it moderately; the first,
    /// where all of them do.
    fn last_with_effect(&self) -> i32 {
        match self.trend {
            -1 if self.exponent < self.smallest => 0,
            -1 => self.exponent + 1,
            _ => self.exponent,
        }
    }

    /// Takes what a step does, and makes the next one.
    fn go_on(&mut self, change: Change, step: Option<Step>) {
        if change != Change::Lower && self.best.is_none() && self.opposite.is_none() {
            self.opposite = Some(change);
            self.side = -self.side;
            return;
        }
        let change = self.opposite.take().map_or(change, |opposite| match change {
            Change::Lower => Change::Lower,
            _ => change.max(opposite),
        });
        // Of steps of one cost the smallest says where the cost begins to change.
        if change == Change::Lower || (change == Change::None && self.trend < 0 && self.best.is_some()) {
            self.best = step.or(self.best);
        }
        let has_best = self.best.is_some();
        match (self.trend, change) {
            (0, Change::Higher) => self.trend = -1,
            (0, _) => self.trend = 1,
            (1, Change::Lower) => {}
            (1, Change::None) if !has_best => {}
            // The first step is the best of those that are larger.
            (1, _) if self.best.is_some_and(|best| best.exponent == 0) => {
                self.trend = -1;
                self.exponent = 0;
            }
            (1, _) => self.is_over = true,
            (_, Change::Higher) => self.is_over = has_best,
            (_, Change::None) => self.is_over = !has_best,
            (_, Change::Lower) => {}
        }
        if self.is_over {
            return;
        }
        self.exponent += self.trend;
        self.is_over = self.exponent < self.smallest || self.exponent > LARGEST;
        if !has_best {
            self.side = 1.0;
        }
    }
}
