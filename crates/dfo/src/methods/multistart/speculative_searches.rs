//! Searches that run ahead of the path. The path goes through all searches in turn, a batch of each at a
//! time; a search whose answers have come need not wait for the others: a copy of it asks for what the path
//! will come to.

use crate::method_interface::interface::{Batch, Method, Status};
use crate::outcome::answer::{Answer, Answers};
use std::collections::VecDeque;

/// Batches that a search may be ahead of the path.
const MOST_BATCHES: usize = 500;

/// A copy of a search that is ahead of it, or of one that is to start.
pub(super) struct SpeculativeSearches {
    pub(super) start: Vec<f64>,
    pub(super) method: Box<dyn Method + Send>,
    /// What it asks for.
    pub(super) asked: Batch,
    /// What it has been told and its search has not.
    told: VecDeque<Answers>,
    is_over: bool,
}

impl SpeculativeSearches {
    /// A copy of the search from this point.
    pub(super) fn new(start: Vec<f64>, method: Box<dyn Method + Send>) -> Self {
        let mut ahead = Self { start, method, asked: Batch::new(), told: VecDeque::new(), is_over: false };
        ahead.ask();
        ahead
    }

    fn ask(&mut self) {
        self.method.ask(&mut self.asked);
        self.is_over = self.method.status() != Status::Running || self.asked.is_empty();
    }

    fn tell(&mut self, answers: &Answers) -> bool {
        let is_told = !self.is_over && self.method.tell(answers).is_ok();
        if is_told {
            self.ask();
        }
        is_told
    }

    /// Whether it has gone farther than its search.
    pub(super) fn is_ahead(&self) -> bool {
        !self.told.is_empty()
    }

    /// Evaluations that it is ahead of its search.
    pub(super) fn n_ahead(&self) -> usize {
        self.told.iter().map(Answers::len).sum()
    }

    /// Its search is told this. Whether this is still the way that the search goes.
    pub(super) fn follow(&mut self, answers: &Answers) -> bool {
        match self.told.pop_front() {
            Some(before) => before == *answers,
            None => self.tell(answers),
        }
    }

    /// Goes on while all `answers` to what it asks for are there, by its batch, the place in it, and whether
    /// its search asks the same.
    pub(super) fn advance(&mut self, answer: &dyn Fn(&Batch, usize, bool) -> Option<Answer>) {
        while !self.is_over && self.told.len() < MOST_BATCHES {
            let mut answers = Answers::default();
            for k in 0..self.asked.len() {
                let Some(Answer { outcome, residuals, .. }) = answer(&self.asked, k, !self.is_ahead()) else {
                    return;
                };
                answers.push(outcome, &residuals);
            }
            if !self.tell(&answers) {
                return;
            }
            self.told.push_back(answers);
        }
    }

    /// The points that it asks for, with their cutoffs.
    pub(super) fn points(&self) -> impl Iterator<Item = (&[f64], f64)> {
        let len = if self.is_over { 0 } else { self.asked.len() };
        (0..len).map(|k| (self.asked.point(k), self.asked.cutoff(k)))
    }
}
