//! Evaluation of points: the interface by which they are submitted and answered, and the one place where an
//! objective is called.

use crate::outcome::answer::{Answer, Failure, FailureKind, Outcome};
use crate::problem::objective::{CancelSignals, Objective, Query};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// Who evaluates: points are handed in one by one and come back in any order. It lives as long as the run.
///
/// ```
/// use dfo::{Answer, Evaluator, Outcome, Polled, Query, Wait, minimize_by};
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
///     fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
///         if self.2 == 0 {
///             return Polled::Idle;
///         }
///         match self.1.recv_timeout(wait.left()) {
///             Ok((id, cost)) => {
///                 self.2 -= 1;
///                 *answer = Outcome::Value(cost).into();
///                 Polled::Answered(id)
///             }
///             Err(_) => Polled::Waiting,
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
    /// Takes a point, by the number of its query. What is handed in earlier begins earlier.
    fn submit(&mut self, x: &[f64], query: Query<'static>);

    /// Puts the next answer into `answer`, and waits for one if need be. Each point that was handed in is
    /// answered once: also one that was cancelled, by [`Outcome::Skipped`] where it had not begun.
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled;

    /// The answer to this point is not needed any more: it need not begin, and may give up.
    fn cancel(&mut self, id: u64);

    /// Number of points that can be under way at once.
    fn width(&self) -> usize;

    /// Number of points that a plan of so many may have under way at once.
    fn room(&self, plan: usize) -> usize {
        plan.min(self.width())
    }

    /// True if evaluations ahead of need pay, as far as measured by now.
    fn pays_ahead(&self) -> bool {
        self.width() > 1
    }

    /// True if the next answer is there already: then it is taken before anything else is handed in.
    fn is_ready(&self) -> bool {
        false
    }

    /// Use of the cutoff: whether evaluations are given up above it.
    fn cutoff_use(&self) -> CutoffUse {
        CutoffUse::Unknown
    }

    /// True if a run that ends can leave what is under way to itself; otherwise its end is awaited.
    fn leave(&mut self) -> bool {
        false
    }
}

impl<E: Evaluator + ?Sized> Evaluator for Box<E> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        (**self).submit(x, query);
    }
    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        (**self).poll(wait, answer)
    }
    fn cancel(&mut self, id: u64) {
        (**self).cancel(id);
    }
    fn width(&self) -> usize {
        (**self).width()
    }
    fn room(&self, plan: usize) -> usize {
        (**self).room(plan)
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
}

/// Use of cutoffs: whether evaluations are given up above them. If so, every outcome but a cost below
/// the cutoff depends on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CutoffUse {
    /// They are.
    Yes,
    /// The cost does not depend on the cutoff.
    No,
    /// It is not known.
    Unknown,
}

/// Limit of the time to wait for an answer.
#[derive(Debug, Clone, Copy)]
pub struct Wait<'a> {
    /// Not longer than this.
    pub until: Instant,
    /// Signals that end evaluations that poll itself makes.
    pub(crate) signals: CancelSignals<'a>,
}

impl Wait<'_> {
    /// The time that is left.
    pub fn left(&self) -> std::time::Duration {
        self.until.saturating_duration_since(Instant::now())
    }
}

/// Result of polling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polled {
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

/// Use of the cutoff by the objective.
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
