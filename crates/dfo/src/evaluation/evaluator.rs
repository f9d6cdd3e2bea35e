//! Evaluation of points: the interface for submitting and answering points, and the only place that calls an
//! objective.

use crate::outcome::answer::{Answer, Failure, FailureKind, Outcome};
use crate::problem::objective::{CancelSignals, Objective, Query};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// Evaluates points, which are submitted one by one and answered in any order. Lives as long as the run.
///
/// ```
/// use dfo::{Answer, Evaluator, Outcome, PollResult, Query, Wait, minimize_by};
/// use std::collections::VecDeque;
/// use std::sync::mpsc::{Receiver, Sender, channel};
///
/// /// A thread for each point.
/// struct Spawned(Sender<(u64, f64)>, Receiver<(u64, f64)>, usize);
///
/// impl Evaluator for Spawned {
///     fn submit(&mut self, x: &[f64], query: Query<'static>) {
///         let (x, sender) = (x.to_vec(), self.0.clone());
///         self.2 += 1;
///         std::thread::spawn(move || sender.send((query.id, x.iter().map(|x| x * x).sum())));
///     }
///     fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
///         if self.2 == 0 {
///             return PollResult::Idle;
///         }
///         match self.1.recv_timeout(wait.left()) {
///             Ok((id, cost)) => {
///                 self.2 -= 1;
///                 *answer = Outcome::Value(cost).into();
///                 PollResult::Answered(id)
///             }
///             Err(_) => PollResult::Waiting,
///         }
///     }
///     fn cancel(&mut self, _: u64) {}
///     fn width(&self) -> usize {
///         4
///     }
/// }
///
/// let (sender, receiver) = channel();
/// let report = minimize_by(Spawned(sender, receiver, 0)).start(&[1.0, 2.0]).run()?;
/// assert!(report.fun < 1e-8);
/// # Ok::<(), dfo::Error>(())
/// ```
pub trait Evaluator {
    /// Submits a point. The id of its query identifies it. Points start in the order of submission.
    fn submit(&mut self, x: &[f64], query: Query<'static>);

    /// Writes the next answer into `answer`; waits for one if necessary. Each submitted point is answered
    /// exactly once. A point cancelled before it started is answered with [`Outcome::Skipped`].
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult;

    /// Cancels a point whose answer is no longer needed. It need not start, and a running evaluation may
    /// stop.
    fn cancel(&mut self, id: u64);

    /// Returns the number of points that can be evaluated at once.
    fn width(&self) -> usize;

    /// Returns the number of points of a plan that may be evaluated at once.
    fn capacity(&self, plan: usize) -> usize {
        plan.min(self.width())
    }

    /// True if speculative evaluations are worthwhile according to the previous measurements.
    fn pays_ahead(&self) -> bool {
        self.width() > 1
    }

    /// True if the next answer is already available. It is then processed before more points are submitted.
    fn is_ready(&self) -> bool {
        false
    }

    /// Returns the use of cutoffs: evaluations may stop early above them.
    fn cutoff_use(&self) -> CutoffUse {
        CutoffUse::Unknown
    }

    /// True if a run that ends may abandon running evaluations. Otherwise, it waits for their end.
    fn leave(&mut self) -> bool {
        false
    }

    /// Returns the number of lost evaluations that this evaluator has repeated by itself.
    /// Losses that it reports as answers are not included.
    fn n_lost(&self) -> usize {
        0
    }
}

impl<E: Evaluator + ?Sized> Evaluator for Box<E> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        (**self).submit(x, query);
    }
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        (**self).poll(wait, answer)
    }
    fn cancel(&mut self, id: u64) {
        (**self).cancel(id);
    }
    fn width(&self) -> usize {
        (**self).width()
    }
    fn capacity(&self, plan: usize) -> usize {
        (**self).capacity(plan)
    }
    fn pays_ahead(&self) -> bool {
        (**self).pays_ahead()
    }
    fn is_ready(&self) -> bool {
        (**self).is_ready()
    }
    fn cutoff_use(&self) -> CutoffUse {
        (**self).cutoff_use()
    }
    fn leave(&mut self) -> bool {
        (**self).leave()
    }
    fn n_lost(&self) -> usize {
        (**self).n_lost()
    }
}

/// Use of cutoffs by an objective. If evaluations stop early above cutoffs, every outcome except a cost below
/// the cutoff depends on the cutoff.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CutoffUse {
    /// Evaluations stop early above their cutoff.
    Yes,
    /// The cost does not depend on the cutoff.
    No,
    /// The use is unknown.
    Unknown,
}

/// Time limit of a wait for an answer.
#[derive(Debug, Clone, Copy)]
pub struct Wait<'a> {
    /// Latest time to return.
    pub until: Instant,
    /// Signals that end evaluations made by `poll` itself.
    pub(crate) signals: CancelSignals<'a>,
}

impl Wait<'_> {
    /// Returns the remaining time.
    pub fn left(&self) -> std::time::Duration {
        self.until.saturating_duration_since(Instant::now())
    }
}

/// Result of a poll.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PollResult {
    /// The answer belongs to the query with this id.
    Answered(u64),
    /// No answer is available yet.
    Waiting,
    /// No point is waiting for an answer.
    Idle,
}

/// Calls the objective once, catches panics, checks the outcome and measures the time.
pub(super) fn call(objective: &dyn Objective, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
    answer.clear();
    let start = Instant::now();
    // Unwind safety: the objective is only borrowed. An objective that a panic leaves in a broken state can
    // only fail again.
    let called = catch_unwind(AssertUnwindSafe(|| objective.evaluate(x, query, answer)));
    answer.seconds = start.elapsed().as_secs_f64();
    answer.outcome = match (called, std::mem::replace(&mut answer.outcome, Outcome::Skipped)) {
        // An outcome above the cutoff must not depend on where a point is evaluated: points evaluated ahead
        // may have another cutoff.
        (Ok(()), Outcome::Value(v)) if v > query.cutoff && v.is_finite() && objective.uses_cutoff() => {
            Outcome::Above(query.cutoff)
        }
        (Ok(()), outcome) => outcome.checked(query.cutoff),
        (Err(payload), _) => Outcome::Failed(panicked(payload.as_ref())),
    };
}

/// Returns the use of the cutoff by the objective.
pub(super) fn cutoff_use(objective: &dyn Objective) -> CutoffUse {
    if objective.uses_cutoff() { CutoffUse::Yes } else { CutoffUse::No }
}

pub(super) fn panicked(payload: &(dyn Any + Send)) -> Failure {
    let text = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    Failure { kind: FailureKind::Panic, message: format!("panic: {text}") }
}
