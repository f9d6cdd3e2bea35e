//! Points that the searches may need next, from copies of the searches that run ahead of the path.

use super::speculative_searches::SpeculativeSearches;
use super::state::{MultistartState, SIDE_BY_SIDE, Search};
use crate::method_interface::interface::{AnswersSoFar, Batch, MethodOptions};
use crate::outcome::answer::EvaluationKind;
use crate::problem::objective::Query;

impl MultistartState {
    /// Advances copies of the running searches and of the next ones in the queue as far as answers are
    /// available.
    pub(super) fn look_ahead(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        let kind =
            if self.options.needs_residuals() { EvaluationKind::Residuals } else { EvaluationKind::Cost };
        let at = |requested: &Batch, k: usize| {
            let cutoff = if kind == EvaluationKind::Cost { requested.cutoff(k) } else { f64::INFINITY };
            answers_so_far.ahead(requested.point(k), &Query::new(0, 0, cutoff).kind(kind))
        };
        let mut left = wanted;
        let (mut first, mut n_ahead) = (0, 0);
        for j in 0..self.searches.len() {
            let (place, Some(mut ahead)) = (first, self.take_ahead(j)) else { return };
            first += self.searches[j].requested.len();
            let is_requested = first > place;
            ahead.advance(&|requested, k, is_same| {
                if is_same && is_requested {
                    answers_so_far.answer(place + k).cloned()
                } else {
                    at(requested, k)
                }
            });
            n_ahead += ahead.n_ahead();
            if ahead.is_ahead() || !is_requested {
                for (x, cutoff) in ahead.points() {
                    batch.push(x, cutoff);
                    left = left.saturating_sub(usize::from(!answers_so_far.contains(x)));
                }
            }
            self.ahead.push(ahead);
        }
        // The first search after an exploration may need the rest of the budget, so no other search is
        // certain. After it has ended, parallel searches will share the workers with it. Nelder-Mead gains
        // nothing beyond four workers (benches/scaling.md). With more parallel searches, the budget reaches
        // fewer of them.
        let is_alone = self.needs_the_rest();
        let n_next = if is_alone { self.core.queue.len().min(SIDE_BY_SIDE) } else { 0 };
        let share = (wanted / 2).div_ceil(1 + n_next);
        if is_alone {
            batch.all_certain();
            self.guess(share, answers_so_far, batch);
        }
        // Next searches in the queue, unless the budget ends before.
        let mut budget = self.core.setup.max_evaluations.map_or(usize::MAX, |most| {
            most.saturating_sub(self.core.n_points as usize + self.requested.len() + n_ahead)
        });
        for k in 0..self.core.queue.len() {
            if left == 0 || budget == 0 {
                break;
            }
            let start = self.core.queue[k].clone();
            let before = self.ahead.iter().position(|ahead| ahead.start == start);
            let mut ahead = match before {
                Some(place) => self.ahead.swap_remove(place),
                None => match self.options.search(&self.setup_at(&start), None) {
                    Ok(method) => SpeculativeSearches::new(start, method),
                    Err(_) => break,
                },
            };
            ahead.advance(&|requested, k, _| at(requested, k));
            budget = budget.saturating_sub(ahead.n_ahead());
            for (x, cutoff) in ahead.points().take(budget) {
                batch.push(x, cutoff);
                left = left.saturating_sub(usize::from(!answers_so_far.contains(x)));
                budget -= 1;
            }
            if k < n_next {
                ahead.method.speculate(share.saturating_sub(1), answers_so_far, batch);
                left = left.saturating_sub(share);
            }
            self.ahead.push(ahead);
        }
        if !is_alone {
            batch.all_certain();
            self.guess(left, answers_so_far, batch);
        }
    }

    /// Adds points that the least advanced searches may need, the same number for each search. The path waits
    /// for these searches next.
    fn guess(&mut self, wanted: usize, answers_so_far: &dyn AnswersSoFar, batch: &mut Batch) {
        let Self { searches, ahead, .. } = self;
        let is_under_way =
            |ahead: &SpeculativeSearches| searches.iter().any(|search| search.start == ahead.start);
        let mut last: Vec<&mut SpeculativeSearches> =
            ahead.iter_mut().filter(|ahead| is_under_way(ahead)).collect();
        let least = last.iter().map(|ahead| ahead.n_ahead()).min();
        last.retain(|ahead| Some(ahead.n_ahead()) == least);
        let share = wanted.div_ceil(last.len().max(1));
        last.into_iter().for_each(|ahead| ahead.method.speculate(share, answers_so_far, batch));
    }

    /// Returns the stored copy of a running search, or a new copy.
    fn take_ahead(&mut self, j: usize) -> Option<SpeculativeSearches> {
        let Search { start, method, .. } = &self.searches[j];
        if let Some(place) = self.ahead.iter().position(|ahead| ahead.start == *start) {
            return Some(self.ahead.swap_remove(place));
        }
        let copy = self.options.search(&self.setup_at(start), Some(&method.save()?)).ok()?;
        Some(SpeculativeSearches::new(start.clone(), copy))
    }
}
