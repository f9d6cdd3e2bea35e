//! Trace: every evaluation of a run, in request order, stored in columns.

use crate::outcome::answer::{Answer, Outcome};
use crate::values::encoding::numbers;
use serde::{Deserialize, Serialize};

/// Evaluations of a run. Contains every evaluation of the path in request order, which is the same for any
/// number of workers. Also contains the speculative evaluations that were not needed. If the trace
/// was limited, contains only the last ones of both kinds.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Trace {
    n: usize,
    #[serde(with = "numbers")]
    points: Vec<f64>,
    #[serde(with = "columns")]
    records: Vec<Record>,
    /// Evaluations that the path never reached.
    speculative: Vec<SpeculativeEntry>,
    /// Identity of the problem that the costs belong to, if the user gave one.
    problem: Option<String>,
    /// Number of evaluations before the first one kept.
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
    /// Residuals; empty unless the user requested to keep them.
    pub(crate) residuals: Vec<f64>,
    /// Values of the nonlinear constraints.
    pub(crate) constraints: Vec<f64>,
}

/// File format of records: column by column, with the numbers of a column as one byte string.
mod columns {
    use crate::outcome::answer::Outcome;
    use crate::outcome::trace::Record;
    use crate::values::encoding::numbers;
    use serde::de::{Deserializer, Error};
    use serde::{Deserialize, Serialize, Serializer};
    use std::borrow::Cow;

    #[derive(Default, Serialize, Deserialize)]
    struct Columns<'a> {
        /// NaN if there is no value.
        #[serde(with = "numbers")]
        value: Vec<f64>,
        /// Outcomes in place of the NaN values.
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
        /// Residuals of all records.
        #[serde(with = "numbers")]
        residuals: Vec<f64>,
        #[serde(default, with = "numbers", skip_serializing_if = "Vec::is_empty")]
        n_constraints: Vec<u64>,
        /// Constraint values of all records.
        #[serde(default, with = "numbers", skip_serializing_if = "Vec::is_empty")]
        constraints: Vec<f64>,
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
            columns.n_constraints.push(r.constraints.len() as u64);
            columns.constraints.extend_from_slice(&r.constraints);
        }
        if columns.constraints.is_empty() {
            columns.n_constraints.clear();
        }
        columns.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Record>, D::Error> {
        let columns = Columns::deserialize(from)?;
        let Columns { value, other_outcomes, id, batch, cutoff, used, seconds, .. } = columns;
        let (n_residuals, residuals) = (columns.n_residuals, columns.residuals);
        let (mut n_constraints, constraints) = (columns.n_constraints, columns.constraints);
        let n = value.len();
        if [id.len(), batch.len(), cutoff.len(), used.len(), seconds.len(), n_residuals.len()] != [n; 6] {
            return Err(D::Error::custom("the columns of the trace have different lengths"));
        }
        if n_constraints.is_empty() {
            n_constraints.resize(n, 0);
        } else if n_constraints.len() != n {
            return Err(D::Error::custom("the columns of the trace have different lengths"));
        }
        let mut others = other_outcomes.into_iter().map(Cow::into_owned);
        let (mut rest, mut other_values) = (&residuals[..], &constraints[..]);
        let record = |k: usize| {
            let outcome = if value[k].is_nan() { others.next()? } else { Outcome::Value(value[k]) };
            let (residuals_of_row, later) = rest.split_at_checked(n_residuals[k].try_into().ok()?)?;
            rest = later;
            let (values, later) = other_values.split_at_checked(n_constraints[k].try_into().ok()?)?;
            other_values = later;
            let constraints = values.to_vec();
            let (residuals, used) = (residuals_of_row.to_vec(), used[k] != 0);
            let (id, batch, cutoff, seconds) = (id[k], batch[k], cutoff[k], seconds[k]);
            Some(Record { outcome, id, batch, cutoff, used, seconds, residuals, constraints })
        };
        let records = (0..n).map(record).collect::<Option<_>>();
        records.ok_or_else(|| D::Error::custom("the trace lacks outcomes or residuals"))
    }
}

