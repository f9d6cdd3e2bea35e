//! The only gateway to the objective: what is known already, exact budgets, execution, entry into the ledger.

use crate::ahead::{Early, GivesUp};
use crate::cache::Cache;
use crate::executor::{Executor, Halt, Order, Outside, execute};
use crate::ledger::{Ledger, Source};
use crate::method::{Batch, Method};
use crate::objective::{Ends, Outcome};
use crate::pace::Pace;
use crate::termination::{Limits, Termination};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::collections::hash_map::{DefaultHasher, Entry};
use std::hash::Hasher;
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
    /// What is to be evaluated: first what the path needs, then what it may need next.
    pub(crate) work: Batch,
    n_needed: usize,
    gives_up: GivesUp,
    guesses: Batch,
    sources: Vec<Source>,
    outcomes: Vec<Outcome>,
    seconds: Vec<f64>,
    /// Places of the points of a batch, by their hash.
    places: HashMap<u64, usize>,
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
            n_needed: 0,
            gives_up: GivesUp::Unknown,
            guesses: Batch::new(),
            sources: Vec::new(),
            outcomes: Vec::new(),
            seconds: Vec::new(),
            places: HashMap::new(),
            truncated: false,
        }
    }

    /// Takes a batch in. What the budget leaves of it and is not known stands in `work` then.
    pub(crate) fn open(&mut self, batch: &Batch, limits: &Limits) {
        let mut left = self.left(limits);
        self.work.start(batch.n(), batch.index(), 0);
        self.sources.clear();
        self.outcomes.clear();
        self.outcomes.resize(batch.len(), Outcome::Skipped);
        self.seconds.clear();
        self.seconds.resize(batch.len(), 0.0);
        self.places.clear();
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
            } else {
                left -= 1;
                match self.evaluated_before(batch, k) {
                    Some((outcome, seconds)) => {
                        (self.outcomes[k], self.seconds[k]) = (outcome, seconds);
                        Source::Replayed
                    }
                    None => {
                        self.work.push_with_id(x, cutoff, batch.id(k));
                        Source::Run
                    }
                }
            };
            self.sources.push(source);
        }
        self.n_needed = self.work.len();
    }

    /// Evaluations that the budget leaves.
    fn left(&self, limits: &Limits) -> usize {
        let spent = self.ledger.n_evaluations;
        limits.max_evaluations.map_or(usize::MAX, |m| m.saturating_sub(spent))
    }

    /// The outcome of a point that was evaluated before the run was resumed, or ahead of need.
    fn evaluated_before(&mut self, batch: &Batch, k: usize) -> Option<(Outcome, f64)> {
        let id = batch.id(k);
        if let Ok(place) = self.replay.binary_search_by_key(&id, |replay| replay.id) {
            let Replay { outcome, seconds, .. } = &self.replay[place];
            return Some((outcome.clone(), *seconds));
        }
        match self.ledger.ahead.take(batch.point(k), batch.cutoff(k), self.gives_up)? {
            Ok(known) => Some(known),
            Err(useless) => {
                self.ledger.trace.push_speculative(useless);
                None
            }
        }
    }

    /// An earlier place of the batch whose outcome answers for place `k` too.
    fn twin(&mut self, batch: &Batch, k: usize) -> Option<usize> {
        if self.cache.is_off() {
            return None;
        }
        let mut hasher = DefaultHasher::new();
        batch.point(k).iter().for_each(|v| hasher.write_u64(v.to_bits()));
        let place = match self.places.entry(hasher.finish()) {
            Entry::Occupied(place) => place,
            Entry::Vacant(free) => {
                free.insert(k);
                return None;
            }
        };
        let j = *place.get();
        let same = batch.point(j).iter().zip(batch.point(k)).all(|(a, b)| a.to_bits() == b.to_bits());
        let answers = matches!(self.sources[j], Source::Run | Source::Replayed);
        if same && answers && batch.cutoff(j) >= batch.cutoff(k) {
            return Some(j);
        }
        // This one answers for more.
        *place.into_mut() = k;
        None
    }

    /// Adds up to `wanted` points to `work` that the path may need next. No more than the budget lets it come to.
    pub(crate) fn look_ahead<M: Method + ?Sized>(&mut self, method: &mut M, wanted: usize, limits: &Limits) {
        let wanted = wanted.min(self.left(limits).saturating_sub(self.n_needed));
        if wanted == 0 || self.n_needed == 0 {
            return;
        }
        let Self { ledger, cache, guesses, work, .. } = self;
        guesses.start(work.n(), work.index(), ledger.ahead.next_id());
        let known = |x: &[f64]| ledger.ahead.contains(x) || cache.contains(x);
        method.speculate(wanted, &known, guesses);
        work.append(guesses);
    }

    /// How many points of `work` the path needs.
    pub(crate) fn n_needed(&self) -> usize {
        self.n_needed
    }

    /// The first place of the batch at which the objective asked to end the run, and its message. `outcomes`: of `work`.
    pub(crate) fn abort<'a>(&'a self, outcomes: &'a [Outcome]) -> Option<(usize, &'a str)> {
        let mut new = outcomes.iter();
        self.sources.iter().enumerate().find_map(|(k, source)| {
            let outcome = if *source == Source::Run { new.next() } else { self.outcomes.get(k) };
            match outcome {
                Some(Outcome::Abort(message)) => Some((k, message.as_str())),
                _ => None,
            }
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
        // One point at a time nothing would have been evaluated after it.
        let last = self.abort(&outcomes[..self.n_needed]).map_or(usize::MAX, |(k, _)| k);
        for k in 0..batch.len() {
            match self.sources[k] {
                Source::Run => {
                    if k <= last {
                        self.outcomes[k].clone_from(&outcomes[at]);
                        self.seconds[k] = seconds[at];
                    } else {
                        self.keep_ahead(at, &outcomes[at], seconds[at]);
                    }
                    at += 1;
                }
                _ if k > last => self.outcomes[k] = Outcome::Skipped,
                Source::Copy(twin) => self.outcomes[k] = self.outcomes[twin].clone(),
                Source::Replayed | Source::Cached | Source::Forbidden => {}
            }
            if matches!(self.sources[k], Source::Run | Source::Replayed) {
                self.cache.insert(batch.point(k), &self.outcomes[k]);
            }
        }
        for k in self.n_needed..self.work.len() {
            self.keep_ahead(k, &outcomes[k], seconds[k]);
        }
        self.replay.clear();
        let new =
            self.sources.iter().any(|s| matches!(s, Source::Run | Source::Replayed | Source::Forbidden));
        self.stale = if new { 0 } else { self.stale + 1 };
        self.ledger.record(batch, &self.outcomes, &self.seconds, &self.sources);
    }

    /// Keeps the outcome of point `k` of `work` for a path that may come to it.
    fn keep_ahead(&mut self, k: usize, outcome: &Outcome, seconds: f64) {
        if matches!(outcome, Outcome::Skipped) {
            return;
        }
        self.ledger.keep_ahead(Early {
            id: self.work.id(k),
            batch: self.work.index(),
            x: self.work.point(k).to_vec(),
            cutoff: self.work.cutoff(k),
            outcome: outcome.clone(),
            seconds,
        });
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
    pace: Pace,
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
        mut desk: Desk,
        limits: Limits,
        before: f64,
        outside: (&'a AtomicBool, Option<&'a mut dyn FnMut() -> bool>),
        workers: usize,
    ) -> Self {
        let start = Instant::now();
        let left = limits
            .max_time
            .map(|t| t.saturating_sub(Duration::try_from_secs_f64(before).unwrap_or(Duration::MAX)));
        let deadline = left.and_then(|t| start.checked_add(t));
        desk.gives_up = executor.gives_up();
        let (cancel, poll) = outside;
        Self {
            pace: Pace::new(workers, executor.handing_over()),
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

    /// Evaluates what the budget allows of a batch that `method` asked for, in request order, and what it may need next
    /// where that is faster. Returns why the run must end, if it must; then the batch may be incomplete. Nothing is
    /// entered into the ledger before [`close`](Self::close).
    pub(crate) fn evaluate<M: Method + ?Sized>(
        &mut self,
        batch: &Batch,
        method: &mut M,
    ) -> Option<Termination> {
        self.desk.open(batch, &self.limits);
        let begun = Instant::now();
        let needed = self.desk.n_needed();
        let width = self.pace.width(method.lookahead(), self.desk.ledger.n_evaluations);
        if needed > 0 && width > needed {
            self.desk.look_ahead(method, width - needed, &self.limits);
        }
        let work = &self.desk.work;
        self.outcomes.clear();
        self.outcomes.resize(work.len(), Outcome::Skipped);
        self.seconds.clear();
        self.seconds.resize(work.len(), 0.0);
        let (outcomes, seconds) = (&mut self.outcomes, &mut self.seconds);
        let halt = if work.is_empty() {
            self.outside.check()
        } else {
            let order = Order { work, needed, pace: &self.pace };
            execute(&mut self.executor, &order, &mut self.outside, outcomes, seconds)
        };
        if needed > 0 {
            self.pace.measured(needed, begun.elapsed().as_secs_f64(), &self.seconds);
        }
        self.verdict(halt)
    }

    /// Why the run must end after what the path needs was evaluated.
    fn verdict(&self, halt: Option<Halt>) -> Option<Termination> {
        let needed = &self.outcomes[..self.desk.n_needed()];
        if let Some((_, message)) = self.desk.abort(needed) {
            return Some(Termination::Aborted(message.to_owned()));
        }
        match halt {
            Some(Halt::Interrupted) => return Some(Termination::Interrupted),
            Some(Halt::OutOfTime) => return Some(Termination::MaxTime),
            None => {}
        }
        if needed.iter().any(|o| !o.is_known()) {
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
