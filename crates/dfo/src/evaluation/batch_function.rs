//! Evaluation by a user function that computes whole batches on the calling thread.

use super::evaluator::{CutoffUse, Evaluator, PollResult, Wait, panicked};
use crate::outcome::answer::{Answer, Failure, Outcome};
use crate::problem::objective::{CancelSignals, Query};
use std::cell::{Cell, RefCell};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// Points that a user function has to evaluate.
#[derive(Debug, Clone, Copy)]
pub struct BatchView<'a> {
    n: usize,
    points: &'a [f64],
    queries: &'a [Query<'static>],
    signals: CancelSignals<'a>,
    details: &'a [PointDetails],
}

/// Values that the function sets for a point in addition to its outcome.
#[derive(Debug, Default)]
struct PointDetails {
    seconds: Cell<Option<f64>>,
    work: Cell<u64>,
    residuals: RefCell<Vec<f64>>,
    constraints: RefCell<Vec<f64>>,
}

impl<'a> BatchView<'a> {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.queries.len()
    }

    /// True if there are no points.
    pub fn is_empty(&self) -> bool {
        self.queries.is_empty()
    }

    /// Returns the number of parameters.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Returns point `k` in the user's units.
    pub fn point(&self, k: usize) -> &'a [f64] {
        &self.points[k * self.n..(k + 1) * self.n]
    }

    /// Returns all points, row by row.
    pub fn as_flat(&self) -> &'a [f64] {
        self.points
    }

    /// Returns the query for point `k`: the kind of values, the cutoff, the ids and the cancel flag.
    pub fn query(&self, k: usize) -> Query<'a> {
        self.queries[k].ended_by(self.signals)
    }

    /// Sets the duration of point `k` in seconds, for the trace. By default, it is an equal fraction of the
    /// time of the call.
    pub fn set_seconds(&self, k: usize, seconds: f64) {
        self.details[k].seconds.set(Some(seconds));
    }

    /// Sets the work of point `k`, in a unit chosen by the function.
    pub fn set_work(&self, k: usize, work: u64) {
        self.details[k].work.set(work);
    }

    /// Sets the residuals of point `k`, if the query requests them.
    pub fn set_residuals(&self, k: usize, residuals: &[f64]) {
        let mut copy = self.details[k].residuals.borrow_mut();
        copy.clear();
        copy.extend_from_slice(residuals);
    }

    /// Sets the values of the nonlinear constraints at point `k`.
    pub fn set_constraints(&self, k: usize, values: &[f64]) {
        let mut copy = self.details[k].constraints.borrow_mut();
        copy.clear();
        copy.extend_from_slice(values);
    }
}

/// A function that evaluates whole batches on the calling thread: one outcome per point, in order.
pub(crate) type BatchFunction<'a> = dyn FnMut(&BatchView<'_>) -> Vec<Outcome> + 'a;

/// Minimum speed-up for speculative evaluations. If evaluating several points together is not faster by
/// this factor than one by one, no points are evaluated ahead.
const LEAST_GAIN: f64 = 1.5;

pub(crate) struct Batches<'a> {
    function: &'a mut BatchFunction<'a>,
    workers: usize,
    cutoff_use: CutoffUse,
    /// Speed-up of evaluating the points of the last calls together compared with one by one, as reported by
    /// the function.
    gain: Option<f64>,
    points: Vec<f64>,
    queries: Vec<Query<'static>>,
    /// Answers; the entries before `next` have already been returned.
    answers: Vec<Answer>,
    next: usize,
    /// Ids of points cancelled before the function received them.
    withdrawn: Vec<u64>,
    /// Points that are passed one by one after a panic.
    alone: Range<usize>,
}

impl<'a> Batches<'a> {
    /// Creates the evaluator. `workers` is the number of points that a batch should have if the path needs
    /// fewer.
    pub(crate) fn new(function: &'a mut BatchFunction<'a>, workers: usize, cutoff_use: CutoffUse) -> Self {
        Self {
            function,
            workers,
            cutoff_use,
            gain: None,
            points: Vec::new(),
            queries: Vec::new(),
            answers: Vec::new(),
            next: 0,
            withdrawn: Vec::new(),
            alone: 0..0,
        }
    }

