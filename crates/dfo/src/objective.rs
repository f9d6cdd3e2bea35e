//! The objective: one point goes in, a cost, "above the cutoff", or "failed: why" comes out.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// What became of one evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Outcome {
    /// The cost. NaN and infinities become [`Failed`](Self::Failed) in the gateway.
    Value(f64),
    /// The evaluation was given up because the cost is strictly greater than this cutoff. Never a cost, never best.
    Above(f64),
    /// There is no cost at this point. Ranks behind every finite cost.
    Failed(Failure),
    /// The whole run must end (an exception that is to reach the user, for example).
    Abort(String),
    /// The run ended before this point was evaluated. Nothing is concluded from it; objectives do not return it.
    Skipped,
}

impl Outcome {
    /// A failure with [`FailureKind::Error`] and this message.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::Failed(Failure { kind: FailureKind::Error, message: message.into() })
    }

    /// A failure with [`FailureKind::Cancelled`]: the evaluation saw [`Evaluation::cancelled`] and gave up.
    pub fn cancelled() -> Self {
        Self::Failed(Failure { kind: FailureKind::Cancelled, message: "cancelled".to_owned() })
    }

    /// The cost, if there is a finite one.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value(v) if v.is_finite() => Some(*v),
            _ => None,
        }
    }

    /// Whether this says anything about the point: false for [`Skipped`](Self::Skipped), [`Abort`](Self::Abort) and
    /// cancelled evaluations, from which no decision may follow.
    pub fn is_known(&self) -> bool {
        match self {
            Self::Value(_) | Self::Above(_) => true,
            Self::Failed(failure) => failure.kind != FailureKind::Cancelled,
            Self::Abort(_) | Self::Skipped => false,
        }
    }

    /// The one form that everything behind the gateway relies on: finite values, honest cutoffs.
    pub(crate) fn checked(self, cutoff: f64) -> Self {
        match self {
            Self::Value(v) if !v.is_finite() => {
                Self::Failed(Failure { kind: FailureKind::NotFinite, message: format!("cost is {v}") })
            }
            Self::Above(c) if c.is_nan() || c < cutoff => Self::Failed(Failure {
                kind: FailureKind::Error,
                message: format!("given up above {c}, although the cutoff was {cutoff}"),
            }),
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
    /// The reason, for people. Equal texts are counted together in a report, so leave out what changes every time.
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
}

static NEVER: AtomicBool = AtomicBool::new(false);

/// What may end an evaluation that is under way. Each flag is raised and lowered by its owner alone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ends<'a> {
    /// The user's.
    cancel: &'a AtomicBool,
    /// The run's, for the evaluations of one batch.
    over: &'a AtomicBool,
    pub(crate) deadline: Option<Instant>,
}

impl<'a> Ends<'a> {
    pub(crate) fn new(cancel: &'a AtomicBool, deadline: Option<Instant>) -> Self {
        Self { cancel, over: &NEVER, deadline }
    }

    /// The same for a batch of which the run may end all evaluations by this flag.
    pub(crate) fn with_flag_of_batch<'b>(self, over: &'b AtomicBool) -> Ends<'b>
    where
        'a: 'b,
    {
        Ends { over, ..self }
    }

    /// Whether the user's flag is up.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Whether the deadline has come.
    pub(crate) fn is_late(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }
}

/// What an objective is told besides the point.
#[derive(Debug, Clone, Copy)]
pub struct Evaluation<'a> {
    /// The objective may stop as soon as its partial cost is strictly greater than this, and return
    /// [`Outcome::Above`] with it. `f64::INFINITY`: no cutoff.
    pub cutoff: f64,
    /// Running number of the point, the same for any number of workers; from 2^63 on where a point is evaluated ahead of
    /// need.
    pub id: u64,
    /// Running number of the batch that the point belongs to.
    pub batch: u64,
    ends: Ends<'a>,
}

impl Evaluation<'static> {
    /// An evaluation that nobody cancels: for calling an objective by hand.
    pub fn new(id: u64, batch: u64, cutoff: f64) -> Self {
        Self { cutoff, id, batch, ends: Ends::new(&NEVER, None) }
    }
}

