//! Answer to an evaluation: a cost, "above the cutoff", or "failed: why"; and the residuals, where they were
//! requested.

use crate::values::encoding::numbers;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Outcome of one evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The cost. NaN and infinities become [`Failed`](Self::Failed) when it is counted.
    Value(f64),
    /// The evaluation was given up because the cost is strictly greater than this cutoff. Never a cost, never
    /// best.
    Above(f64),
    /// There is no cost at this point. Ranks behind every finite cost.
    Failed(Failure),
    /// The whole run must end (an exception that is to reach the user, for example).
    Abort(String),
    /// The run ended before this point was evaluated. Nothing is concluded from it; objectives do not return
    /// it.
    Skipped,
}

impl Outcome {
    /// A failure with [`FailureKind::Error`] and this message.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed(Failure { kind: FailureKind::Error, message: message.into() })
    }

    /// A failure with [`FailureKind::NotFinite`] and this message.
    pub(crate) fn not_finite(message: String) -> Self {
        Self::Failed(Failure { kind: FailureKind::NotFinite, message })
    }

    /// A failure with [`FailureKind::Cancelled`]: the evaluation saw
    /// [`Query::cancelled`](crate::Query::cancelled) and gave up.
    pub fn cancelled() -> Self {
        Self::Failed(Failure { kind: FailureKind::Cancelled, message: "cancelled".to_owned() })
    }

    /// A failure with [`FailureKind::Lost`]: the engine returned no answer, for this reason.
    pub fn lost(message: impl Into<String>) -> Self {
        Self::Failed(Failure { kind: FailureKind::Lost, message: message.into() })
    }

    /// True if the engine lost the evaluation.
    pub(crate) fn is_lost(&self) -> bool {
        matches!(self, Self::Failed(failure) if failure.kind == FailureKind::Lost)
    }

    /// The cost, if there is a finite one.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value(v) if v.is_finite() => Some(*v),
            _ => None,
        }
    }

    /// True if this says anything about the point: false for [`Skipped`](Self::Skipped),
    /// [`Abort`](Self::Abort), lost and cancelled evaluations, from which no decision may follow.
    pub fn is_known(&self) -> bool {
        match self {
            Self::Value(_) | Self::Above(_) => true,
            Self::Failed(failure) => failure.kind.is_of_point(),
            Self::Abort(_) | Self::Skipped => false,
        }
    }

    /// True if this says something lasting about the point: another evaluation would give the same.
    pub(crate) fn is_lasting(&self) -> bool {
        match self {
            Self::Failed(failure) => failure.kind.is_of_point() && failure.kind != FailureKind::TimedOut,
            other => other.is_known(),
        }
    }

    /// The one form that everything relies on that counts it: finite values, honest cutoffs.
    pub(crate) fn checked(self, cutoff: f64) -> Self {
        match self {
            Self::Value(v) if !v.is_finite() => Self::not_finite(format!("cost is {v}")),
            Self::Above(c) if c.is_nan() || c < cutoff => {
                Self::failed(format!("given up above {c}, although the cutoff was {cutoff}"))
            }
            Self::Skipped => Self::failed("the objective returned Skipped"),
            other => other,
        }
    }
}

/// A failed evaluation: of which kind, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Of which kind.
    pub kind: FailureKind,
    /// The reason, for people. Equal texts are counted together in a report, so leave out what changes every
    /// time.
    pub message: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// The kinds of failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum FailureKind {
    /// The cost was NaN or infinite.
    NotFinite,
    /// The objective reported an error.
    Error,
    /// The objective panicked.
    Panic,
    /// The objective ran out of its own time limit.
    TimedOut,
    /// The run was being ended; says nothing about the point.
    Cancelled,
    /// The engine that evaluates lost the point (a machine or a connection is gone); says nothing about the
    /// point, which is evaluated again.
    Lost,
}

impl FailureKind {
    /// True if the failure says something about the point, rather than about the run or its engine.
    pub fn is_of_point(self) -> bool {
        !matches!(self, Self::Cancelled | Self::Lost)
    }
}

/// Kind of values that are requested of a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub enum Want {
    /// Its cost.
    #[default]
    Cost,
    /// Its cost and the residuals that it is made from; then there is no cutoff.
    Residuals,
}

/// The answer to one query. An objective fills one that is lent to it, so that nothing is allocated once it
/// is warm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Outcome of the evaluation.
    pub outcome: Outcome,
    /// The residuals, always the same number in the same order. Looked at only where the query wanted them
    /// and the outcome is a value.
    #[serde(with = "numbers")]
    pub residuals: Vec<f64>,
    /// Work of the evaluation, in units of the objective's own (right-hand sides, for example); 0 if it does
    /// not count.
    pub work: u64,
    /// Wall-clock seconds; the evaluator measures them.
    pub seconds: f64,
}

