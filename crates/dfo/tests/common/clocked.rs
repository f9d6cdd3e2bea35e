//! Workers on a simulated clock: evaluations take arbitrary simulated times but no real time.

use dfo::{Answer, CutoffUse, Evaluator, Outcome, PollResult, Query, Wait};
use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;

pub fn rosenbrock(x: &[f64]) -> f64 {
    x.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

pub fn hash(x: &[f64]) -> u64 {
    let mix = |h: u64, v: &f64| (h ^ v.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
    x.iter().fold(7, mix).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 33
}

/// Lets one in `every` points take ten times as long.
pub fn one_in(every: u64) -> impl Fn(&[f64]) -> f64 + Copy {
    move |x| if hash(x).is_multiple_of(every) { 10.0 } else { 1.0 }
}

/// Observed quantities.
#[derive(Default)]
pub struct Seen {
    /// Clock, total time of all points, and number of started points.
    pub now: Cell<f64>,
    pub busy: Cell<f64>,
    pub begun: Cell<usize>,
}

/// Workers on a simulated clock. The evaluation that ends first answers first.
pub struct Clocked<L> {
    width: usize,
    length: L,
    pub answer: fn(&[f64], &Query<'_>) -> Answer,
    pub cutoff_use: CutoffUse,
    waiting: VecDeque<(Query<'static>, Vec<f64>)>,
    /// End time, start time, query and point.
    running: Vec<(f64, f64, Query<'static>, Vec<f64>)>,
    cancelled: Vec<u64>,
    seen: Rc<Seen>,
}

impl<L: Fn(&[f64]) -> f64> Clocked<L> {
    pub fn new(width: usize, length: L) -> (Self, Rc<Seen>) {
        let seen = Rc::new(Seen::default());
        let shared = Rc::clone(&seen);
        let (waiting, running, cancelled) = (VecDeque::new(), Vec::new(), Vec::new());
        let answer = |x: &[f64], _: &Query<'_>| Outcome::Value(rosenbrock(x)).into();
        let cutoff_use = CutoffUse::No;
        (Self { width, length, answer, cutoff_use, waiting, running, cancelled, seen: shared }, seen)
    }

    fn begin(&mut self) {
        while self.running.len() < self.width
            && let Some((query, x)) = self.waiting.pop_front()
        {
            let now = self.seen.now.get();
            self.seen.begun.set(self.seen.begun.get() + 1);
            self.running.push((now + (self.length)(&x), now, query, x));
        }
    }
}

impl<L: Fn(&[f64]) -> f64> Evaluator for Clocked<L> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        self.waiting.push_back((query, x.to_vec()));
    }

    fn poll(&mut self, _: &Wait<'_>, answer: &mut Answer) -> PollResult {
        answer.clear();
        if let Some(id) = self.cancelled.pop() {
            return PollResult::Answered(id);
        }
        self.begin();
        let first = (0..self.running.len()).min_by(|a, b| self.running[*a].0.total_cmp(&self.running[*b].0));
        let Some(first) = first else { return PollResult::Idle };
        let (end, began, query, x) = self.running.swap_remove(first);
        self.seen.now.set(end);
        self.seen.busy.set(self.seen.busy.get() + end - began);
        *answer = (self.answer)(&x, &query);
        PollResult::Answered(query.id)
    }

    /// A simulation stops at its next step.
    fn cancel(&mut self, id: u64) {
        let now = self.seen.now.get();
        if let Some(place) = self.running.iter().position(|r| r.2.id == id) {
            let (_, began, ..) = self.running.swap_remove(place);
            self.seen.busy.set(self.seen.busy.get() + now - began);
            self.cancelled.push(id);
        } else if let Some(place) = self.waiting.iter().position(|w| w.0.id == id) {
            self.waiting.remove(place);
            self.cancelled.push(id);
        }
    }

    fn width(&self) -> usize {
        self.width
    }

    fn cutoff_use(&self) -> CutoffUse {
        self.cutoff_use
    }
}
