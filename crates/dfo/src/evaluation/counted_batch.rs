//! Splits a batch into points to evaluate and known points, and merges the answers.

use super::evaluator::CutoffUse;
use super::ledger::{Ledger, Source};
use super::store::{EarlyOutcome, Store};
use crate::error::Error;
use crate::method_interface::interface::{AnswersSoFar, Batch};
use crate::method_interface::tolerances::Limits;
use crate::outcome::answer::{Answer, Answers, EvaluationKind, Outcome};
use crate::outcome::termination::Termination;
use crate::outcome::trace::SpeculativeEntry;
use crate::problem::objective::Query;
use std::collections::HashMap;
use std::collections::hash_map::{DefaultHasher, Entry};
use std::hash::Hasher;

/// Number of successive batches without a new point after which a run ends.
const STALE_BATCHES: usize = 200;

/// State of a batch that is split into points to evaluate and known points.
#[derive(Debug, Clone)]
pub(crate) struct CountedBatch {
    pub(crate) ledger: Ledger,
    pub(crate) store: Store,
    pub(crate) stale: usize,
    /// Points of the batch to evaluate.
    pub(crate) work: Batch,
    pub(crate) cutoff_use: CutoffUse,
    /// Index in the batch of each point of `work`.
    work_places: Vec<usize>,
    sources: Vec<Source>,
    /// Answers to the points of a batch, and the part of them that is passed to the method.
    answers: Vec<Answer>,
    reported: Answers,
    /// Indices of the points of a batch, by hash.
    places: HashMap<u64, usize>,
    truncated: bool,
    /// Cost at which the run ends, and the index of a known answer in the batch that ends it.
    target: Option<f64>,
    reached: Option<usize>,
}

/// Reason why no later point belongs to the path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Last<'a> {
    /// The objective requested to end the run, with this message.
    Abort(&'a str),
    /// The cost reaches the target.
    Target,
}

impl CountedBatch {
    pub(crate) fn new(ledger: Ledger, store: Store) -> Self {
        Self {
            ledger,
            store,
            stale: 0,
            work: Batch::new(),
            cutoff_use: CutoffUse::Unknown,
            work_places: Vec::new(),
            sources: Vec::new(),
            answers: Vec::new(),
            reported: Answers::default(),
            places: HashMap::new(),
            truncated: false,
            target: None,
            reached: None,
        }
    }

    /// Starts a batch. Afterwards, `work` contains the unknown points that the budget allows.
    pub(crate) fn open(&mut self, batch: &Batch, limits: &Limits) {
        let mut left = self.left(limits);
        self.work.start(batch.n(), batch.index(), 0);
        self.work.set_kind(batch.kind());
        self.work_places.clear();
        self.sources.clear();
        reset(&mut self.answers, batch.len());
        self.places.clear();
        self.truncated = false;
        (self.target, self.reached) = (limits.target, None);
        for k in 0..batch.len() {
            let (x, cutoff) = (batch.point(k), batch.cutoff(k));
            let source = if self.reached.is_some() {
                Source::Forbidden
            } else if let Some(cached) = self.store.get(x, batch.query(k)) {
                self.answers[k].clone_from(cached);
                Source::Cached
            } else if self.store.is_above(x) {
                self.again(batch, k)
            } else if let Some(twin) = self.twin(batch, k) {
                Source::Copy(twin)
            } else if left == 0 {
                self.truncated = true;
                Source::Forbidden
            } else {
                left -= 1;
                match self.evaluated_before(batch, k) {
                    Some(answer) => {
                        self.answers[k] = answer;
                        Source::Replayed
                    }
                    None => {
                        self.work.push_with_id(x, cutoff, batch.id(k));
                        self.work_places.push(k);
                        Source::Run
                    }
                }
            };
            self.sources.push(source);
            let cached = matches!(source, Source::Cached | Source::Replayed);
            let ends = |answer: &Answer| {
                matches!(answer.outcome, Outcome::Abort(_)) || self.is_target(answer, cutoff)
            };
            if cached && self.reached.is_none() && ends(&self.answers[k]) {
                self.reached = Some(k);
            }
        }
    }

    /// Returns the source of a point that is only known to be above a lower cutoff. Adds the point to the
    /// work if there is no other source. It must not count, because without cutoffs the point would be
    /// completely known.
    fn again(&mut self, batch: &Batch, k: usize) -> Source {
        if let Some(twin) = self.twin(batch, k) {
            return Source::Copy(twin);
        }
        if let Some(answer) = self.evaluated_before(batch, k) {
            self.store.insert(batch.point(k), &answer, batch.kind());
            self.answers[k] = answer;
            return Source::Cached;
        }
        self.work.push_with_id(batch.point(k), batch.cutoff(k), batch.id(k));
        self.work_places.push(k);
        Source::Again
    }

    /// Returns the number of evaluations left in the budget.
    fn left(&self, limits: &Limits) -> usize {
        let spent = self.ledger.n_evaluations;
        limits.max_evaluations.map_or(usize::MAX, |m| m.saturating_sub(spent))
    }

