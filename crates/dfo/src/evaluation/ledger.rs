//! Ledger of a run: counts, failures, the best point so far and the trace.

use crate::error::{Error, NothingFound};
use crate::method_interface::interface::Batch;
use crate::outcome::answer::FailureKind;
use crate::outcome::answer::{Answer, Best, EvaluationKind, Failure, Outcome};
use crate::outcome::trace::{Record, SpeculativeEntry, Trace};
use crate::problem::constraints::Constraints;
use serde::{Deserialize, Serialize};

/// Maximum number of reasons that are counted separately. Further reasons are counted together.
const MAX_REASONS: usize = 50;

/// Source of the outcome of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Source {
    /// The objective is called for the point.
    Run,
    /// The evaluation started speculatively, and the path now needs it.
    Begun,
    /// The objective is called for a point that is only known to be above a lower cutoff. The point counts as
    /// known.
    Again,
    /// The objective was called earlier, either speculatively or before the run was resumed.
    Replayed,
    /// The point is known from an evaluation of this run or an earlier run.
    Cached,
    /// The batch contains the same point at this index.
    Copy(usize),
    /// The budget does not allow the evaluation, or the run ends before it.
    Forbidden,
}

impl Source {
    /// True if the point is evaluated in this batch or was started before it.
    pub(crate) fn is_work(self) -> bool {
        matches!(self, Self::Run | Self::Begun | Self::Again)
    }
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Ledger {
    pub(crate) trace: Trace,
    trace_limit: Option<usize>,
    /// True if the trace keeps residuals.
    keeps_residuals: bool,
    /// Number of evaluations started speculatively, and number of them that the path reached while they were
    /// running.
    pub(crate) n_guessed: u64,
    pub(crate) n_adopted: usize,
    /// Number of evaluations started speculatively that ended before the path reached them.
    n_early: usize,
    /// Number of these evaluations that the path reached later.
    pub(crate) n_reached: usize,
    pub(crate) best: Best,
    /// Rank of the best point among infeasible points ([`Constraints::rank`]); 0 if it is feasible.
    #[serde(default)]
    best_rank: f64,
    /// Constraint values of the best point.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) best_constraints: Vec<f64>,
    /// Nonlinear constraints of the run.
    #[serde(skip)]
    pub(crate) constraints: Constraints,
    /// Residuals of the best point; empty if unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) best_residuals: Vec<f64>,
    pub(crate) n_evaluations: usize,
    pub(crate) n_failed: usize,
    /// Number of points whose cost was not evaluated, because a constraint is violated.
    #[serde(default)]
    pub(crate) n_infeasible: usize,
    /// Number of answers that the engine lost.
    #[serde(default)]
    pub(crate) n_lost: usize,
    pub(crate) n_cached: usize,
    /// Number of batches requested.
    pub(crate) n_batches: usize,
    /// Number of residuals of each point, once known.
    pub(crate) n_residuals: Option<usize>,
    failures: Vec<(String, usize)>,
    other_failures: usize,
    first_failure: Option<Vec<f64>>,
}

impl Ledger {
    pub(crate) fn new(n: usize, trace_limit: Option<usize>, keeps_residuals: bool) -> Self {
        Self {
            trace: Trace::new(n),
            trace_limit,
            keeps_residuals,
            n_guessed: 0,
            n_adopted: 0,
            n_early: 0,
            n_reached: 0,
            best: Best::default(),
            best_rank: 0.0,
            best_constraints: Vec::new(),
            constraints: Constraints::default(),
            best_residuals: Vec::new(),
            n_evaluations: 0,
            n_failed: 0,
            n_infeasible: 0,
            n_lost: 0,
            n_cached: 0,
            n_batches: 0,
            n_residuals: None,
            failures: Vec::new(),
            other_failures: 0,
            first_failure: None,
        }
    }

    /// Records a batch of the path: its answers and their sources, in request order.
    pub(crate) fn record(&mut self, batch: &Batch, answers: &[Answer], sources: &[Source]) {
        self.n_batches += usize::from(sources.contains(&Source::Run));
        for (k, answer) in answers.iter().enumerate() {
            let outcome = &answer.outcome;
            if matches!(outcome, Outcome::Skipped) {
                continue;
            }
            if matches!(sources[k], Source::Run | Source::Begun | Source::Replayed) {
                self.enter(batch, k, answer);
            } else if outcome.is_conclusive() {
                self.n_cached += 1;
            }
            // A cost above its cutoff is ignored, because the evaluation might have been abandoned.
            let Some(value) = outcome.value().filter(|v| *v <= batch.cutoff(k)) else { continue };
            let rank = self.constraints.rank(&answer.constraints);
            let is_best = self.best.offer_ranked(batch.point(k), value, rank, self.best_rank);
            if is_best {
                self.best_rank = rank;
                self.best_constraints.clone_from(&answer.constraints);
            }
            let wanted = batch.kind() == EvaluationKind::Residuals;
            // A cost without residuals may be evaluated again with them.
            if is_best || wanted && self.best.get() == Some((batch.point(k), value)) {
                self.best_residuals.clear();
                self.best_residuals.extend_from_slice(if wanted { &answer.residuals } else { &[] });
            }
        }
    }

