//! Evaluations made ahead of need, kept until the path of the method comes to their points.
//!
//! They are no part of the run before that: they count in no budget, none is best, and what one of them ended with (a
//! failure, an exception) means nothing.

use crate::answer::{Answer, Outcome, Want};
use crate::evaluator::GivesUp;
use crate::objective::Query;
use crate::trace::SpeculativeEntry;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// So many are kept; the path comes to a point soon or never.
const MOST_KEPT: usize = 256;

/// First number of the points that are evaluated ahead; those of the path count from 0.
pub(crate) const FIRST_ID: u64 = 1 << 63;

/// What the objective would have said had it been asked this, as far as that is known.
fn answer_to(early: &SpeculativeEntry, query: &Query<'_>, gives_up: GivesUp) -> Option<Answer> {
    let cutoff = query.cutoff;
    let above = || Some(Answer { outcome: Outcome::Above(cutoff), ..early.answer.only(Want::Cost) });
    match &early.answer.outcome {
        Outcome::Value(value) if *value > cutoff && gives_up == GivesUp::Yes => above(),
        Outcome::Value(_) => early.answer.answers(query.want).then(|| early.answer.only(query.want)),
        Outcome::Above(c) => {
            if *c >= cutoff {
                above()
            } else {
                None
            }
        }
        // With a lower cutoff it might have been given up before.
        Outcome::Failed(_) | Outcome::Abort(_) => {
            let same = early.cutoff == cutoff || gives_up == GivesUp::No;
            same.then(|| early.answer.clone())
        }
        Outcome::Skipped => None,
    }
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct SpeculativeStore {
    kept: VecDeque<SpeculativeEntry>,
    /// Evaluations made ahead so far, and those of them that the path came to.
    n_made: u64,
    n_reached: u64,
}

impl SpeculativeStore {
    fn find(&self, x: &[f64]) -> Option<usize> {
        let same = |y: &[f64]| x.iter().zip(y).all(|(x, y)| x.to_bits() == y.to_bits());
        self.kept.iter().position(|early| same(&early.x))
    }

    pub(crate) fn contains(&self, x: &[f64]) -> bool {
        self.find(x).is_some()
    }

    /// Number of the next point.
    pub(crate) fn next_id(&self) -> u64 {
        FIRST_ID + self.n_made
    }

    /// Keeps an evaluation. Returns one that is of no use: the oldest where there is no room, or this one if it says
    /// nothing lasting about its point.
    pub(crate) fn keep(&mut self, early: SpeculativeEntry) -> Option<SpeculativeEntry> {
        self.n_made += 1;
        if matches!(early.answer.outcome, Outcome::Failed(_)) && !early.answer.outcome.is_lasting() {
            return Some(early);
        }
        self.kept.push_back(early);
        if self.kept.len() > MOST_KEPT { self.kept.pop_front() } else { None }
    }

    /// What is known of a point that the path has come to: its answer, or an evaluation that does not answer this query.
    pub(crate) fn take(
        &mut self,
        x: &[f64],
        query: Query<'_>,
        gives_up: GivesUp,
    ) -> Option<Result<Answer, SpeculativeEntry>> {
        let early = self.find(x).and_then(|place| self.kept.remove(place))?;
        Some(match answer_to(&early, &query, gives_up) {
            Some(answer) => {
                self.n_reached += 1;
                Ok(answer)
            }
            None => Err(early),
        })
    }

    /// Evaluations that the path has not come to.
    pub(crate) fn n_speculative(&self) -> usize {
        (self.n_made - self.n_reached) as usize
    }

    /// Takes out all that are kept.
    pub(crate) fn drain(&mut self) -> impl Iterator<Item = SpeculativeEntry> {
        std::mem::take(&mut self.kept).into_iter()
    }

    /// After a run was resumed: exceptions are gone with the process that raised them.
    pub(crate) fn forget_aborts(&mut self) {
        self.kept.retain(|early| !matches!(early.answer.outcome, Outcome::Abort(_)));
    }

    /// Whether its parts fit together: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.n_reached <= self.n_made
            && self.kept.len() <= MOST_KEPT
            && self.kept.iter().all(|early| early.x.len() == n)
    }
}