    /// Returns the answer for a point evaluated before the run was resumed, or speculatively.
    fn evaluated_before(&mut self, batch: &Batch, k: usize) -> Option<Answer> {
        match self.store.take(batch.point(k), &batch.query(k), self.cutoff_use)? {
            Ok((stored, is_of_path)) => {
                self.ledger.n_reached += usize::from(!is_of_path);
                Some(stored)
            }
            Err(useless) => {
                self.ledger.trace.push_speculative(useless.entry);
                None
            }
        }
    }

    /// Returns the index of an earlier point of the batch whose outcome also answers point `k`.
    fn twin(&mut self, batch: &Batch, k: usize) -> Option<usize> {
        if self.store.is_off() {
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
        let answers = self.sources[j].is_work() || self.sources[j] == Source::Replayed;
        if same && answers && batch.cutoff(j) >= batch.cutoff(k) {
            return Some(j);
        }
        // Point `k` has the higher cutoff, so its answer is valid for more queries.
        *place.into_mut() = k;
        None
    }

    /// Marks point `k` of `work` as already being evaluated.
    pub(crate) fn begun(&mut self, k: usize) {
        let source = &mut self.sources[self.work_places[k]];
        if *source == Source::Run {
            *source = Source::Begun;
        }
    }

    /// Returns the number of evaluations left in the budget after this batch.
    pub(crate) fn left_after(&self, limits: &Limits) -> usize {
        let counts = |source: &&Source| matches!(source, Source::Run | Source::Begun);
        self.left(limits).saturating_sub(self.sources.iter().filter(counts).count())
    }

    /// True if an answer reaches the target. Costs above the cutoff do not count, because the evaluation
    /// might have been abandoned.
    fn is_target(&self, answer: &Answer, cutoff: f64) -> bool {
        let value = answer.outcome.value().filter(|value| *value <= cutoff);
        matches!((value, self.target), (Some(value), Some(target)) if value <= target)
            && self.ledger.constraints.rank(&answer.constraints) == 0.0
            && !(self.work.kind() == EvaluationKind::Residuals && answer.residuals_failure().is_some())
    }

    /// True if no point after point `k` of `work` belongs to the path.
    pub(crate) fn is_last(&self, k: usize, answer: &Answer) -> bool {
        matches!(answer.outcome, Outcome::Abort(_)) || self.is_target(answer, self.work.cutoff(k))
    }

    /// Returns where and why the path ends within the batch: the index of its last point, and the reason.
    /// `None` if the path does not end in the batch. `answers` are the answers to `work`.
    pub(crate) fn last<'a>(&'a self, answers: &'a [Answer]) -> Option<(usize, Last<'a>)> {
        let mut new = answers.iter().enumerate();
        self.sources.iter().enumerate().find_map(|(k, source)| {
            let (answer, is_last) = if source.is_work() {
                let (place, answer) = new.next()?;
                (answer, self.is_last(place, answer))
            } else {
                (&self.answers[k], self.reached == Some(k))
            };
            let why = match &answer.outcome {
                Outcome::Abort(message) => Last::Abort(message),
                _ => Last::Target,
            };
            is_last.then_some((k, why))
        })
    }

    /// Returns the number of points of `work` before this index of the batch.
    pub(crate) fn n_before(&self, place: usize) -> usize {
        self.work_places.partition_point(|&other| other < place)
    }