    /// Compares the number of residuals at a point with the earlier points.
    ///
    /// # Errors
    /// Returns an error if the number differs, because the residuals can then not be matched to each other.
    pub(crate) fn count_residuals(&mut self, x: &[f64], answer: &Answer) -> Result<(), Error> {
        let got = answer.residuals.len();
        if got == 0 || answer.outcome.value().is_none() {
            return Ok(());
        }
        let expected = *self.n_residuals.get_or_insert(got);
        if got == expected { Ok(()) } else { Err(Error::ResidualCount { expected, got, x: x.to_vec() }) }
    }

    /// True if the best point satisfies the nonlinear constraints up to their tolerance.
    pub(crate) fn is_feasible(&self) -> bool {
        self.best_rank == 0.0
    }

    /// Checks the number of constraint values of a point with a cost.
    ///
    /// # Errors
    /// Returns an error if it is not the number of nonlinear constraints.
    pub(crate) fn check_constraints(&self, x: &[f64], answer: &Answer) -> Result<(), Error> {
        let (expected, got) = (self.constraints.nonlinear.len(), answer.constraints.len());
        if got == expected || answer.outcome.value().is_none() {
            return Ok(());
        }
        Err(Error::ConstraintCount { expected, got, x: x.to_vec() })
    }

    /// Counts an evaluation and adds it to the trace.
    fn enter(&mut self, batch: &Batch, k: usize, answer: &Answer) {
        self.n_evaluations += 1;
        let outcome = &answer.outcome;
        if let Outcome::Failed(Failure { kind, message }) = outcome
            && kind.is_of_point()
        {
            if *kind == FailureKind::Infeasible {
                self.n_infeasible += 1;
            } else {
                self.n_failed += 1;
                self.count_failure(batch.point(k), message);
            }
        }
        let record = Record {
            outcome: outcome.clone(),
            id: batch.id(k),
            batch: batch.index(),
            cutoff: batch.cutoff(k),
            used: outcome.is_conclusive(),
            seconds: answer.seconds,
            residuals: if self.keeps_residuals { answer.only(batch.kind()).residuals } else { Vec::new() },
            constraints: answer.constraints.clone(),
        };
        self.trace.push(batch.point(k), record);
    }

    /// Counts the reason of a failure.
    fn count_failure(&mut self, x: &[f64], message: &str) {
        self.first_failure.get_or_insert_with(|| x.to_vec());
        if let Some((_, count)) = self.failures.iter_mut().find(|(m, _)| m == message) {
            *count += 1;
        } else if self.failures.len() < MAX_REASONS {
            self.failures.push((message.to_owned(), 1));
        } else {
            self.other_failures += 1;
        }
    }

    /// Returns the number of evaluations that the path has not reached.
    pub(crate) fn n_speculative(&self) -> usize {
        self.n_early.saturating_sub(self.n_reached)
    }

    /// Returns the number of evaluations started speculatively that have not been useful so far.
    pub(crate) fn n_in_vain(&self) -> usize {
        (self.n_guessed as usize).saturating_sub(self.n_adopted + self.n_reached)
    }

    /// Counts an evaluation that the path has not reached.
    pub(crate) fn count_early(&mut self) {
        self.n_early += 1;
    }

    /// Records an evaluation that does not answer the query of the path at its point.
    pub(crate) fn useless(&mut self, entry: SpeculativeEntry) {
        self.n_early += 1;
        self.trace.push_speculative(entry);
    }

    /// Trims the trace. With `all`, trims to the limit; otherwise only from time to time.
    pub(crate) fn trim(&mut self, all: bool) {
        if let Some(limit) = self.trace_limit
            && (all || self.trace.longest() >= limit.saturating_mul(2).max(limit.saturating_add(64)))
        {
            self.trace.keep_last(limit);
        }
    }

    /// Returns the reasons of the failures, most frequent first.
    pub(crate) fn failures(&self) -> Vec<(String, usize)> {
        let mut list = self.failures.clone();
        list.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        if self.other_failures > 0 {
            list.push(("other reasons".to_owned(), self.other_failures));
        }
        list
    }

    /// Returns the evaluations of a run without a result.
    pub(crate) fn nothing_found(&self) -> Box<NothingFound> {
        Box::new(NothingFound {
            n_evaluations: self.n_evaluations,
            n_infeasible: self.n_infeasible,
            failures: self.failures(),
            x: self.first_failure.clone(),
            trace: self.trace.clone(),
        })
    }

    /// True if all parts are consistent. A ledger read from a file may be inconsistent.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.trace.is_sound(n)
            && self.best.is_sound(n)
            && self.best_rank >= 0.0
            && self.n_reached <= self.n_early
            && self.n_guessed < 1 << 60
    }
}
