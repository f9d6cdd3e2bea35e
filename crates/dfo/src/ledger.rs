//! What a run has seen: every count, the failures, the best point so far, the trace.

use crate::error::NothingFound;
use crate::method::Batch;
use crate::objective::{Failure, Outcome};
use crate::trace::{Record, Trace};
use serde::{Deserialize, Serialize};

/// Reasons counted one by one; what comes beyond is counted together.
const MAX_REASONS: usize = 50;

/// Where the outcome of a point comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Source {
    /// The objective is called for it.
    Run,
    /// The objective was called for it before the run was resumed.
    Replayed,
    /// It is known from another point of this run or an earlier one.
    Cached,
    /// The same point stands at this place of the batch.
    Copy(usize),
    /// The budget forbids it.
    Forbidden,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Ledger {
    /// The last batch, with its outcomes; `None` in `positions` where nothing stands in the trace.
    points: Vec<f64>,
    cutoffs: Vec<f64>,
    outcomes: Vec<Outcome>,
    positions: Vec<Option<usize>>,
    settled: Vec<bool>,
    pub(crate) trace: Trace,
    trace_limit: Option<usize>,
    pub(crate) best: Option<(Vec<f64>, f64)>,
    pub(crate) n_evaluations: usize,
    pub(crate) n_failed: usize,
    pub(crate) n_cached: usize,
    pub(crate) n_batches: usize,
    n_used: usize,
    /// Evaluations that said nothing: cut short by the end of the run.
    n_unknown: usize,
    failures: Vec<(String, usize)>,
    other_failures: usize,
    first_failure: Option<Vec<f64>>,
}

impl Ledger {
    pub(crate) fn new(n: usize, trace_limit: Option<usize>) -> Self {
        Self {
            points: Vec::new(),
            cutoffs: Vec::new(),
            outcomes: Vec::new(),
            positions: Vec::new(),
            settled: Vec::new(),
            trace: Trace::new(n),
            trace_limit,
            best: None,
            n_evaluations: 0,
            n_failed: 0,
            n_cached: 0,
            n_batches: 0,
            n_used: 0,
            n_unknown: 0,
            failures: Vec::new(),
            other_failures: 0,
            first_failure: None,
        }
    }

    /// Enters a batch: its outcomes, seconds and sources, in request order.
    pub(crate) fn record(
        &mut self,
        batch: &Batch,
        outcomes: &[Outcome],
        seconds: &[f64],
        sources: &[Source],
    ) {
        self.n_batches += 1;
        self.points.clear();
        self.points.extend_from_slice(batch.as_flat());
        self.cutoffs.clear();
        self.cutoffs.extend((0..batch.len()).map(|k| batch.cutoff(k)));
        self.outcomes.clear();
        self.outcomes.extend_from_slice(outcomes);
        self.settled.clear();
        self.settled.resize(batch.len(), false);
        self.positions.clear();
        for (k, outcome) in outcomes.iter().enumerate() {
            let evaluated = matches!(sources[k], Source::Run | Source::Replayed);
            if !evaluated || matches!(outcome, Outcome::Skipped) {
                self.positions.push(None);
                let known = !matches!(outcome, Outcome::Skipped);
                self.n_cached += usize::from(known && !evaluated);
                continue;
            }
            self.positions.push(Some(self.trace.end()));
            self.n_evaluations += 1;
            self.n_unknown += usize::from(!outcome.is_known());
            if let Outcome::Failed(Failure { message, .. }) = outcome {
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
                used: false,
                seconds: seconds[k],
            };
            self.trace.push(batch.point(k), record);
        }
    }

    /// Marks which points of the last batch the method used. Only those can be best. May be called again when more of
    /// them turn out to be used.
    pub(crate) fn settle(&mut self, used: &[bool]) {
        let n = self.trace.n();
        for (k, outcome) in self.outcomes.iter().enumerate() {
            if used.get(k) != Some(&true) || std::mem::replace(&mut self.settled[k], true) {
                continue;
            }
            if let Some(position) = self.positions[k] {
                self.trace.set_used(position);
                self.n_used += usize::from(outcome.is_known());
            }
            // What lies above its cutoff might as well have been given up, and must not make a difference.
            let Some(value) = outcome.value().filter(|v| *v <= self.cutoffs[k]) else { continue };
            let point = &self.points[k * n..(k + 1) * n];
            match &mut self.best {
                Some((x, best)) if value < *best => {
                    x.copy_from_slice(point);
                    *best = value;
                }
                Some(_) => {}
                None => self.best = Some((point.to_vec(), value)),
            }
        }
    }

    /// Drops what the trace need not keep; `all`: down to the limit, else now and then.
    pub(crate) fn trim(&mut self, all: bool) {
        if let Some(limit) = self.trace_limit
            && (all || self.trace.len() >= limit.saturating_mul(2).max(limit + 64))
        {
            self.trace.keep_last(limit);
        }
    }

    /// Evaluations that were neither used nor cut short by the end of the run.
    pub(crate) fn n_speculative(&self) -> usize {
        self.n_evaluations - self.n_used - self.n_unknown
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

    /// Whether its parts fit together: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        let len = self.outcomes.len();
        self.trace.is_sound(n)
            && self.points.len() == len * n
            && (self.cutoffs.len(), self.positions.len(), self.settled.len()) == (len, len, len)
            && self.positions.iter().flatten().all(|p| *p < self.trace.end())
            && self.best.as_ref().is_none_or(|(x, _)| x.len() == n)
            && self.n_used + self.n_unknown <= self.n_evaluations
    }
}