/// An evaluation made speculatively.
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
    /// Point, in the user's units.
    pub x: &'a [f64],
    /// Outcome of the evaluation.
    pub outcome: &'a Outcome,
    /// Id of the point in the run; at least 2^63 if it was evaluated speculatively.
    pub id: u64,
    /// Index of the batch.
    pub batch: u64,
    /// Cutoff passed to the objective; infinite if there is none.
    pub cutoff: f64,
    /// True if the outcome was passed to the method. False for evaluations that were cut short by the end of
    /// the run and for speculative ones ([`Trace::speculative`]). These are never returned as best.
    pub used: bool,
    /// Duration of the evaluation in seconds of wall-clock time.
    pub seconds: f64,
    /// Residuals, if they were requested and the trace keeps them; otherwise empty.
    pub residuals: &'a [f64],
    /// Values of the nonlinear constraints; empty if there are none.
    pub constraints: &'a [f64],
}

impl Record {
    fn entry<'a>(&'a self, x: &'a [f64]) -> TraceEntry<'a> {
        let Self { outcome, id, batch, cutoff, used, seconds, residuals, constraints } = self;
        let (id, batch, cutoff, used, seconds) = (*id, *batch, *cutoff, *used, *seconds);
        TraceEntry { x, outcome, id, batch, cutoff, used, seconds, residuals, constraints }
    }
}

impl Trace {
    /// Creates an empty trace of points with `n` parameters.
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

    /// Returns the identity of the problem that the costs belong to. `None` if no identity was given, see
    /// [`Minimize::problem`](crate::Minimize::problem).
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    /// Returns the cost of the path if it is the same at several different points.
    pub(crate) fn constant(&self) -> Option<f64> {
        let first = self.records.first().filter(|_| self.dropped == 0)?.outcome.value()?;
        let is_moved = self.points.chunks_exact(self.n.max(1)).any(|x| x != &self.points[..self.n]);
        (is_moved && self.records.iter().all(|r| r.outcome == Outcome::Value(first))).then_some(first)
    }

    /// Returns the length of the longer list.
    pub(crate) fn longest(&self) -> usize {
        self.records.len().max(self.speculative.len())
    }

    /// Returns the number of evaluations, including dropped ones.
    pub(crate) fn end(&self) -> usize {
        self.dropped + self.records.len()
    }

    /// Drops all but the last `limit` evaluations.
    pub(crate) fn keep_last(&mut self, limit: usize) {
        let surplus = self.records.len().saturating_sub(limit);
        self.records.drain(..surplus);
        self.points.drain(..surplus * self.n);
        self.dropped += surplus;
        let surplus = self.speculative.len().saturating_sub(limit);
        self.speculative.drain(..surplus);
    }

    /// True if all parts are consistent. A trace read from a file may be inconsistent.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.n == n
            && self.points.len() == self.records.len() * n
            && self.speculative.iter().all(|early| early.x.len() == n)
    }

    /// Returns the number of evaluations at the beginning of the run that the trace limit has dropped.
    pub fn n_dropped(&self) -> usize {
        self.dropped
    }

    /// Returns the number of kept evaluations of the path.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// True if nothing was evaluated.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Returns the number of parameters of each point.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Returns all points of the path, one after the other. Row `k` starts at `k * n`.
    pub fn points(&self) -> &[f64] {
        &self.points
    }

    /// Returns evaluation `k` of the kept ones, if it exists.
    pub fn get(&self, k: usize) -> Option<TraceEntry<'_>> {
        let r = self.records.get(k)?;
        let x = &self.points[k * self.n..(k + 1) * self.n];
        Some(r.entry(x))
    }

    /// Returns the evaluations of the path in request order.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = TraceEntry<'_>> + ExactSizeIterator {
        self.iter_from(0)
    }

    /// Returns the kept evaluations starting with number `first` of the run.
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

    /// Returns the evaluations made speculatively that the path never reached, in the order in which this
    /// became known. Their number and selection may depend on the number of workers and on the duration of
    /// evaluations.
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
            constraints: &early.answer.constraints,
        })
    }

    /// Appends the evaluations of a later run over the same parameters. The numbers of its points and batches
    /// are continued.
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

    /// Returns the first of the used points with the smallest cost that are not above their cutoffs. Only a
    /// barrier makes costs above a cutoff possible, see [`Barrier`](crate::Barrier).
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
