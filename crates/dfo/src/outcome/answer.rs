//! Answer to an evaluation: a cost, "above the cutoff", or a failure with its reason. Also contains the
//! residuals if they were requested.

use crate::values::encoding::numbers;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Outcome of one evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The cost. NaN and infinities become [`Failed`](Self::Failed) when it is counted.
    Value(f64),
    /// The evaluation was abandoned because the cost is strictly greater than this cutoff. Never counts as a
    /// cost or as best.
    Above(f64),
    /// There is no cost at this point. Ranks behind every finite cost.
    Failed(Failure),
    /// The whole run must end, for example because of an exception that must reach the user.
    Abort(String),
    /// The run ended before this point was evaluated. No decision follows from it. Objectives do not return
    /// it.
    Skipped,
}

impl Outcome {
    /// Creates a failure with [`FailureKind::Error`] and this message.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed(Failure { kind: FailureKind::Error, message: message.into() })
    }

    /// Creates a failure with [`FailureKind::NotFinite`] and this message.
    pub(crate) fn not_finite(message: String) -> Self {
        Self::Failed(Failure { kind: FailureKind::NotFinite, message })
    }

    /// Creates a failure with [`FailureKind::Cancelled`]. Return it if the evaluation stopped because of
    /// [`Query::cancelled`](crate::Query::cancelled).
    pub fn cancelled() -> Self {
        Self::Failed(Failure { kind: FailureKind::Cancelled, message: "cancelled".to_owned() })
    }

    /// Creates a failure with [`FailureKind::Lost`] and this reason: the engine returned no answer.
    pub fn lost(message: impl Into<String>) -> Self {
        Self::Failed(Failure { kind: FailureKind::Lost, message: message.into() })
    }

    /// Creates a failure with [`FailureKind::Infeasible`]: the cost was not evaluated, because a constraint
    /// that must be kept is violated.
    pub fn infeasible() -> Self {
        let message = "not evaluated, because a constraint is violated".to_owned();
        Self::Failed(Failure { kind: FailureKind::Infeasible, message })
    }

    /// True if the engine lost the evaluation.
    pub(crate) fn is_lost(&self) -> bool {
        matches!(self, Self::Failed(failure) if failure.kind == FailureKind::Lost)
    }

    /// Returns the cost if it is finite.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value(v) if v.is_finite() => Some(*v),
            _ => None,
        }
    }

    /// True if the outcome is information about the point. False for [`Skipped`](Self::Skipped),
    /// [`Abort`](Self::Abort), and lost and cancelled evaluations, on which no decision may depend.
    pub fn is_conclusive(&self) -> bool {
        match self {
            Self::Value(_) | Self::Above(_) => true,
            Self::Failed(failure) => failure.kind.is_of_point(),
            Self::Abort(_) | Self::Skipped => false,
        }
    }

    /// True if another evaluation of the point would give the same outcome.
    pub(crate) fn is_lasting(&self) -> bool {
        match self {
            Self::Failed(failure) => failure.kind.is_of_point() && failure.kind != FailureKind::TimedOut,
            other => other.is_conclusive(),
        }
    }

    /// Converts an outcome to its canonical form, with finite values and valid cutoffs.
    pub(crate) fn checked(self, cutoff: f64) -> Self {
        match self {
            Self::Value(v) if !v.is_finite() => Self::not_finite(format!("cost is {v}")),
            Self::Above(c) if c.is_nan() || c < cutoff => {
                Self::failed(format!("the objective returned Above({c}), although the cutoff is {cutoff}"))
            }
            Self::Skipped => Self::failed("the objective returned Skipped"),
            other => other,
        }
    }
}

/// Kind and reason of a failed evaluation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Kind of the failure.
    pub kind: FailureKind,
    /// Reason in words. Reports count equal reasons together, so omit details that change with each
    /// evaluation.
    pub message: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

/// Kind of a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum FailureKind {
    /// The cost was NaN or infinite.
    NotFinite,
    /// The objective reported an error.
    Error,
    /// The objective panicked.
    Panic,
    /// The objective exceeded its own time limit.
    TimedOut,
    /// The cost was not evaluated, because a constraint that must be kept is violated.
    Infeasible,
    /// The run was ending. Not a property of the point.
    Cancelled,
    /// The engine lost the point, for example because a machine or a connection failed. Not a property of the
    /// point, which is evaluated again.
    Lost,
}

impl FailureKind {
    /// True if the failure is a property of the point, not of the run or its engine.
    pub fn is_of_point(self) -> bool {
        !matches!(self, Self::Cancelled | Self::Lost)
    }
}

/// Kind of values requested at a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub enum EvaluationKind {
    /// The cost.
    #[default]
    Cost,
    /// The cost and its residuals. There is no cutoff.
    Residuals,
}