impl Evaluation<'_> {
    /// The same evaluation, given up when the flag is set or the deadline is over.
    pub fn cancellable(self, cancel: &AtomicBool, deadline: Option<Instant>) -> Evaluation<'_> {
        self.ended_by(Ends::new(cancel, deadline))
    }

    /// The same evaluation as one of a run.
    pub(crate) fn ended_by(self, ends: Ends<'_>) -> Evaluation<'_> {
        Evaluation { cutoff: self.cutoff, id: self.id, batch: self.batch, ends }
    }

    /// Whether the run is being ended (interrupt or time limit): a long evaluation should look now and then, give
    /// up and return [`Outcome::cancelled`].
    pub fn cancelled(&self) -> bool {
        self.ends.is_cancelled() || self.ends.over.load(Ordering::Relaxed) || self.ends.is_late()
    }
}

/// Something to minimise. Called from several threads at once when there are workers.
///
/// Every closure `Fn(&[f64]) -> f64 + Sync` is one; see [`fallible`], [`with_evaluation`] and [`residuals`] for
/// richer ones, and [`ByRef`] to lend one.
pub trait Objective: Sync {
    /// The cost at `x` (user's units, user's order).
    fn evaluate(&self, x: &[f64], evaluation: &Evaluation<'_>) -> Outcome;

    /// The residual vector at `x` into `out`, and the cost that belongs to it; `None` (the default) if this
    /// objective knows only its cost. `evaluation.cutoff` is infinite whenever the whole vector is needed.
    fn residuals(&self, x: &[f64], evaluation: &Evaluation<'_>, out: &mut Vec<f64>) -> Option<Outcome> {
        let _ = (x, evaluation, out);
        None
    }

    /// Whether evaluations are given up above their cutoff; the default is yes. One that says no is never evaluated anew
    /// because the cutoff was another before.
    fn uses_cutoff(&self) -> bool {
        true
    }
}

impl<F: Fn(&[f64]) -> f64 + Sync> Objective for F {
    fn evaluate(&self, x: &[f64], _: &Evaluation<'_>) -> Outcome {
        Outcome::Value(self(x))
    }
    fn uses_cutoff(&self) -> bool {
        false
    }
}

/// An objective that is lent.
#[derive(Debug)]
pub struct ByRef<'a, O: ?Sized>(pub &'a O);

impl<O: Objective + ?Sized> Objective for ByRef<'_, O> {
    fn evaluate(&self, x: &[f64], evaluation: &Evaluation<'_>) -> Outcome {
        self.0.evaluate(x, evaluation)
    }
    fn residuals(&self, x: &[f64], evaluation: &Evaluation<'_>, out: &mut Vec<f64>) -> Option<Outcome> {
        self.0.residuals(x, evaluation, out)
    }
    fn uses_cutoff(&self) -> bool {
        self.0.uses_cutoff()
    }
}

/// See [`fallible`].
#[derive(Debug, Clone, Copy)]
pub struct Fallible<F>(F);

/// An objective from a function that may fail: `Err(e)` becomes a failed evaluation with the text of `e`.
pub fn fallible<F, E>(f: F) -> Fallible<F>
where
    F: Fn(&[f64]) -> Result<f64, E> + Sync,
    E: fmt::Display,
{
    Fallible(f)
}

impl<F, E> Objective for Fallible<F>
where
    F: Fn(&[f64]) -> Result<f64, E> + Sync,
    E: fmt::Display,
{
    fn evaluate(&self, x: &[f64], _: &Evaluation<'_>) -> Outcome {
        match (self.0)(x) {
            Ok(v) => Outcome::Value(v),
            Err(e) => Outcome::failed(e.to_string()),
        }
    }
    fn uses_cutoff(&self) -> bool {
        false
    }
}

/// See [`with_evaluation`].
#[derive(Debug, Clone, Copy)]
pub struct WithEvaluation<F>(F);

