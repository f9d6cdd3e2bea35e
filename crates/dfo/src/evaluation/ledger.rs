//! Record of a run: every count, the failures, the best point so far, the trace.

use crate::error::{Error, NothingFound};
use crate::method_interface::interface::Batch;
use crate::outcome::answer::{Answer, Best, Failure, Outcome, Want};
use crate::outcome::trace::{Record, SpeculativeEntry, Trace};
use serde::{Deserialize, Serialize};

/// Reasons counted one by one; what comes beyond is counted together.
const MAX_REASONS: usize = 50;

/// Where the outcome of a point comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Source {
    /// The objective is called for it.
    Run,
    /// It was begun ahead of need, and is waited for.
    Begun,
    /// The same, for a point of which only that it lies above a lower cutoff is known: it counts as known.
    Again,
    /// The objective was called for it before: ahead of need, or before the run was resumed.
    Replayed,
    /// It is known from another point of this run or an earlier one.
    Cached,
    /// The same point stands at this place of the batch.
    Copy(usize),
    /// The budget forbids it, or the run ends before it.
    Forbidden,
}

impl Source {
    /// True if the point is evaluated in this batch, or was begun before it.
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
    /// Evaluations begun ahead of need, and those of them that the path came to while they were under way.
    pub(crate) n_guessed: u64,
    pub(crate) n_adopted: usize,
    /// Those that ended before, and those of them that the path came to.
    n_early: usize,
    pub(crate) n_reached: usize,
    pub(crate) best: Best,
    /// The residuals of the best point; empty where they are not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) best_residuals: Vec<f64>,
    pub(crate) n_evaluations: usize,
    pub(crate) n_failed: usize,
    /// Answers that the engine lost.
    #[serde(default)]
    pub(crate) n_lost: usize,
    pub(crate) n_cached: usize,
    /// Number of batches requested.
    pub(crate) n_batches: usize,
    /// Number of residuals of each point, once one has some.
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
            best_residuals: Vec::new(),
            n_evaluations: 0,
            n_failed: 0,
            n_lost: 0,
            n_cached: 0,
            n_batches: 0,
            n_residuals: None,
            failures: Vec::new(),
            other_failures: 0,
            first_failure: None,
        }
    }

    /// Enters a batch of the path: its answers and their sources, in request order.
    pub(crate) fn record(&mut self, batch: &Batch, answers: &[Answer], sources: &[Source]) {
        self.n_batches += usize::from(sources.contains(&Source::Run));
        for (k, answer) in answers.iter().enumerate() {
            let outcome = &answer.outcome;
            if matches!(outcome, Outcome::Skipped) {
                continue;
            }
            if matches!(sources[k], Source::Run | Source::Begun | Source::Replayed) {
                self.enter(batch, k, answer);
            } else if outcome.is_known() {
                self.n_cached += 1;
            }
            // What lies above its cutoff might as well have been given up, and must not make a difference.
            let Some(value) = outcome.value().filter(|v| *v <= batch.cutoff(k)) else { continue };
            let is_best = self.best.offer(batch.point(k), value);
            let wanted = batch.want() == Want::Residuals;
            // A cost that was known without residuals may come again with them.
            if is_best || wanted && self.best.get() == Some((batch.point(k), value)) {
                self.best_residuals.clear();
                self.best_residuals.extend_from_slice(if wanted { &answer.residuals } else { &[] });
            }
        }
    }

    /// Compares the number of residuals at a point with that of the points before.
    ///
    /// # Errors
    /// It is another one: nothing can be said then about what any of them is the residual of.
    pub(crate) fn count_residuals(&mut self, x: &[f64], answer: &Answer) -> Result<(), Error> {
        let got = answer.residuals.len();
        if got == 0 || answer.outcome.value().is_none() {
            return Ok(());
        }
        let expected = *self.n_residuals.get_or_insert(got);
        if got == expected { Ok(()) } else { Err(Error::ResidualCount { expected, got, x: x.to_vec() }) }
    }

    /// Counts an evaluation and keeps it in the trace.
    fn enter(&mut self, batch: &Batch, k: usize, answer: &Answer) {
        self.n_evaluations += 1;
        let outcome = &answer.outcome;
        if let Outcome::Failed(Failure { kind, message }) = outcome
            && kind.is_of_point()
        {
            self.n_failed += 1;
            self.first_failure.get_or_insert_with(|| batch.point(k).to_vec());
            if let Some((_, count)) = self.failures.iter_mut().find(|(m, _)| m == message) {
                *count += 1;
            } else if self.failures.len() < MAX_REASONS {
                self.failures.push((message.clone(), 1));
            } else {
                self.other_failures += 1;
            }
        }
        let record = Record {
            outcome: outcome.clone(),
            id: batch.id(k),
            batch: batch.index(),
            cutoff: batch.cutoff(k),
            used: outcome.is_known(),
            seconds: answer.seconds,
            residuals: if self.keeps_residuals { answer.only(batch.want()).residuals } else { Vec::new() },
        };
        self.trace.push(batch.point(k), record);
    }

    /// Evaluations that the path has not come to.
    pub(crate) fn n_speculative(&self) -> usize {
        self.n_early.saturating_sub(self.n_reached)
    }

    /// Evaluations begun ahead of need that have been of no use by now.
    pub(crate) fn n_in_vain(&self) -> usize {
        (self.n_guessed as usize).saturating_sub(self.n_adopted + self.n_reached)
    }

    /// An evaluation was made that the path has not come to.
    pub(crate) fn count_early(&mut self) {
        self.n_early += 1;
    }

    /// Enters an evaluation that does not answer what the path asks at its point.
    pub(crate) fn useless(&mut self, entry: SpeculativeEntry) {
        self.n_early += 1;
        self.trace.push_speculative(entry);
    }

    /// Drops what the trace need not keep; `all`: down to the limit, else now and then.
    pub(crate) fn trim(&mut self, all: bool) {
        if let Some(limit) = self.trace_limit
            && (all || self.trace.longest() >= limit.saturating_mul(2).max(limit.saturating_add(64)))
        {
            self.trace.keep_last(limit);
        }
    }

    /// Reasons of the failures, most frequent first.
    pub(crate) fn failures(&self) -> Vec<(String, usize)> {
        let mut list = self.failures.clone();
        list.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        if self.other_failures > 0 {
            list.push(("other reasons".to_owned(), self.other_failures));
        }
        list
    }

    /// Everything that was seen by a run without a result.
    pub(crate) fn nothing_found(&self) -> Box<NothingFound> {
        Box::new(NothingFound {
            n_evaluations: self.n_evaluations,
            failures: self.failures(),
            x: self.first_failure.clone(),
            trace: self.trace.clone(),
        })
    }

    /// True if its parts fit together: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.trace.is_sound(n)
            && self.best.is_sound(n)
            && self.n_reached <= self.n_early
            && self.n_guessed < 1 << 60
    }
}
