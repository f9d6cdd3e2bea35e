//! Copies of searches that run ahead of the path.
//!
//! The path processes all searches in turn, one batch of each at a time. A search whose answers are available
//! does not need to wait for the others. Its copy requests the points that the path will need later.

use crate::method_interface::interface::{Batch, Method, Status};
use crate::outcome::answer::{Answer, Answers};
use std::collections::VecDeque;

/// Maximum number of batches by which a copy may be ahead of the path.
const MOST_BATCHES: usize = 500;

/// A copy that is ahead of a running search, or of a search that has not started.
pub(super) struct SpeculativeSearches {
    pub(super) start: Vec<f64>,
    pub(super) method: Box<dyn Method + Send>,
    /// Points requested by the copy.
    pub(super) requested: Batch,
    /// Answers processed by the copy but not yet by the search.
    received: VecDeque<Answers>,
    is_over: bool,
}

impl SpeculativeSearches {
    /// Creates a copy of the search from this point.
    pub(super) fn new(start: Vec<f64>, method: Box<dyn Method + Send>) -> Self {
        let mut ahead =
            Self { start, method, requested: Batch::new(), received: VecDeque::new(), is_over: false };
        ahead.ask();
        ahead
    }

    fn ask(&mut self) {
        self.method.ask(&mut self.requested);
        self.is_over = self.method.status() != Status::Running || self.requested.is_empty();
    }

    fn tell(&mut self, answers: &Answers) -> bool {
        let is_received = !self.is_over && self.method.tell(answers).is_ok();
        if is_received {
            self.ask();
        }
        is_received
    }

    /// True if the copy is ahead of its search.
    pub(super) fn is_ahead(&self) -> bool {
        !self.received.is_empty()
    }

    /// Returns the number of evaluations by which the copy is ahead of its search.
    pub(super) fn n_ahead(&self) -> usize {
        self.received.iter().map(Answers::len).sum()
    }

    /// Follows the search, which has processed `answers`. Returns true if the copy is still on the path of
    /// the search.
    pub(super) fn follow(&mut self, answers: &Answers) -> bool {
        match self.received.pop_front() {
            Some(before) => before == *answers,
            None => self.tell(answers),
        }
    }

    /// Advances the copy while all answers to its requests are available. The arguments of `answer` are the
    /// batch, the index in the batch, and whether the search requests the same batch.
    pub(super) fn advance(&mut self, answer: &dyn Fn(&Batch, usize, bool) -> Option<Answer>) {
        while !self.is_over && self.received.len() < MOST_BATCHES {
            let mut answers = Answers::default();
            for k in 0..self.requested.len() {
                let Some(answer) = answer(&self.requested, k, !self.is_ahead()) else { return };
                let Answer { outcome, residuals, constraints, .. } = answer;
                answers.push(outcome, &residuals);
                if !constraints.is_empty() {
                    answers.set_constraints(&constraints);
                }
            }
            if !self.tell(&answers) {
                return;
            }
            self.received.push_back(answers);
        }
    }

    /// Returns the requested points with their cutoffs.
    pub(super) fn points(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let len = if self.is_over { 0 } else { self.requested.len() };
        (0..len).map(|k| (self.requested.point(k), self.requested.cutoff(k)))
    }
}