/// Answer to one query. An objective fills an existing answer, so nothing is allocated after the first
/// evaluations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Outcome of the evaluation.
    pub outcome: Outcome,
    /// Residuals, always the same number in the same order. Used only if the query requested them and the
    /// outcome is a value.
    #[serde(with = "numbers")]
    pub residuals: Vec<f64>,
    /// Values of the nonlinear constraints, in their order, whatever the outcome. Empty if there are none.
    #[serde(default, with = "numbers", skip_serializing_if = "Vec::is_empty")]
    pub constraints: Vec<f64>,
    /// Work of the evaluation in a unit chosen by the objective, for example right-hand side evaluations. 0
    /// if the objective does not count its work.
    pub work: u64,
    /// Wall-clock time in seconds, measured by the evaluator.
    pub seconds: f64,
}

impl Default for Answer {
    /// Returns an answer with [`Outcome::Skipped`].
    fn default() -> Self {
        Self {
            outcome: Outcome::Skipped,
            residuals: Vec::new(),
            constraints: Vec::new(),
            work: 0,
            seconds: 0.0,
        }
    }
}

impl From<Outcome> for Answer {
    fn from(outcome: Outcome) -> Self {
        Self { outcome, ..Self::default() }
    }
}

impl Answer {
    /// Clears the answer and keeps the memory of the residuals.
    pub fn clear(&mut self) {
        self.outcome = Outcome::Skipped;
        self.residuals.clear();
        self.constraints.clear();
        (self.work, self.seconds) = (0, 0.0);
    }

    /// True if this answers a query of this kind.
    pub(crate) fn answers(&self, kind: EvaluationKind) -> bool {
        let without = kind == EvaluationKind::Residuals && self.residuals.is_empty();
        !(without && matches!(self.outcome, Outcome::Value(_)))
    }

    /// Returns a copy with only the requested values.
    pub(crate) fn only(&self, kind: EvaluationKind) -> Self {
        let residuals = if kind == EvaluationKind::Residuals { self.residuals.clone() } else { Vec::new() };
        let (outcome, constraints) = (self.outcome.clone(), self.constraints.clone());
        Self { outcome, residuals, constraints, ..*self }
    }

    /// Turns a cost into a failure if its residuals are missing or not finite.
    pub(crate) fn check_residuals(&mut self) {
        if let Some(failure) = self.residuals_failure() {
            self.outcome = failure;
        }
    }

    /// Returns the failure if the residuals of a cost are missing or not finite.
    pub(crate) fn residuals_failure(&self) -> Option<Outcome> {
        if !matches!(self.outcome, Outcome::Value(_)) {
            return None;
        }
        if self.residuals.is_empty() {
            return Some(Outcome::failed("the objective returned a cost without residuals"));
        }
        let bad = self.residuals.iter().enumerate().find(|(_, r)| !r.is_finite());
        bad.map(|(k, r)| Outcome::not_finite(format!("residual {k} is {r}")))
    }
}

/// Answers to a batch, in request order.
#[derive(Debug, Clone, Default)]
pub struct Answers {
    outcomes: Vec<Outcome>,
    /// Number of residuals of each point; 0 if residuals were not requested.
    m: usize,
    residuals: Vec<Vec<f64>>,
    /// Number of constraint values of each point, and the values.
    n_constraints: usize,
    constraints: Vec<f64>,
    /// Memory of removed residuals, for reuse.
    spare: Vec<Vec<f64>>,
}

impl PartialEq for Answers {
    fn eq(&self, other: &Self) -> bool {
        (&self.outcomes, &self.residuals, &self.constraints)
            == (&other.outcomes, &other.residuals, &other.constraints)
    }
}