/// An objective from a function that sees the cutoff and the cancel flag and returns an [`Outcome`].
pub fn with_evaluation<F>(f: F) -> WithEvaluation<F>
where
    F: Fn(&[f64], &Evaluation<'_>) -> Outcome + Sync,
{
    WithEvaluation(f)
}

impl<F> Objective for WithEvaluation<F>
where
    F: Fn(&[f64], &Evaluation<'_>) -> Outcome + Sync,
{
    fn evaluate(&self, x: &[f64], evaluation: &Evaluation<'_>) -> Outcome {
        (self.0)(x, evaluation)
    }
}

/// A function with a residual vector.
pub trait ResidualFunction: Sync {
    /// Appends the residuals at `x` to `out`, which comes empty; always the same number in the same order.
    ///
    /// # Errors
    /// The outcome to report instead: failed, above the cutoff (of the sum of squares), or abort.
    fn residuals(&self, x: &[f64], evaluation: &Evaluation<'_>, out: &mut Vec<f64>) -> Result<(), Outcome>;
}

impl<F: Fn(&[f64], &mut Vec<f64>) + Sync> ResidualFunction for F {
    fn residuals(&self, x: &[f64], _: &Evaluation<'_>, out: &mut Vec<f64>) -> Result<(), Outcome> {
        self(x, out);
        Ok(())
    }
}

/// See [`residuals`].
#[derive(Debug)]
pub struct Residuals<R> {
    function: R,
    buffers: Mutex<Vec<Vec<f64>>>,
}

/// An objective whose cost is the sum of the squared residuals, added from the first to the last in this order,
/// so that the cost has the same bits wherever it is computed. Gives up above the cutoff.
pub fn residuals<R: ResidualFunction>(function: R) -> Residuals<R> {
    Residuals { function, buffers: Mutex::new(Vec::new()) }
}

impl<R> Residuals<R> {
    fn sum(out: &[f64], cutoff: f64) -> Outcome {
        let mut sum = 0.0;
        for r in out {
            sum += r * r;
            if sum > cutoff {
                return Outcome::Above(cutoff);
            }
        }
        Outcome::Value(sum)
    }
}

impl<R: ResidualFunction> Objective for Residuals<R> {
    fn evaluate(&self, x: &[f64], evaluation: &Evaluation<'_>) -> Outcome {
        // A poisoned lock only means that a function panicked between lending and returning: the list is whole.
        let lent = self.buffers.lock().unwrap_or_else(|e| e.into_inner()).pop();
        let mut out = lent.unwrap_or_default();
        out.clear();
        let outcome = match self.function.residuals(x, evaluation, &mut out) {
            Ok(()) => Self::sum(&out, evaluation.cutoff),
            Err(outcome) => outcome,
        };
        self.buffers.lock().unwrap_or_else(|e| e.into_inner()).push(out);
        outcome
    }

    fn residuals(&self, x: &[f64], evaluation: &Evaluation<'_>, out: &mut Vec<f64>) -> Option<Outcome> {
        out.clear();
        Some(match self.function.residuals(x, evaluation, out) {
            Ok(()) => Self::sum(out, evaluation.cutoff),
            Err(outcome) => outcome,
        })
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
    fn residuals_are_summed_in_order_and_respect_the_cutoff() {
        let objective = residuals(|x: &[f64], out: &mut Vec<f64>| out.extend([1e8 * x[0], 1.0, -1.0, 2.0]));
        let sum = ((1e16 + 1.0) + 1.0) + 4.0;
        assert_eq!(objective.evaluate(&[1.0], &Evaluation::new(0, 0, f64::INFINITY)), Outcome::Value(sum));
        assert_eq!(objective.evaluate(&[0.0], &Evaluation::new(0, 0, 6.0)), Outcome::Value(6.0));
        assert_eq!(objective.evaluate(&[0.0], &Evaluation::new(0, 0, 5.9)), Outcome::Above(5.9));
        let mut out = Vec::new();
        let cost = Objective::residuals(&objective, &[0.0], &Evaluation::new(0, 0, f64::INFINITY), &mut out);
        assert_eq!((cost, out), (Some(Outcome::Value(6.0)), vec![0.0, 1.0, -1.0, 2.0]));
    }
}