impl Default for Answer {
    /// [`Outcome::Skipped`]: nothing yet.
    fn default() -> Self {
        Self { outcome: Outcome::Skipped, residuals: Vec::new(), work: 0, seconds: 0.0 }
    }
}

impl From<Outcome> for Answer {
    fn from(outcome: Outcome) -> Self {
        Self { outcome, ..Self::default() }
    }
}

impl Answer {
    /// Clears everything; keeps the memory for residuals.
    pub fn clear(&mut self) {
        self.outcome = Outcome::Skipped;
        self.residuals.clear();
        (self.work, self.seconds) = (0, 0.0);
    }

    /// True if this answers a query for `want`.
    pub(crate) fn answers(&self, want: Want) -> bool {
        let without = want == Want::Residuals && self.residuals.is_empty();
        !(without && matches!(self.outcome, Outcome::Value(_)))
    }

    /// The same without what was not wanted.
    pub(crate) fn only(&self, want: Want) -> Self {
        let residuals = if want == Want::Residuals { self.residuals.clone() } else { Vec::new() };
        Self { outcome: self.outcome.clone(), residuals, ..*self }
    }

    /// Makes a failure of a cost whose residuals are missing or not finite.
    pub(crate) fn check_residuals(&mut self) {
        if let Some(failure) = self.residuals_failure() {
            self.outcome = failure;
        }
    }

    /// The failure that it is.
    pub(crate) fn residuals_failure(&self) -> Option<Outcome> {
        if !matches!(self.outcome, Outcome::Value(_)) {
            return None;
        }
        if self.residuals.is_empty() {
            return Some(Outcome::failed("the objective gave a cost without residuals"));
        }
        let bad = self.residuals.iter().enumerate().find(|(_, r)| !r.is_finite());
        bad.map(|(k, r)| Outcome::not_finite(format!("residual {k} is {r}")))
    }
}

/// The answers to a batch, in request order.
#[derive(Debug, Clone, Default)]
pub struct Answers {
    outcomes: Vec<Outcome>,
    /// Number of residuals of each point; 0 if none were wanted.
    m: usize,
    residuals: Vec<Vec<f64>>,
    /// Memory of residuals that were removed.
    spare: Vec<Vec<f64>>,
}

impl PartialEq for Answers {
    fn eq(&self, other: &Self) -> bool {
        (&self.outcomes, &self.residuals) == (&other.outcomes, &other.residuals)
    }
}

impl Answers {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.outcomes.len()
    }

    /// True if there are no outcomes.
    pub fn is_empty(&self) -> bool {
        self.outcomes.is_empty()
    }

    /// The outcomes in request order. Those of points that were not evaluated are [`Outcome::Skipped`].
    pub fn outcomes(&self) -> &[Outcome] {
        &self.outcomes
    }

    /// The residuals of point `k`; `None` where there are none, or none were wanted.
    pub fn residuals(&self, k: usize) -> Option<&[f64]> {
        let known = self.m > 0 && self.outcomes[k].value().is_some();
        known.then(|| &self.residuals[k][..])
    }

    /// As [`residuals`](Self::residuals), and leaves none behind.
    pub fn take_residuals(&mut self, k: usize) -> Option<Vec<f64>> {
        let known = self.m > 0 && self.outcomes[k].value().is_some();
        known.then(|| std::mem::take(&mut self.residuals[k]))
    }

    /// Adds a point. All residual vectors have the length of the first one: of a longer one the rest is left
    /// out, a shorter one is filled up with zeros.
    pub fn push(&mut self, outcome: Outcome, residuals: &[f64]) {
        let mut own = self.spare.pop().unwrap_or_default();
        own.clear();
        own.extend_from_slice(residuals);
        self.push_own(outcome, own);
    }

    /// As [`push`](Self::push), without a copy: what is left of the residuals is some memory.
    pub(crate) fn push_taken(&mut self, outcome: Outcome, residuals: &mut Vec<f64>) {
        let own = std::mem::replace(residuals, self.spare.pop().unwrap_or_default());
        self.push_own(outcome, own);
    }

    fn push_own(&mut self, outcome: Outcome, mut residuals: Vec<f64>) {
        if self.m == 0 && !residuals.is_empty() {
            self.m = residuals.len();
            self.residuals.iter_mut().for_each(|before| before.resize(self.m, 0.0));
        }
        residuals.resize(self.m, 0.0);
        self.outcomes.push(outcome);
        self.residuals.push(residuals);
    }

    /// Removes all points; keeps their memory.
    pub fn clear(&mut self) {
        self.outcomes.clear();
        self.spare.append(&mut self.residuals);
        self.m = 0;
    }
}