impl Answers {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.outcomes.len()
    }

    /// True if there are no outcomes.
    pub fn is_empty(&self) -> bool {
        self.outcomes.is_empty()
    }

    /// Returns the outcomes in request order. Unevaluated points have [`Outcome::Skipped`].
    pub fn outcomes(&self) -> &[Outcome] {
        &self.outcomes
    }

    /// Returns the residuals of point `k`; `None` if there are none or they were not requested.
    pub fn residuals(&self, k: usize) -> Option<&[f64]> {
        let has_residuals = self.m > 0 && self.outcomes[k].value().is_some();
        has_residuals.then(|| &self.residuals[k][..])
    }

    /// Like [`residuals`](Self::residuals), but moves the residuals out.
    pub fn take_residuals(&mut self, k: usize) -> Option<Vec<f64>> {
        let has_residuals = self.m > 0 && self.outcomes[k].value().is_some();
        has_residuals.then(|| std::mem::take(&mut self.residuals[k]))
    }

    /// Returns the values of the nonlinear constraints at point `k`; empty if there are none.
    pub fn constraints(&self, k: usize) -> &[f64] {
        &self.constraints[k * self.n_constraints..(k + 1) * self.n_constraints]
    }

    /// Sets the constraint values of the last point. All points get the largest number of values; missing
    /// values are NaN.
    pub fn set_constraints(&mut self, values: &[f64]) {
        let (before, len) = (self.n_constraints, self.outcomes.len());
        if len == 0 {
            return;
        }
        if values.len() > before {
            let mut wider = vec![f64::NAN; len * values.len()];
            for k in 0..len {
                wider[k * values.len()..][..before].copy_from_slice(self.constraints(k));
            }
            (self.constraints, self.n_constraints) = (wider, values.len());
        }
        let row = &mut self.constraints[(len - 1) * self.n_constraints..];
        row.fill(f64::NAN);
        row[..values.len()].copy_from_slice(values);
    }

    /// Adds a copy of point `k` of other answers.
    pub(crate) fn push_from(&mut self, other: &Self, k: usize) {
        self.push(other.outcomes[k].clone(), other.residuals(k).unwrap_or_default());
        if other.n_constraints > 0 {
            self.set_constraints(other.constraints(k));
        }
    }

    /// Adds a point. All residual vectors get the length of the first one: longer vectors are truncated, and
    /// shorter ones are padded with zeros.
    pub fn push(&mut self, outcome: Outcome, residuals: &[f64]) {
        let mut copy = self.spare.pop().unwrap_or_default();
        copy.clear();
        copy.extend_from_slice(residuals);
        self.push_vector(outcome, copy);
    }

    /// Like [`push`](Self::push), without a copy: `residuals` is replaced with spare memory.
    pub(crate) fn push_taken(&mut self, outcome: Outcome, residuals: &mut Vec<f64>) {
        let taken = std::mem::replace(residuals, self.spare.pop().unwrap_or_default());
        self.push_vector(outcome, taken);
    }

    fn push_vector(&mut self, outcome: Outcome, mut residuals: Vec<f64>) {
        if self.m == 0 && !residuals.is_empty() {
            self.m = residuals.len();
            self.residuals.iter_mut().for_each(|before| before.resize(self.m, 0.0));
        }
        residuals.resize(self.m, 0.0);
        self.outcomes.push(outcome);
        self.residuals.push(residuals);
        self.constraints.resize(self.outcomes.len() * self.n_constraints, f64::NAN);
    }

    /// Removes all points and keeps their memory.
    pub fn clear(&mut self) {
        self.outcomes.clear();
        self.spare.append(&mut self.residuals);
        self.m = 0;
        self.constraints.clear();
        self.n_constraints = 0;
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

/// Best point seen so far, with its cost. With equal costs, the first point stays.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Best(Option<(Vec<f64>, f64)>);

impl Best {
    /// Stores a point whatever its cost.
    pub(crate) fn replace(&mut self, x: &[f64], cost: f64) {
        self.0 = Some((x.to_vec(), cost));
    }

    /// Stores a point if its cost is lower. Returns true if it was stored.
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

    /// Stores a point if it violates the constraints less than the stored one, or equally and has a lower
    /// cost. Returns true if it was stored.
    pub(crate) fn offer_ranked(&mut self, x: &[f64], cost: f64, violation: f64, stored: f64) -> bool {
        if self.0.is_none() || violation < stored {
            self.replace(x, cost);
            return true;
        }
        violation <= stored && self.offer(x, cost)
    }

    pub(crate) fn get(&self) -> Option<(&[f64], f64)> {
        self.0.as_ref().map(|(x, f)| (&x[..], *f))
    }

    pub(crate) fn cost(&self) -> Option<f64> {
        self.0.as_ref().map(|(_, f)| *f)
    }

    /// True if the point has length `n` and a finite cost. Data read from a file may be inconsistent.
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
    fn abandoning_below_the_cutoff_is_a_failure() {
        assert_eq!(Outcome::Above(2.0).checked(2.0), Outcome::Above(2.0));
        assert_eq!(Outcome::Above(3.0).checked(2.0), Outcome::Above(3.0));
        for (above, cutoff) in [(1.0, 2.0), (f64::NAN, 2.0), (1.0, f64::INFINITY)] {
            assert!(matches!(Outcome::Above(above).checked(cutoff), Outcome::Failed(_)));
        }
    }

    #[test]
    fn missing_or_nonfinite_residuals_are_failures() {
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
    fn constraint_values_of_a_batch_stay_separate() {
        let mut answers = Answers::default();
        answers.set_constraints(&[1.0]);
        for values in [&[][..], &[1.0], &[2.0, 3.0], &[], &[4.0, 5.0]] {
            answers.push(Outcome::failed("no"), &[]);
            answers.set_constraints(values);
        }
        let rows: Vec<String> = (0..5).map(|k| format!("{:?}", answers.constraints(k))).collect();
        assert_eq!(rows, ["[NaN, NaN]", "[1.0, NaN]", "[2.0, 3.0]", "[NaN, NaN]", "[4.0, 5.0]"]);
    }

    #[test]
    fn residuals_of_a_batch_stay_separate() {
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
