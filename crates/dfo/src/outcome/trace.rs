//! The trace: every evaluation of a run, in request order, stored in columns.

use crate::outcome::answer::{Answer, Outcome};
use crate::values::encoding::numbers;
use serde::{Deserialize, Serialize};

/// Every evaluation of a run's path, in request order (the same for any number of workers); and beside them
/// those that were made ahead of need and not needed. Or the last ones of both, if the trace was limited.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Trace {
    n: usize,
    #[serde(with = "numbers")]
    points: Vec<f64>,
    #[serde(with = "columns")]
    records: Vec<Record>,
    /// Evaluations that the path never came to.
    speculative: Vec<SpeculativeEntry>,
    /// Identity of the problem that the costs belong to, if the user has vouched for one.
    problem: Option<String>,
    /// Evaluations that came before the first one kept.
    dropped: usize,
}

/// An evaluation without its point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    pub(crate) outcome: Outcome,
    pub(crate) id: u64,
    pub(crate) batch: u64,
    pub(crate) cutoff: f64,
    pub(crate) used: bool,
    pub(crate) seconds: f64,
    /// Kept only where the user asked for that.
    pub(crate) residuals: Vec<f64>,
}

/// Records in a file: column by column, as many numbers as one string of bytes.
mod columns {
    use crate::outcome::answer::Outcome;
    use crate::outcome::trace::Record;
    use crate::values::encoding::numbers;
    use serde::de::{Deserializer, Error};
    use serde::{Deserialize, Serialize, Serializer};
    use std::borrow::Cow;

    #[derive(Default, Serialize, Deserialize)]
    struct Columns<'a> {
        /// NaN where there is none.
        #[serde(with = "numbers")]
        value: Vec<f64>,
        /// In place of the values that are NaN.
        other_outcomes: Vec<Cow<'a, Outcome>>,
        #[serde(with = "numbers")]
        id: Vec<u64>,
        #[serde(with = "numbers")]
        batch: Vec<u64>,
        #[serde(with = "numbers")]
        cutoff: Vec<f64>,
        #[serde(with = "serde_bytes")]
        used: Vec<u8>,
        #[serde(with = "numbers")]
        seconds: Vec<f64>,
        #[serde(with = "numbers")]
        n_residuals: Vec<u64>,
        /// Those of all records.
        #[serde(with = "numbers")]
        residuals: Vec<f64>,
    }

    pub(super) fn serialize<S: Serializer>(records: &[Record], to: S) -> Result<S::Ok, S::Error> {
        let mut columns = Columns::default();
        for r in records {
            match r.outcome.value() {
                Some(value) if !value.is_nan() => columns.value.push(value),
                _ => {
                    columns.value.push(f64::NAN);
                    columns.other_outcomes.push(Cow::Borrowed(&r.outcome));
                }
            }
            columns.id.push(r.id);
            columns.batch.push(r.batch);
            columns.cutoff.push(r.cutoff);
            columns.used.push(r.used.into());
            columns.seconds.push(r.seconds);
            columns.n_residuals.push(r.residuals.len() as u64);
            columns.residuals.extend_from_slice(&r.residuals);
        }
        columns.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Record>, D::Error> {
        let columns = Columns::deserialize(from)?;
        let Columns { value, other_outcomes, id, batch, cutoff, used, seconds, n_residuals, residuals } =
            columns;
        let n = value.len();
        if [id.len(), batch.len(), cutoff.len(), used.len(), seconds.len(), n_residuals.len()] != [n; 6] {
            return Err(D::Error::custom("the columns of the trace have different lengths"));
        }
        let mut others = other_outcomes.into_iter().map(Cow::into_owned);
        let mut rest = &residuals[..];
        let record = |k: usize| {
            let outcome = if value[k].is_nan() { others.next()? } else { Outcome::Value(value[k]) };
            let (own, later) = rest.split_at_checked(n_residuals[k].try_into().ok()?)?;
            rest = later;
            let (residuals, used) = (own.to_vec(), used[k] != 0);
            let (id, batch, cutoff, seconds) = (id[k], batch[k], cutoff[k], seconds[k]);
            Some(Record { outcome, id, batch, cutoff, used, seconds, residuals })
        };
        let records = (0..n).map(record).collect::<Option<_>>();
        records.ok_or_else(|| D::Error::custom("the trace lacks outcomes or residuals"))
    }
}

/// An evaluation made ahead of need.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SpeculativeEntry {
    pub(crate) id: u64,
    pub(crate) batch: u64,
    pub(crate) x: Vec<f64>,
    pub(crate) cutoff: f64,
    pub(crate) answer: Answer,
}

/// One evaluation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TraceEntry<'a> {
    /// The point, in the user's units.
    pub x: &'a [f64],
    /// Outcome of the evaluation.
    pub outcome: &'a Outcome,
    /// Number of the point in the run; from 2^63 on if it was evaluated ahead of need.
    pub id: u64,
    /// Number of the batch.
    pub batch: u64,
    /// The cutoff that the objective was told; infinite if none.
    pub cutoff: f64,
    /// True if the method was given this outcome. False for evaluations that the end of the run cut short,
    /// and for speculative ones ([`Trace::speculative`]): they are never returned as best.
    pub used: bool,
    /// Wall-clock seconds of the evaluation.
    pub seconds: f64,
    /// The residuals, where they were wanted and the trace was asked to keep them; else empty.
    pub residuals: &'a [f64],
}

impl Record {
    fn entry<'a>(&'a self, x: &'a [f64]) -> TraceEntry<'a> {
        let Self { outcome, id, batch, cutoff, used, seconds, residuals } = self;
        let (id, batch, cutoff, used, seconds) = (*id, *batch, *cutoff, *used, *seconds);
        TraceEntry { x, outcome, id, batch, cutoff, used, seconds, residuals }
    }
}

