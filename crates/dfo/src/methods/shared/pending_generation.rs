//! Requests and answers of whole generations: the pending candidates, and the best point.

use crate::error::Error;
use crate::method_interface::interface::Batch;
use crate::methods::shared::cost::Cost;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::outcome::answer::{Answers, Best};
use crate::problem::constraints::Constraints;
use serde::{Deserialize, Serialize};

/// State of a method whose batches are the candidates without a cost.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct PendingGeneration {
    n_batches: u64,
    n_points: u64,
    /// Candidate of each point of the last batch.
    roles: Vec<usize>,
    waiting: bool,
    best: Best,
    /// Violation of the best point; 0 if it satisfies the constraints.
    #[serde(default, skip_serializing_if = "is_zero")]
    best_violation: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl PendingGeneration {
    pub(crate) fn with_capacity(candidates: usize) -> Self {
        Self { roles: Vec::with_capacity(candidates), ..Self::default() }
    }

    /// Starts a batch without points, after the method has ended.
    pub(crate) fn ask_nothing(&mut self, batch: &mut Batch, n_user: usize) {
        batch.start(n_user, self.n_batches, self.n_points);
        self.roles.clear();
        self.waiting = false;
    }

    /// Requests all candidates without a cost.
    pub(crate) fn ask(
        &mut self,
        batch: &mut Batch,
        n_user: usize,
        candidates: &RankedPoints,
        cutoff: impl Fn(usize) -> f64,
    ) {
        self.ask_nothing(batch, n_user);
        for slot in 0..candidates.len() {
            if candidates.cost(slot) == Cost::Pending {
                batch.push(candidates.x(slot), cutoff(slot));
                self.roles.push(slot);
            }
        }
        self.waiting = !self.roles.is_empty();
    }

    /// Records outcomes of a problem without nonlinear constraints. Returns true if all candidates now have a
    /// cost.
    pub(crate) fn tell(&mut self, answers: &Answers, candidates: &mut RankedPoints) -> Result<bool, Error> {
        let constraints = Constraints::default();
        let cost_of = |_, k: usize| Cost::of(&answers.outcomes()[k], &constraints, &[]);
        self.tell_ranked(answers, &constraints, candidates, cost_of)
    }

    /// Records outcomes. `cost_of` returns the cost by which a candidate ranks, from its slot and its
    /// position among the answers. Returns true if all candidates now have a cost.
    pub(crate) fn tell_ranked(
        &mut self,
        answers: &Answers,
        constraints: &Constraints,
        candidates: &mut RankedPoints,
        mut cost_of: impl FnMut(usize, usize) -> Cost,
    ) -> Result<bool, Error> {
        let (requested, outcomes) = (self.roles.len(), answers.outcomes());
        if !self.waiting {
            return Err(Error::TellWithoutAsk);
        }
        if outcomes.len() > requested {
            return Err(Error::TooManyOutcomes { requested, received: outcomes.len() });
        }
        self.waiting = false;
        self.n_batches += 1;
        self.n_points += requested as u64;
        for (k, outcome) in outcomes.iter().enumerate().filter(|(_, o)| o.is_conclusive()) {
            let slot = self.roles[k];
            // A candidate stopped above the target's cost is treated like a failed one.
            candidates.set_cost(slot, cost_of(slot, k));
            let Some(value) = outcome.value() else { continue };
            let violation = constraints.rank(answers.constraints(k));
            if self.best.offer_ranked(candidates.x(slot), value, violation, self.best_violation) {
                self.best_violation = violation;
            }
        }
        Ok(!candidates.is_pending())
    }

    /// Returns the position of a candidate in the last batch.
    pub(crate) fn place_of(&self, slot: usize) -> Option<usize> {
        self.roles.binary_search(&slot).ok()
    }

    /// Returns the numbers of answered batches and points.
    pub(crate) fn counts(&self) -> (u64, u64) {
        (self.n_batches, self.n_points)
    }

    pub(crate) fn best(&self) -> Option<(&[f64], f64)> {
        self.best.get()
    }

    /// Returns the violation of the best point; 0 if it satisfies the constraints.
    pub(crate) fn best_violation(&self) -> f64 {
        self.best_violation
    }

    /// Returns the rank of the best point: its cost, or its violation if no point satisfies the constraints.
    pub(crate) fn best_cost(&self) -> Cost {
        match self.best.cost() {
            _ if self.best_violation > 0.0 => Cost::Infeasible(self.best_violation),
            Some(cost) => Cost::Value(cost),
            None => Cost::Failed,
        }
    }

    /// True if the state is consistent. State loaded from a file may be inconsistent.
    pub(crate) fn is_sound(&self, n_user: usize) -> bool {
        self.best.is_sound(n_user)
    }
}
