//! The only gateway to the objective: counting, exact budgets, failures, the best point so far, the trace.

use crate::error::NothingFound;
use crate::executor::{Executor, Halt, Outside, execute};
use crate::method::Batch;
use crate::objective::{Failure, Outcome};
use crate::termination::{Limits, Termination};
use crate::trace::{Record, Trace};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Reasons counted one by one; what comes beyond is counted together.
const MAX_REASONS: usize = 50;

pub(crate) struct Gateway<'a> {
    executor: Executor<'a>,
    outside: Outside<'a>,
    limits: Limits,
    start: Instant,
    outcomes: Vec<Outcome>,
    seconds: Vec<f64>,
    /// For each point of the batch, where its record stands in the trace.
    positions: Vec<Option<usize>>,
    pub(crate) trace: Trace,
    pub(crate) best: Option<(Vec<f64>, f64)>,
    pub(crate) n_evaluations: usize,
    pub(crate) n_failed: usize,
    pub(crate) n_used: usize,
    pub(crate) n_batches: usize,
    failures: Vec<(String, usize)>,
    other_failures: usize,
    first_failure: Option<usize>,
}

impl<'a> Gateway<'a> {
    pub(crate) fn new(
        executor: Executor<'a>,
        n: usize,
        limits: Limits,
        cancel: &'a AtomicBool,
        poll: Option<&'a mut dyn FnMut() -> bool>,
    ) -> Self {
        let start = Instant::now();
        let deadline = limits.max_time.and_then(|t| start.checked_add(t));
        Self {
            executor,
            outside: Outside { cancel, deadline, poll, last_poll: None, raised: false },
            limits,
            start,
            outcomes: Vec::new(),
            seconds: Vec::new(),
            positions: Vec::new(),
            trace: Trace::new(n),
            best: None,
            n_evaluations: 0,
            n_failed: 0,
            n_used: 0,
            n_batches: 0,
            failures: Vec::new(),
            other_failures: 0,
            first_failure: None,
        }
    }

    pub(crate) fn elapsed(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// Outcomes of the last batch; what was not evaluated is [`Outcome::Skipped`].
    pub(crate) fn outcomes(&self) -> &[Outcome] {
        &self.outcomes
    }

    /// The limit that forbids to start another evaluation, if one does.
    pub(crate) fn exhausted(&self) -> Option<Termination> {
        if self.limits.max_evaluations.is_some_and(|m| self.n_evaluations >= m) {
            return Some(Termination::MaxEvaluations);
        }
        self.outside.deadline.filter(|d| Instant::now() >= *d).map(|_| Termination::MaxTime)
    }

    pub(crate) fn target_reached(&self) -> bool {
        matches!((self.limits.target, &self.best), (Some(target), Some((_, best))) if *best <= target)
    }

    /// Evaluates what the budget allows of a batch, in request order. Returns why the run must end, if it must.
    pub(crate) fn evaluate(&mut self, batch: &Batch) -> Option<Termination> {
        let left = self.limits.max_evaluations.map_or(usize::MAX, |m| m.saturating_sub(self.n_evaluations));
        let len = batch.len().min(left);
        self.outcomes.clear();
        self.outcomes.resize(batch.len(), Outcome::Skipped);
        self.seconds.clear();
        self.seconds.resize(batch.len(), 0.0);
        let halt =
            execute(&mut self.executor, batch, len, &mut self.outside, &mut self.outcomes, &mut self.seconds);
        self.record(batch);
        self.verdict(halt, len < batch.len(), len)
    }

    fn verdict(&self, halt: Option<Halt>, truncated: bool, len: usize) -> Option<Termination> {
        if let Some(message) = self.outcomes.iter().find_map(|o| match o {
            Outcome::Abort(message) => Some(message),
            _ => None,
        }) {
            return Some(Termination::Aborted(message.clone()));
        }
        match halt {
            Some(Halt::Interrupted) => return Some(Termination::Interrupted),
            Some(Halt::OutOfTime) => return Some(Termination::MaxTime),
            None => {}
        }
        if self.outcomes[..len].iter().any(|o| !o.is_known()) {
            // An evaluation gave up although nothing above noticed: the deadline passed inside of it, or the
            // objective was told to stop by somebody else.
            let late = self.outside.deadline.is_some_and(|d| Instant::now() >= d);
            return Some(if late { Termination::MaxTime } else { Termination::Interrupted });
        }
        truncated.then_some(Termination::MaxEvaluations)
    }

    fn record(&mut self, batch: &Batch) {
        self.n_batches += 1;
        self.positions.clear();
        for (k, outcome) in self.outcomes.iter().enumerate() {
            if matches!(outcome, Outcome::Skipped) {
                self.positions.push(None);
                continue;
            }
            let position = self.trace.len();
            self.positions.push(Some(position));
            self.n_evaluations += 1;
            if let Outcome::Failed(Failure { message, .. }) = outcome {
                self.n_failed += 1;
                self.first_failure.get_or_insert(position);
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
                seconds: self.seconds[k],
            };
            self.trace.push(batch.point(k), record);
        }
    }

    /// Marks which points of the last batch the method used. Only those can be best. May be called again when more of
    /// them turn out to be used.
    pub(crate) fn settle(&mut self, used: &[bool]) {
        for (k, position) in self.positions.iter().enumerate() {
            let (Some(position), Some(true)) = (*position, used.get(k)) else { continue };
            if !self.trace.set_used(position) {
                continue;
            }
            self.n_used += 1;
            let Some(entry) = self.trace.get(position) else { continue };
            // What lies above its cutoff might as well have been given up, and must not make a difference.
            let Some(value) = entry.outcome.value().filter(|v| *v <= entry.cutoff) else { continue };
            match &mut self.best {
                Some((x, best)) if value < *best => {
                    x.copy_from_slice(entry.x);
                    *best = value;
                }
                Some(_) => {}
                None => self.best = Some((entry.x.to_vec(), value)),
            }
        }
    }

    /// Evaluations that were neither used nor cut short by the end of the run.
    pub(crate) fn n_speculative(&self) -> usize {
        let unknown = self.trace.iter().filter(|e| !e.used && !e.outcome.is_known()).count();
        self.n_evaluations - self.n_used - unknown
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

    /// Takes everything that was seen by a run without a result.
    pub(crate) fn nothing_found(&mut self) -> Box<NothingFound> {
        let x = self.first_failure.and_then(|k| self.trace.get(k)).map(|e| e.x.to_vec());
        Box::new(NothingFound {
            n_evaluations: self.n_evaluations,
            failures: self.failures(),
            x,
            trace: std::mem::take(&mut self.trace),
        })
    }
}

impl Drop for Gateway<'_> {
    fn drop(&mut self) {
        if self.outside.raised {
            self.outside.cancel.store(false, Ordering::Relaxed);
        }
    }
}