impl Extend<Outcome> for Answers {
    fn extend<T: IntoIterator<Item = Outcome>>(&mut self, outcomes: T) {
        outcomes.into_iter().for_each(|outcome| self.push(outcome, &[]));
    }
}

impl FromIterator<Outcome> for Answers {
    fn from_iter<T: IntoIterator<Item = Outcome>>(outcomes: T) -> Self {
        let mut answers = Self::default();
        answers.extend(outcomes);
        answers
    }
}

impl From<&[Outcome]> for Answers {
    fn from(outcomes: &[Outcome]) -> Self {
        outcomes.iter().cloned().collect()
    }
}

/// The best point seen so far, and its cost. Of equal costs the first stays.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Best(Option<(Vec<f64>, f64)>);

impl Best {
    /// Takes over a point whose cost is lower; whether it is.
    pub(crate) fn offer(&mut self, x: &[f64], cost: f64) -> bool {
        match &mut self.0 {
            Some((best, f)) if cost < *f => {
                best.copy_from_slice(x);
                *f = cost;
            }
            Some(_) => return false,
            None => self.0 = Some((x.to_vec(), cost)),
        }
        true
    }

    pub(crate) fn get(&self) -> Option<(&[f64], f64)> {
        self.0.as_ref().map(|(x, f)| (&x[..], *f))
    }

    pub(crate) fn cost(&self) -> Option<f64> {
        self.0.as_ref().map(|(_, f)| *f)
    }

    /// True if the point has this length and a cost: what comes from a file may not.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        self.0.as_ref().is_none_or(|(x, cost)| x.len() == n && cost.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_not_finite_become_failures() {
        for v in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(matches!(
                Outcome::Value(v).checked(f64::INFINITY),
                Outcome::Failed(Failure { kind: FailureKind::NotFinite, .. })
            ));
        }
        assert_eq!(Outcome::Value(1.0).checked(0.5), Outcome::Value(1.0));
    }

    #[test]
    fn giving_up_below_the_cutoff_is_a_failure() {
        assert_eq!(Outcome::Above(2.0).checked(2.0), Outcome::Above(2.0));
        assert_eq!(Outcome::Above(3.0).checked(2.0), Outcome::Above(3.0));
        for (above, cutoff) in [(1.0, 2.0), (f64::NAN, 2.0), (1.0, f64::INFINITY)] {
            assert!(matches!(Outcome::Above(above).checked(cutoff), Outcome::Failed(_)));
        }
    }

    #[test]
    fn residuals_are_there_and_finite() {
        let check = |residuals: &[f64]| {
            let mut answer = Answer { residuals: residuals.to_vec(), ..Outcome::Value(1.0).into() };
            answer.check_residuals();
            answer.outcome
        };
        assert!(matches!(check(&[]), Outcome::Failed(_)));
        assert_eq!(check(&[1.0, 0.0]), Outcome::Value(1.0));
        let Outcome::Failed(failure) = check(&[1.0, f64::NAN]) else { panic!() };
        assert_eq!((failure.kind, &failure.message[..]), (FailureKind::NotFinite, "residual 1 is NaN"));
    }

    #[test]
    fn the_rows_of_a_batch_stay_apart() {
        let mut answers = Answers::default();
        answers.push(Outcome::failed("no"), &[]);
        answers.push(Outcome::Value(5.0), &[1.0, 2.0]);
        answers.push(Outcome::Skipped, &[]);
        answers.push(Outcome::Value(25.0), &[3.0, 4.0]);
        assert_eq!((answers.residuals(0), answers.residuals(2)), (None, None));
        assert_eq!(
            (answers.residuals(1), answers.residuals(3)),
            (Some(&[1.0, 2.0][..]), Some(&[3.0, 4.0][..]))
        );
        answers.push(Outcome::Value(1.0), &[5.0, 6.0, 7.0]);
        answers.push(Outcome::Value(2.0), &[8.0, 9.0]);
        assert_eq!(
            (answers.residuals(4), answers.residuals(5)),
            (Some(&[5.0, 6.0][..]), Some(&[8.0, 9.0][..]))
        );
        answers.clear();
        answers.push(Outcome::Value(1.0), &[]);
        assert_eq!((answers.len(), answers.residuals(0)), (1, None));
    }
}
