//! Evaluations made ahead of need, kept until the path of the method comes to their points.
//!
//! They are no part of the run before that: they count in no budget, none is best, and what one of them ended with (a
//! failure, an exception) means nothing.

use crate::objective::{FailureKind, Outcome};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// So many are kept; the path comes to a point soon or never.
const MOST_KEPT: usize = 256;

/// First number of the points that are evaluated ahead; those of the path count from 0.
pub(crate) const FIRST_ID: u64 = 1 << 63;

/// Whether an objective gives up above its cutoff; what it says elsewhere than below it depends on the cutoff then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum GivesUp {
    Yes,
    No,
    Unknown,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Early {
    pub(crate) id: u64,
    pub(crate) batch: u64,
    pub(crate) x: Vec<f64>,
    pub(crate) cutoff: f64,
    pub(crate) outcome: Outcome,
    pub(crate) seconds: f64,
}

impl Early {
    /// What the objective would have said had it been told this cutoff, as far as that is known.
    fn with_cutoff(&self, cutoff: f64, gives_up: GivesUp) -> Option<Outcome> {
        match &self.outcome {
            Outcome::Value(value) if *value > cutoff && gives_up == GivesUp::Yes => {
                Some(Outcome::Above(cutoff))
            }
            Outcome::Value(_) => Some(self.outcome.clone()),
            Outcome::Above(above) => (*above >= cutoff).then_some(Outcome::Above(cutoff)),
            // With a lower cutoff it might have been given up before.
            Outcome::Failed(_) | Outcome::Abort(_) => {
                let same = self.cutoff == cutoff || gives_up == GivesUp::No;
                same.then(|| self.outcome.clone())
            }
            Outcome::Skipped => None,
        }
    }
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Ahead {
    kept: VecDeque<Early>,
    /// Evaluations made ahead so far, and those of them that the path came to.
    n_made: u64,
    n_reached: u64,
}

impl Ahead {
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
    pub(crate) fn keep(&mut self, early: Early) -> Option<Early> {
        self.n_made += 1;
        let passing = |kind| matches!(kind, FailureKind::Cancelled | FailureKind::TimedOut);
        match &early.outcome {
            Outcome::Failed(failure) if passing(failure.kind) => return Some(early),
            _ => {}
        }
        self.kept.push_back(early);
        if self.kept.len() > MOST_KEPT { self.kept.pop_front() } else { None }
    }

    /// What is known of a point that the path has come to: the outcome and its seconds, or an evaluation that does not
    /// answer for this cutoff.
    pub(crate) fn take(
        &mut self,
        x: &[f64],
        cutoff: f64,
        gives_up: GivesUp,
    ) -> Option<Result<(Outcome, f64), Early>> {
        let early = self.find(x).and_then(|place| self.kept.remove(place))?;
        Some(match early.with_cutoff(cutoff, gives_up) {
            Some(outcome) => {
                self.n_reached += 1;
                Ok((outcome, early.seconds))
            }
            None => Err(early),
        })
    }

    /// Evaluations that the path has not come to.
    pub(crate) fn n_speculative(&self) -> usize {
        (self.n_made - self.n_reached) as usize
    }

    /// Takes out all that are kept.
    pub(crate) fn drain(&mut self) -> impl Iterator<Item = Early> {
        std::mem::take(&mut self.kept).into_iter()
    }

    /// After a run was resumed: exceptions are gone with the process that raised them.
    pub(crate) fn forget_aborts(&mut self) {
        self.kept.retain(|early| !matches!(early.outcome, Outcome::Abort(_)));
    }

    /// Whether its parts fit together: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.n_reached <= self.n_made
            && self.kept.len() <= MOST_KEPT
            && self.kept.iter().all(|early| early.x.len() == n)
    }
}