    /// Returns the reason why the run ends with this batch, if the batch is incomplete. `last` is the result
    /// of [`last`](Self::last).
    pub(crate) fn stopped(&self, last: Option<(usize, Last<'_>)>) -> Option<Termination> {
        match last {
            Some((_, Last::Abort(message))) => Some(Termination::Aborted(message.to_owned())),
            Some((place, Last::Target)) if place + 1 < self.sources.len() => Some(Termination::Target),
            _ => self.truncated.then_some(Termination::MaxEvaluations),
        }
    }

    /// Returns the evaluations of this batch that remain valid if the run ends here.
    pub(crate) fn finished_evaluations(&self, batch: &Batch, answers: &[Answer]) -> Vec<EarlyOutcome> {
        let mut finished = Vec::new();
        let mut new = answers.iter();
        for (k, source) in self.sources.iter().enumerate() {
            let answer = match source {
                Source::Run | Source::Begun | Source::Again => new.next(),
                Source::Replayed => self.answers.get(k),
                Source::Cached | Source::Copy(_) | Source::Forbidden => continue,
            };
            if let Some(answer) = answer.filter(|answer| answer.outcome.is_conclusive()) {
                let (id, x) = (batch.id(k), batch.point(k).to_vec());
                let (batch, cutoff, answer) = (batch.index(), batch.cutoff(k), answer.only(batch.kind()));
                let entry = SpeculativeEntry { id, batch, x, cutoff, answer };
                finished.push(EarlyOutcome { entry, is_of_path: true });
            }
        }
        finished
    }

    /// Merges the answers to `work`, in order, and records everything in the ledger.
    ///
    /// # Errors
    /// Returns an error if the number of residuals differs from the earlier points.
    pub(crate) fn close(&mut self, batch: &Batch, answers: &mut [Answer]) -> Result<(), Error> {
        let mut at = 0;
        // With one point at a time, no later point would have been evaluated.
        let last = self.last(answers).map_or(usize::MAX, |(k, _)| k);
        for k in 0..batch.len() {
            match self.sources[k] {
                Source::Run | Source::Begun | Source::Again => {
                    if k <= last {
                        std::mem::swap(&mut self.answers[k], &mut answers[at]);
                    } else {
                        self.keep_unneeded(at, &answers[at]);
                    }
                    at += 1;
                }
                _ if k > last => self.answers[k].clear(),
                Source::Copy(twin) => self.answers[k] = self.answers[twin].clone(),
                Source::Replayed | Source::Cached | Source::Forbidden => {}
            }
            self.ledger.check_constraints(batch.point(k), &self.answers[k])?;
            // Also checks answers from elsewhere, which may come from a file or a user.
            if batch.kind() == EvaluationKind::Residuals {
                self.ledger.count_residuals(batch.point(k), &self.answers[k])?;
                self.answers[k].check_residuals();
            }
            let remembers = match self.sources[k] {
                Source::Run | Source::Begun | Source::Replayed => true,
                // If the point had been completely known, it would not return after the batch has evicted it.
                Source::Again => self.store.remembers(batch.point(k)),
                Source::Cached | Source::Copy(_) | Source::Forbidden => false,
            };
            if remembers {
                self.store.insert(batch.point(k), &self.answers[k], batch.kind());
            }
        }
        if self.store.has_replays() {
            self.store.forget_replays();
        }
        let is_new = |s: &Source| !matches!(s, Source::Again | Source::Cached | Source::Copy(_));
        let new = self.sources.iter().any(is_new);
        self.stale = if new { 0 } else { self.stale + 1 };
        self.ledger.record(batch, &self.answers, &self.sources);
        Ok(())
    }

    /// Keeps the answer to point `k` of `work`, which the path did not reach.
    pub(crate) fn keep_unneeded(&mut self, k: usize, answer: &Answer) {
        if answer.outcome == Outcome::Skipped {
            return;
        }
        let x = self.work.point(k).to_vec();
        let (id, batch) = (self.work.id(k), self.work.index());
        self.keep_early(SpeculativeEntry::new(id, batch, x, self.work.query(k), answer.clone()));
    }

    /// Keeps a speculative evaluation.
    pub(crate) fn keep_early(&mut self, entry: SpeculativeEntry) {
        self.ledger.count_early();
        if let Some(useless) = self.store.keep(EarlyOutcome { entry, is_of_path: false }) {
            self.ledger.trace.push_speculative(useless.entry);
        }
    }

    /// Ends the run and moves the remaining early evaluations to the trace.
    pub(crate) fn finish(&mut self) {
        for early in self.store.drain() {
            if !early.is_of_path {
                self.ledger.trace.push_speculative(early.entry);
            }
        }
        self.ledger.trim(true);
    }

    /// Moves out the answers to the last batch. Unevaluated points are [`Outcome::Skipped`].
    pub(crate) fn reported(&mut self, batch: &Batch) -> &mut Answers {
        self.reported.clear();
        for answer in &mut self.answers {
            if batch.kind() == EvaluationKind::Residuals && answer.outcome.value().is_some() {
                self.reported.push_taken(answer.outcome.clone(), &mut answer.residuals);
            } else {
                self.reported.push(answer.outcome.clone(), &[]);
            }
            if !answer.constraints.is_empty() {
                self.reported.set_constraints(&answer.constraints);
            }
        }
        &mut self.reported
    }

    pub(crate) fn is_stale(&self) -> bool {
        self.stale >= STALE_BATCHES
    }

    pub(crate) fn target_reached(&self, limits: &Limits) -> bool {
        matches!((limits.target, self.ledger.best.cost()), (Some(target), Some(best)) if best <= target)
            && self.ledger.is_feasible()
    }
}

/// A round whose `answers` are still coming in.
pub(crate) struct UnderWay<'a> {
    pub(crate) round: &'a CountedBatch,
    pub(crate) answers: &'a [Answer],
}

impl AnswersSoFar for UnderWay<'_> {
    fn contains(&self, x: &[f64]) -> bool {
        self.round.store.contains(x)
    }

    fn answer(&self, k: usize) -> Option<&Answer> {
        let answer = match *self.round.sources.get(k)? {
            Source::Copy(twin) => return self.answer(twin),
            source if source.is_work() => self.answers.get(self.round.n_before(k)),
            _ => self.round.answers.get(k),
        };
        answer.filter(|answer| answer.outcome.is_conclusive())
    }

    fn ahead(&self, x: &[f64], query: &Query<'_>) -> Option<Answer> {
        self.round.store.look_up(x, query, self.round.cutoff_use)
    }
}

/// Resets the list to `len` empty answers.
pub(crate) fn reset(answers: &mut Vec<Answer>, len: usize) {
    answers.truncate(len);
    answers.iter_mut().for_each(Answer::clear);
    answers.resize_with(len, Answer::default);
}
