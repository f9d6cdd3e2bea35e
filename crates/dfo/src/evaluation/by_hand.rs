//! Evaluation by the caller: points wait until they are requested and until the caller answers them.

use super::evaluator::{Evaluator, PollResult, Wait};
use crate::outcome::answer::Answer;
use crate::problem::objective::Query;
use std::collections::{BTreeMap, VecDeque};
use std::time::Instant;

/// A point that waits for an answer.
#[derive(Debug, Clone)]
pub(crate) struct Handed {
    pub(crate) x: Vec<f64>,
    pub(crate) query: Query<'static>,
    since: Instant,
    is_cancelled: bool,
}

#[derive(Debug)]
pub(crate) struct ByHand {
    workers: usize,
    /// Points that are not handed out yet, in order.
    due: VecDeque<Handed>,
    /// Points that are handed out, by id.
    out: BTreeMap<u64, Handed>,
    reported: VecDeque<(u64, Answer)>,
}

impl ByHand {
    pub(crate) fn new(workers: usize) -> Self {
        Self { workers, due: VecDeque::new(), out: BTreeMap::new(), reported: VecDeque::new() }
    }

    /// Hands out the next point and returns it.
    pub(crate) fn hand_out(&mut self) -> Option<&Handed> {
        let mut next = self.due.pop_front()?;
        next.since = Instant::now();
        Some(self.out.entry(next.query.id).or_insert(next))
    }

    /// Removes a point from the points that are handed out.
    pub(crate) fn take_back(&mut self, id: u64) -> Option<Handed> {
        self.out.remove(&id)
    }

    /// Processes the answer to a withdrawn point. If the answer is not final, the point is handed
    /// out again.
    pub(crate) fn answered(&mut self, handed: Handed, mut answer: Answer, is_final: bool) {
        if !is_final && handed.is_cancelled {
            self.reported.push_back((handed.query.id, Answer::default()));
        } else if is_final {
            answer.seconds = handed.since.elapsed().as_secs_f64();
            self.reported.push_back((handed.query.id, answer));
        } else {
            self.due.push_front(handed);
        }
    }

    /// Returns the number of points that are handed out and not answered yet.
    pub(crate) fn n_pending(&self) -> usize {
        self.out.len()
    }
}

impl Evaluator for ByHand {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        self.due.push_back(Handed { x: x.to_vec(), query, since: Instant::now(), is_cancelled: false });
    }

    fn poll(&mut self, _: &Wait<'_>, answer: &mut Answer) -> PollResult {
        match self.reported.pop_front() {
            Some((id, reported)) => {
                *answer = reported;
                PollResult::Answered(id)
            }
            None if self.due.is_empty() && self.out.is_empty() => PollResult::Idle,
            None => PollResult::Waiting,
        }
    }

    fn cancel(&mut self, id: u64) {
        if let Some(place) = self.due.iter().position(|point| point.query.id == id) {
            self.due.remove(place);
            self.reported.push_back((id, Answer::default()));
        } else if let Some(handed) = self.out.get_mut(&id) {
            handed.is_cancelled = true;
        }
    }

    fn width(&self) -> usize {
        self.workers
    }

    /// Returns the whole plan, however many points the user can evaluate at once.
    fn capacity(&self, plan: usize) -> usize {
        plan
    }

    fn leave(&mut self) -> bool {
        true
    }
}
