//! Search for the sizes of parameters that start at or near zero, without a nominal value and without a box.
//!
//! A start at zero contains no information on the magnitude of a parameter. A simplex whose edges are wrong
//! by many orders of magnitude ends at wrong points. Therefore each such parameter is varied alone, with
//! steps that grow or shrink by factors of ten. The search ends where the cost is smallest along the
//! parameter. If no step lowers the cost, it ends where the cost changes by at most its own value. The result
//! is checked again from the point where the tests pass. A parameter without effect at the start may have an
//! effect there.

use crate::method_interface::interface::Batch;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Ratio of two consecutive steps.
const RATIO: f64 = 10.0;
/// Maximum number of larger or smaller steps. Parameters in SI units range from a capacitance of 1e-12 F to a
/// modulus of elasticity of 1e11 Pa.
const LARGEST: i32 = 12;
/// Exponent of the smallest step after the simplex has shrunk to a point. The simplex itself has already
/// tested small steps.
const SMALLEST_BESIDE: i32 = -2;
/// Relative change of the cost that counts as no change. Simulations at usual tolerances have errors of this
/// size.
const NO_CHANGE: f64 = 1e-6;

/// Effect of a step on the cost, compared with the lowest cost along the parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum Change {
    Lower,
    None,
    /// The cost increases, or there is no cost.
    Higher,
}

/// An evaluated step and its cost.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Step {
    exponent: i32,
    side: f64,
    cost: f64,
}

/// Search along one parameter.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Line {
    k: usize,
    /// First step. The other steps are this step times powers of [`RATIO`].
    unit: f64,
    smallest: i32,
    exponent: i32,
    side: f64,
    /// Effect of the step of equal length in the opposite direction, once known.
    opposite: Option<Change>,
    /// 1 if steps grow, -1 if they shrink, 0 before the first decision.
    trend: i32,
    best: Option<Step>,
    /// Largest step that raises the cost by at most the absolute value of the cost at the base.
    moderate: Option<Step>,
    /// True if any step has changed the cost.
    has_effect: bool,
    is_over: bool,
}

/// Simultaneous search along all parameters of unknown size, each from the same base point.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SizeSearch {
    base: Vec<f64>,
    f_base: f64,
    /// Largest change of the cost that counts as no change.
    threshold: f64,
    lines: Vec<Line>,
    best: Option<(Vec<f64>, f64)>,
    x: Vec<f64>,
}

/// Result of a search along one parameter.
pub(crate) struct SizeFound {
    pub(crate) k: usize,
    pub(crate) size: f64,
    /// Value of the parameter at the step, and the cost, if the step has a cost.
    pub(crate) vertex: Option<(f64, f64)>,
}

impl SizeSearch {
    /// Starts at the start point, with steps of every magnitude.
    pub(crate) fn from_start(space: &Space, x0: &[f64], f_0: f64) -> Self {
        Self::new(space, (x0, f_0), NO_CHANGE * f_0.abs(), -LARGEST)
    }

    /// Starts at the best vertex of a small simplex, with steps of the parameter sizes and smaller. Larger
    /// steps follow if these change nothing. `threshold` is the spread of costs at which the tests pass. A
    /// parameter is skipped if the earlier search found an effect and its value is now close to its size.
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

    /// Returns the best evaluated point, if it is better than the base point.
    pub(crate) fn best(&self) -> Option<(&[f64], f64)> {
        self.best.as_ref().map(|(x, cost)| (&x[..], *cost))
    }

    /// True if a step lowers the cost by more than the threshold.
    pub(crate) fn is_lower(&self) -> bool {
        self.lines.iter().any(|line| line.best.is_some())
    }

    /// Returns the parameters whose size is still unknown because no step has changed the cost.
    pub(crate) fn without_effect<'a>(&'a self, space: &'a Space) -> impl Iterator<Item = usize> + 'a {
        let is_inert = |line: &&Line| line.is_over && !line.has_effect && space.size_is_unknown(line.k);
        self.lines.iter().filter(is_inert).map(|line| space.free()[line.k])
    }

    /// Requests one point on each line that has not ended. `requested` receives the index of the line.
    pub(crate) fn ask(&mut self, space: &Space, batch: &mut Batch, mut requested: impl FnMut(usize)) {
        for number in (0..self.lines.len()).filter(|&number| !self.lines[number].is_over) {
            let line = &self.lines[number];
            let i = space.free()[line.k];
            self.x[i] = line.value(self.base[i], line.exponent, line.side);
            // A larger cost only needs to be known up to twice the base cost. After a lower cost, it need not
            // be known.
            let cutoff = match line.best {
                Some(best) => best.cost + self.threshold,
                None => (self.f_base + self.threshold).max(self.f_base + self.f_base.abs()),
            };
            batch.push(&self.x, cutoff);
            self.x[i] = self.base[i];
            requested(number);
        }
    }

    /// Records the cost of the requested point on a line; `None` if it failed or is above the cutoff.
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

    /// Skips steps that leave the bounds or are too small to change the base value. They count as having no
    /// effect.
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

    /// Returns the smallest step that changes the cost if no step lowers it or raises it moderately. Returns
    /// the first step if all steps change the cost.
    fn last_with_effect(&self) -> i32 {
        match self.trend {
            -1 if self.exponent < self.smallest => 0,
            -1 => self.exponent + 1,
            _ => self.exponent,
        }
    }

    /// Processes the effect of a step, and chooses the next step.
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
        // Among steps with equal costs, the smallest shows where the cost starts to change.
        if change == Change::Lower || (change == Change::None && self.trend < 0 && self.best.is_some()) {
            self.best = step.or(self.best);
        }
        let has_best = self.best.is_some();
        match (self.trend, change) {
            (0, Change::Higher) => self.trend = -1,
            (0, _) => self.trend = 1,
            (1, Change::Lower) => {}
            (1, Change::None) if !has_best => {}
            // The first step is better than all larger ones.
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
