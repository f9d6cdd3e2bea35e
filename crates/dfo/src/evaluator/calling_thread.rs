//! One point after the other on the calling thread, each when it is polled.

use super::calls::{Evaluator, GivesUp, Polled, Wait, call};
use crate::answer::Answer;
use crate::objective::{Objective, Query};
use std::collections::VecDeque;

pub(crate) struct CallingThread<'a> {
    objective: &'a dyn Objective,
    waiting: VecDeque<(Vec<f64>, Query<'static>)>,
    spare: Vec<Vec<f64>>,
}

impl<'a> CallingThread<'a> {
    pub(crate) fn new(objective: &'a dyn Objective) -> Self {
        Self { objective, waiting: VecDeque::new(), spare: Vec::new() }
    }

    /// Whether the objective gives up above its cutoff.
    pub(crate) fn gives_up(&self) -> GivesUp {
        if self.objective.uses_cutoff() { GivesUp::Yes } else { GivesUp::No }
    }
}

impl Evaluator for CallingThread<'_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let mut buffer = self.spare.pop().unwrap_or_default();
        buffer.clear();
        buffer.extend_from_slice(x);
        self.waiting.push_back((buffer, query));
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        let Some((x, query)) = self.waiting.pop_front() else { return Polled::Idle };
        call(self.objective, &x, &query.ended_by(wait.signals), answer);
        self.spare.push(x);
        Polled::Answered(query.id)
    }

    fn withdraw(&mut self) {
        self.spare.extend(self.waiting.drain(..).map(|(x, _)| x));
    }
}