impl Trace {
    /// That of a run of so many parameters before its first evaluation.
    pub fn new(n: usize) -> Self {
        Self { n, ..Self::default() }
    }

    pub(crate) fn push(&mut self, x: &[f64], record: Record) {
        self.points.extend_from_slice(x);
        self.records.push(record);
    }

    pub(crate) fn push_speculative(&mut self, early: SpeculativeEntry) {
        if !matches!(early.answer.outcome, Outcome::Skipped) {
            self.speculative.push(early);
        }
    }

    pub(crate) fn set_problem(&mut self, problem: Option<String>) {
        self.problem = problem;
    }

    /// Identity of the problem that the costs belong to; `None` if none was given, see
    /// [`Minimize::problem`](crate::Minimize::problem).
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    /// The cost that all points of the path have, if it is one and the same at several points.
    pub(crate) fn constant(&self) -> Option<f64> {
        let first = self.records.first().filter(|_| self.dropped == 0)?.outcome.value()?;
        let is_moved = self.points.chunks_exact(self.n.max(1)).any(|x| x != &self.points[..self.n]);
        (is_moved && self.records.iter().all(|r| r.outcome == Outcome::Value(first))).then_some(first)
    }

    /// Length of the longer list.
    pub(crate) fn longest(&self) -> usize {
        self.records.len().max(self.speculative.len())
    }

    /// Number of evaluations, those dropped included.
    pub(crate) fn end(&self) -> usize {
        self.dropped + self.records.len()
    }

    /// Drops all but the last so many evaluations.
    pub(crate) fn keep_last(&mut self, limit: usize) {
        let surplus = self.records.len().saturating_sub(limit);
        self.records.drain(..surplus);
        self.points.drain(..surplus * self.n);
        self.dropped += surplus;
        let surplus = self.speculative.len().saturating_sub(limit);
        self.speculative.drain(..surplus);
    }

    /// True if its parts fit together: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.n == n
            && self.points.len() == self.records.len() * n
            && self.speculative.iter().all(|early| early.x.len() == n)
    }

    /// Evaluations at the beginning of the run that a limit of the trace has dropped.
    pub fn n_dropped(&self) -> usize {
        self.dropped
    }

    /// Number of evaluations of the path kept.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// True if nothing was evaluated.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Number of parameters of each point.
    pub fn n(&self) -> usize {
        self.n
    }

    /// All points of the path, one after the other: row `k` starts at `k * n`.
    pub fn points(&self) -> &[f64] {
        &self.points
    }

    /// Evaluation `k` of those kept, if there is one.
    pub fn get(&self, k: usize) -> Option<TraceEntry<'_>> {
        let r = self.records.get(k)?;
        let x = &self.points[k * self.n..(k + 1) * self.n];
        Some(r.entry(x))
    }

    /// The evaluations of the path in request order.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = TraceEntry<'_>> + ExactSizeIterator {
        self.iter_from(0)
    }

    /// The evaluations from number `first` of the run on, as far as they are kept.
    pub fn iter_from(
        &self,
        first: usize,
    ) -> impl DoubleEndedIterator<Item = TraceEntry<'_>> + ExactSizeIterator {
        let first = first.saturating_sub(self.dropped).min(self.len());
        self.records[first..]
            .iter()
            .enumerate()
            .map(move |(k, r)| r.entry(&self.points[(first + k) * self.n..(first + k + 1) * self.n]))
    }

    /// The evaluations made ahead of need that the path never came to, in the order in which that was known.
    /// How many there are, and which, may depend on the number of workers and on how long evaluations take.
    pub fn speculative(&self) -> impl ExactSizeIterator<Item = TraceEntry<'_>> {
        self.speculative.iter().map(|early| TraceEntry {
            x: &early.x,
            outcome: &early.answer.outcome,
            id: early.id,
            batch: early.batch,
            cutoff: early.cutoff,
            used: false,
            seconds: early.answer.seconds,
            residuals: &early.answer.residuals,
        })
    }

    /// Appends the evaluations of a run that came after this one, over the same parameters. Its points and
    /// batches are numbered on.
    pub fn append(&mut self, mut later: Trace) {
        if later.dropped > 0 {
            later.dropped += self.end();
            self.points.clear();
            self.records.clear();
            self.dropped = 0;
        }
        let batches = self.records.iter().map(|r| r.batch).chain(self.speculative.iter().map(|e| e.batch));
        let (points, n_early) = (self.end() as u64, self.speculative.len() as u64);
        let batch = batches.max().map_or(0, |last| last + 1);
        later.records.iter_mut().for_each(|r| (r.id, r.batch) = (r.id + points, r.batch + batch));
        later.speculative.iter_mut().for_each(|e| (e.id, e.batch) = (e.id + n_early, e.batch + batch));
        self.n = later.n;
        self.points.append(&mut later.points);
        self.records.append(&mut later.records);
        self.speculative.append(&mut later.speculative);
        self.dropped += later.dropped;
    }

    /// The first of the used points with the smallest cost, among those not above their cutoffs (which only a
    /// barrier makes possible: see [`Barrier`](crate::Barrier)).
    pub fn best(&self) -> Option<(&[f64], f64)> {
        let mut best: Option<(&[f64], f64)> = None;
        for entry in self.iter().filter(|e| e.used) {
            let value = entry.outcome.value().filter(|v| *v <= entry.cutoff);
            if let Some(v) = value.filter(|v| best.is_none_or(|(_, b)| *v < b)) {
                best = Some((entry.x, v));
            }
        }
        best
    }
}
