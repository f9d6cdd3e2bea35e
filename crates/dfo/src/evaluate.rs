//! The only gateway to the objective: what is known already, exact budgets, execution, entry into the ledger.

use crate::cache::Cache;
use crate::executor::{Executor, Halt, Outside, execute};
use crate::ledger::{Ledger, Source};
use crate::method::Batch;
use crate::objective::{Ends, Outcome};
use crate::termination::{Limits, Termination};
use serde::{Deserialize, Serialize};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Batches in a row without anything new after which a run ends.
const STALE_BATCHES: usize = 200;

/// An evaluation made before a run was resumed, of a batch that had not been completed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Replay {
    pub(crate) id: u64,
    pub(crate) outcome: Outcome,
    pub(crate) seconds: f64,
}

/// Sorts a batch into what must be evaluated and what is known, and puts the answers together again.
#[derive(Debug)]
pub(crate) struct Desk {
    pub(crate) ledger: Ledger,
    pub(crate) cache: Cache,
    pub(crate) replay: Vec<Replay>,
    pub(crate) stale: usize,
    /// What must be evaluated.
    pub(crate) work: Batch,
    sources: Vec<Source>,
    outcomes: Vec<Outcome>,
    seconds: Vec<f64>,
    truncated: bool,
}

impl Desk {
    pub(crate) fn new(ledger: Ledger, cache: Cache) -> Self {
        Self {
            ledger,
            cache,
            replay: Vec::new(),
            stale: 0,
            work: Batch::new(),
            sources: Vec::new(),
            outcomes: Vec::new(),
            seconds: Vec::new(),
            truncated: false,
        }
    }

    /// Takes a batch in. What the budget leaves of it and is not known stands in `work` then.
    pub(crate) fn open(&mut self, batch: &Batch, limits: &Limits) {
        let spent = self.ledger.n_evaluations;
        let mut left = limits.max_evaluations.map_or(usize::MAX, |m| m.saturating_sub(spent));
        self.work.start(batch.n(), batch.index(), 0);
        self.sources.clear();
        self.outcomes.clear();
        self.outcomes.resize(batch.len(), Outcome::Skipped);
        self.seconds.clear();
        self.seconds.resize(batch.len(), 0.0);
        self.truncated = false;
        for k in 0..batch.len() {
            let (x, cutoff) = (batch.point(k), batch.cutoff(k));
            let source = if let Some(known) = self.cache.get(x, cutoff) {
                self.outcomes[k].clone_from(known);
                Source::Cached
            } else if let Some(twin) = self.twin(batch, k) {
                Source::Copy(twin)
            } else if left == 0 {
                self.truncated = true;
                Source::Forbidden
            } else if let Some(replay) = self.replay.iter().find(|r| r.id == batch.id(k)) {
                left -= 1;
                self.outcomes[k].clone_from(&replay.outcome);
                self.seconds[k] = replay.seconds;
                Source::Replayed
            } else {
                left -= 1;
                self.work.push_with_id(x, cutoff, batch.id(k));
                Source::Run
            };
            self.sources.push(source);
        }
    }

    /// An earlier place of the batch whose outcome answers for place `k` too.
    fn twin(&self, batch: &Batch, k: usize) -> Option<usize> {
        if self.cache.is_off() {
            return None;
        }
        let same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        (0..k).find(|&j| {
            matches!(self.sources[j], Source::Run | Source::Replayed)
                && batch.cutoff(j) >= batch.cutoff(k)
                && same(batch.point(j), batch.point(k))
        })
    }

    /// What of this batch is known for good, should the run end here.
    pub(crate) fn known(&self, batch: &Batch, outcomes: &[Outcome], seconds: &[f64]) -> Vec<Replay> {
        let mut known = Vec::new();
        let mut at = 0;
        for (k, source) in self.sources.iter().enumerate() {
            let (outcome, seconds) = match source {
                Source::Run => {
                    at += 1;
                    (&outcomes[at - 1], seconds[at - 1])
                }
                Source::Replayed => (&self.outcomes[k], self.seconds[k]),
                Source::Cached | Source::Copy(_) | Source::Forbidden => continue,
            };
            if outcome.is_known() {
                known.push(Replay { id: batch.id(k), outcome: outcome.clone(), seconds });
            }
        }
        known
    }

