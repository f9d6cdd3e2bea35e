//! Evaluation on the calling thread, one point per poll.

use super::evaluator::{CutoffUse, Evaluator, PollResult, Wait, call, cutoff_use};
use crate::outcome::answer::Answer;
use crate::problem::objective::{Objective, Query};
use std::collections::VecDeque;

/// A point that waits for its evaluation.
struct Waiting {
    x: Vec<f64>,
    query: Query<'static>,
    is_cancelled: bool,
}

pub(crate) struct CallingThread<'a> {
    objective: &'a dyn Objective,
    waiting: VecDeque<Waiting>,
    spare: Vec<Vec<f64>>,
}

impl<'a> CallingThread<'a> {
    pub(crate) fn new(objective: &'a dyn Objective) -> Self {
        Self { objective, waiting: VecDeque::new(), spare: Vec::new() }
    }
}

impl Evaluator for CallingThread<'_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let mut buffer = self.spare.pop().unwrap_or_default();
        buffer.clear();
        buffer.extend_from_slice(x);
        self.waiting.push_back(Waiting { x: buffer, query, is_cancelled: false });
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        let Some(Waiting { x, query, is_cancelled }) = self.waiting.pop_front() else {
            return PollResult::Idle;
        };
        match is_cancelled {
            true => answer.clear(),
            false => call(self.objective, &x, &query.ended_by(wait.signals), answer),
        }
        self.spare.push(x);
        PollResult::Answered(query.id)
    }

    fn cancel(&mut self, id: u64) {
        self.waiting
            .iter_mut()
            .filter(|point| point.query.id == id)
            .for_each(|point| point.is_cancelled = true);
    }

    fn width(&self) -> usize {
        1
    }

    fn cutoff_use(&self) -> CutoffUse {
        cutoff_use(self.objective)
    }
}
