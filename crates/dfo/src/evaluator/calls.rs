//! How points are handed to an evaluator and taken back, and the one place where an objective is called.

use crate::answer::{Answer, Failure, FailureKind, Outcome};
use crate::objective::{CancelSignals, Objective, Query};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// Where points go to be evaluated, and where their answers come from, in any order.
pub(crate) trait Evaluator {
    /// Takes a point. Points begin in the order in which they come.
    fn submit(&mut self, x: &[f64], query: Query<'static>);

    /// Puts the next answer into `answer`, and waits for one if need be.
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled;

    /// Begins nothing more of what was submitted: what had not begun is not answered, or answered by
    /// [`Outcome::Skipped`].
    fn withdraw(&mut self);

    /// The same; and what is running is told to give up.
    fn cancel(&mut self) {
        self.withdraw();
    }
}

/// Whether evaluations are given up above their cutoff; what is known elsewhere than below it depends on the cutoff then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum GivesUp {
    Yes,
    No,
    Unknown,
}

/// How long to wait for an answer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wait<'a> {
    /// Not longer than this.
    pub(crate) until: Instant,
    /// What ends evaluations that poll itself makes.
    pub(crate) signals: CancelSignals<'a>,
}

/// What polling gave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Polled {
    /// The answer to the query with this number.
    Answered(u64),
    /// Nothing yet.
    Waiting,
    /// There is nothing to wait for.
    Idle,
}

/// One call of the objective: panics caught, the outcome made regular, the time taken.
pub(super) fn call(objective: &dyn Objective, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
    answer.clear();
    let start = Instant::now();
    // Unwind safety: the objective is only lent, and one that breaks itself by panicking can only fail again.
    let called = catch_unwind(AssertUnwindSafe(|| objective.evaluate(x, query, answer)));
    answer.seconds = start.elapsed().as_secs_f64();
    answer.outcome = match (called, std::mem::replace(&mut answer.outcome, Outcome::Skipped)) {
        // What is known above the cutoff depends on the cutoff, which may be another where points are evaluated ahead.
        (Ok(()), Outcome::Value(v)) if v > query.cutoff && v.is_finite() && objective.uses_cutoff() => {
            Outcome::Above(query.cutoff)
        }
        (Ok(()), outcome) => outcome.checked(query.cutoff),
        (Err(payload), _) => Outcome::Failed(panicked(payload.as_ref())),
    };
}

pub(super) fn panicked(payload: &(dyn Any + Send)) -> Failure {
    let text = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    Failure { kind: FailureKind::Panic, message: format!("panic: {text}") }
}