    /// Takes the outcomes of `work`, in order, and enters everything into the ledger.
    pub(crate) fn close(&mut self, batch: &Batch, outcomes: &[Outcome], seconds: &[f64]) {
        let mut at = 0;
        for k in 0..batch.len() {
            match self.sources[k] {
                Source::Run => {
                    self.outcomes[k].clone_from(&outcomes[at]);
                    self.seconds[k] = seconds[at];
                    at += 1;
                }
                Source::Copy(twin) => self.outcomes[k] = self.outcomes[twin].clone(),
                Source::Replayed | Source::Cached | Source::Forbidden => {}
            }
            if matches!(self.sources[k], Source::Run | Source::Replayed) {
                self.cache.insert(batch.point(k), &self.outcomes[k]);
            }
        }
        self.replay.clear();
        let new =
            self.sources.iter().any(|s| matches!(s, Source::Run | Source::Replayed | Source::Forbidden));
        self.stale = if new { 0 } else { self.stale + 1 };
        self.ledger.record(batch, &self.outcomes, &self.seconds, &self.sources);
    }

    /// Outcomes of the last batch; what was not evaluated is [`Outcome::Skipped`].
    pub(crate) fn outcomes(&self) -> &[Outcome] {
        &self.outcomes
    }

    pub(crate) fn is_truncated(&self) -> bool {
        self.truncated
    }

    pub(crate) fn is_stale(&self) -> bool {
        self.stale >= STALE_BATCHES
    }

    pub(crate) fn target_reached(&self, limits: &Limits) -> bool {
        matches!((limits.target, &self.ledger.best), (Some(target), Some((_, best))) if *best <= target)
    }
}

pub(crate) struct Gateway<'a> {
    executor: Executor<'a>,
    outside: Outside<'a>,
    limits: Limits,
    start: Instant,
    /// Seconds of the run before it was resumed.
    before: f64,
    outcomes: Vec<Outcome>,
    seconds: Vec<f64>,
    pub(crate) desk: Desk,
}

impl<'a> Gateway<'a> {
    pub(crate) fn new(
        executor: Executor<'a>,
        desk: Desk,
        limits: Limits,
        before: f64,
        cancel: &'a AtomicBool,
        poll: Option<&'a mut dyn FnMut() -> bool>,
    ) -> Self {
        let start = Instant::now();
        let left = limits
            .max_time
            .map(|t| t.saturating_sub(Duration::try_from_secs_f64(before).unwrap_or(Duration::MAX)));
        let deadline = left.and_then(|t| start.checked_add(t));
        Self {
            executor,
            outside: Outside { ends: Ends::new(cancel, deadline), poll, last_poll: None },
            limits,
            start,
            before,
            outcomes: Vec::new(),
            seconds: Vec::new(),
            desk,
        }
    }

    pub(crate) fn elapsed(&self) -> f64 {
        self.before + self.start.elapsed().as_secs_f64()
    }

    /// The limit that forbids to start another evaluation, if one does.
    pub(crate) fn exhausted(&self) -> Option<Termination> {
        if !self.desk.replay.is_empty() {
            // Evaluations are at hand that were paid for already.
            return None;
        }
        if self.limits.max_evaluations.is_some_and(|m| self.desk.ledger.n_evaluations >= m) {
            return Some(Termination::MaxEvaluations);
        }
        self.outside.ends.is_late().then_some(Termination::MaxTime)
    }

    /// Evaluates what the budget allows of a batch, in request order. Returns why the run must end, if it must;
    /// then the batch may be incomplete. Nothing is entered into the ledger before [`close`](Self::close).
    pub(crate) fn evaluate(&mut self, batch: &Batch) -> Option<Termination> {
        self.desk.open(batch, &self.limits);
        let work = &self.desk.work;
        self.outcomes.clear();
        self.outcomes.resize(work.len(), Outcome::Skipped);
        self.seconds.clear();
        self.seconds.resize(work.len(), 0.0);
        let (outcomes, seconds) = (&mut self.outcomes, &mut self.seconds);
        let halt = if work.is_empty() {
            self.outside.check()
        } else {
            execute(&mut self.executor, work, work.len(), &mut self.outside, outcomes, seconds)
        };
        self.verdict(halt)
    }

    fn verdict(&self, halt: Option<Halt>) -> Option<Termination> {
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
        if self.outcomes.iter().any(|o| !o.is_known()) {
            // An evaluation gave up although nothing above noticed: the deadline passed inside of it, or the
            // objective was told to stop by somebody else.
            let is_late = self.outside.ends.is_late();
            return Some(if is_late { Termination::MaxTime } else { Termination::Interrupted });
        }
        self.desk.is_truncated().then_some(Termination::MaxEvaluations)
    }

    /// What of the batch just evaluated is known for good.
    pub(crate) fn known(&self, batch: &Batch) -> Vec<Replay> {
        self.desk.known(batch, &self.outcomes, &self.seconds)
    }

    /// Enters the batch just evaluated into the ledger.
    pub(crate) fn close(&mut self, batch: &Batch) {
        self.desk.close(batch, &self.outcomes, &self.seconds);
    }
}