    /// Calls the function once. Returns an error if it panics.
    fn call(&mut self, places: Range<usize>, signals: CancelSignals<'_>) -> Result<(), Failure> {
        let (len, n) = (places.len(), self.points.len() / self.queries.len().max(1));
        let details: Vec<PointDetails> = std::iter::repeat_with(PointDetails::default).take(len).collect();
        let points = &self.points[places.start * n..places.end * n];
        let view =
            BatchView { n, points, queries: &self.queries[places.clone()], signals, details: &details };
        let start = Instant::now();
        let outcomes = catch_unwind(AssertUnwindSafe(|| (self.function)(&view)))
            .map_err(|payload| panicked(payload.as_ref()))?;
        let in_all = start.elapsed().as_secs_f64();
        let share = in_all / len as f64;
        let got = outcomes.len();
        let first = places.start;
        let answers = &mut self.answers[places.clone()];
        if got != len {
            let message = format!("the objective returned {got} outcomes for a batch of {len} points");
            answers[0].outcome = Outcome::Abort(message);
            return Ok(());
        }
        for (((answer, outcome), details), k) in answers.iter_mut().zip(outcomes).zip(details).zip(places) {
            answer.outcome = match outcome {
                // An interrupted function skips points.
                Outcome::Skipped => Outcome::Skipped,
                other => other.checked(self.queries[k].cutoff),
            };
            answer.seconds = details.seconds.get().unwrap_or(share);
            answer.work = details.work.get();
            answer.residuals = details.residuals.into_inner();
            answer.constraints = details.constraints.into_inner();
        }
        if len > 1 && in_all > 0.0 {
            let gain =
                self.answers[first..first + len].iter().map(|answer| answer.seconds).sum::<f64>() / in_all;
            self.gain = Some(self.gain.map_or(gain, |before| 0.5 * (before + gain)));
        }
        Ok(())
    }
}

impl Evaluator for Batches<'_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        if self.next == self.queries.len() {
            (self.next, self.alone) = (0, 0..0);
            self.points.clear();
            self.queries.clear();
            self.answers.clear();
        }
        self.points.extend_from_slice(x);
        self.queries.push(query);
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        if let Some(id) = self.withdrawn.pop() {
            answer.clear();
            return PollResult::Answered(id);
        }
        let len = self.queries.len();
        if self.next == len {
            return PollResult::Idle;
        }
        if self.answers.len() < len {
            // Points submitted while the answers of the last call were returned.
            let new = self.answers.len()..len;
            self.answers.resize_with(len, Answer::default);
            match self.call(new.clone(), wait.signals) {
                Ok(()) => {}
                Err(why) if new.len() == 1 => self.answers[new.start].outcome = Outcome::Failed(why),
                // A panic at one point must not make the other points fail.
                Err(_) => self.alone = new,
            }
        }
        let k = self.next;
        if self.alone.contains(&k)
            && let Err(why) = self.call(k..k + 1, wait.signals)
        {
            self.answers[k].outcome = Outcome::Failed(why);
        }
        self.next += 1;
        std::mem::swap(answer, &mut self.answers[k]);
        PollResult::Answered(self.queries[k].id)
    }

    fn cancel(&mut self, id: u64) {
        let (first, n) = (self.answers.len(), self.points.len() / self.queries.len().max(1));
        if let Some(k) = (first..self.queries.len()).find(|&k| self.queries[k].id == id) {
            self.queries.remove(k);
            self.points.drain(k * n..(k + 1) * n);
            self.withdrawn.push(id);
        } else if let Some(k) = self.alone.clone().find(|&k| k >= self.next && self.queries[k].id == id) {
            // A point that would be passed alone is skipped.
            self.alone.end = self.alone.end.min(k);
        }
    }

    fn width(&self) -> usize {
        self.workers
    }

    fn capacity(&self, plan: usize) -> usize {
        plan
    }

    fn cutoff_use(&self) -> CutoffUse {
        self.cutoff_use
    }

    fn is_ready(&self) -> bool {
        self.next < self.answers.len()
    }

    fn pays_ahead(&self) -> bool {
        self.workers > 1 && self.gain.is_none_or(|gain| gain > LEAST_GAIN)
    }
}
