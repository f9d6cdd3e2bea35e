//! The objective: one point goes in, an answer comes out.

use crate::error::Error;
use crate::outcome::answer::{Answer, Outcome, Want};
use crate::problem::loss::{Loss, RobustLoss};
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A flag that nobody raises.
pub(crate) static NEVER: AtomicBool = AtomicBool::new(false);

/// Signals that end an evaluation that is under way. Each flag is raised and lowered by its owner alone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CancelSignals<'a> {
    /// The user's.
    cancel: &'a AtomicBool,
    /// The run's, for one evaluation.
    over: &'a AtomicBool,
    pub(crate) deadline: Option<Instant>,
}

impl<'a> CancelSignals<'a> {
    pub(crate) fn new(cancel: &'a AtomicBool, deadline: Option<Instant>) -> Self {
        Self { cancel, over: &NEVER, deadline }
    }

    /// The same for an evaluation that the run may end by this flag.
    pub(crate) fn with_own_flag<'b>(self, over: &'b AtomicBool) -> CancelSignals<'b>
    where
        'a: 'b,
    {
        CancelSignals { over, ..self }
    }

    /// True if the user's flag is up.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// True if the deadline has come.
    pub(crate) fn is_late(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }
}

/// Request to an objective besides the point.
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// Kind of values that is requested of the point.
    pub want: Want,
    /// The objective may stop as soon as its partial cost is strictly greater than this, and answer
    /// [`Outcome::Above`] with it. `f64::INFINITY`: no cutoff.
    pub cutoff: f64,
    /// Running number of the point, the same for any number of workers; from 2^63 on where a point is
    /// evaluated ahead of need.
    pub id: u64,
    /// Running number of the batch that the point belongs to.
    pub batch: u64,
    signals: CancelSignals<'a>,
}

impl Query<'static> {
    /// A query for the cost without any limit: for calling an objective by hand.
    pub fn new(id: u64, batch: u64, cutoff: f64) -> Self {
        Self { want: Want::Cost, cutoff, id, batch, signals: CancelSignals::new(&NEVER, None) }
    }

    /// The same for something else.
    #[must_use]
    pub fn want(self, want: Want) -> Self {
        Self { want, ..self }
    }
}

impl Query<'_> {
    /// The same query, given up when the flag is set or the deadline is over.
    pub fn cancellable(self, cancel: &AtomicBool, deadline: Option<Instant>) -> Query<'_> {
        self.ended_by(CancelSignals::new(cancel, deadline))
    }

    /// The same query as one of a run.
    pub(crate) fn ended_by(self, signals: CancelSignals<'_>) -> Query<'_> {
        Query { want: self.want, cutoff: self.cutoff, id: self.id, batch: self.batch, signals }
    }

    /// True if the run is being ended (interrupt or time limit): a long evaluation should check this now and
    /// then, give up and answer [`Outcome::cancelled`].
    pub fn cancelled(&self) -> bool {
        self.signals.is_cancelled() || self.signals.over.load(Ordering::Relaxed) || self.signals.is_late()
    }
}

/// Something to minimise. Called from several threads at once when there are workers.
///
/// Every closure `Fn(&[f64]) -> f64 + Sync` is one; see [`fallible`], [`with_query`] and [`residuals`] for
/// richer ones, and [`ByRef`] to lend one.
pub trait Objective: Sync {
    /// The answer at `x` (user's units, user's order) into `answer`, which comes cleared: the outcome, what
    /// was counted, and the residuals where [`Query::want`] asks for them. Then the cutoff is infinite.
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer);

    /// The same as a value of its own, for calling an objective by hand.
    fn answer(&self, x: &[f64], query: &Query<'_>) -> Answer {
        let mut answer = Answer::default();
        self.evaluate(x, query, &mut answer);
        answer
    }

    /// True if the cost is made from residuals that can be requested; the default is false.
    fn has_residuals(&self) -> bool {
        false
    }

    /// Loss that has been applied already to the residuals that it gives; a [`Report`](crate::Report) gives
    /// back the plain ones.
    fn residual_loss(&self) -> RobustLoss {
        RobustLoss::default()
    }

    /// True if evaluations are given up above their cutoff; the default is true. An objective that returns
    /// false is never evaluated anew because the cutoff was another before.
    fn uses_cutoff(&self) -> bool {
        true
    }
}

impl<F: Fn(&[f64]) -> f64 + Sync> Objective for F {
    fn evaluate(&self, x: &[f64], _: &Query<'_>, answer: &mut Answer) {
        answer.outcome = Outcome::Value(self(x));
    }
    fn uses_cutoff(&self) -> bool {
        false
    }
}

/// An objective that is lent.
#[derive(Debug)]
pub struct ByRef<'a, O: ?Sized>(pub &'a O);

impl<O: Objective + ?Sized> Objective for ByRef<'_, O> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        self.0.evaluate(x, query, answer);
    }
    fn has_residuals(&self) -> bool {
        self.0.has_residuals()
    }
    fn residual_loss(&self) -> RobustLoss {
        self.0.residual_loss()
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
    fn evaluate(&self, x: &[f64], _: &Query<'_>, answer: &mut Answer) {
        answer.outcome = match (self.0)(x) {
            Ok(v) => Outcome::Value(v),
            Err(e) => Outcome::failed(e.to_string()),
        };
    }
    fn uses_cutoff(&self) -> bool {
        false
    }
}

/// See [`with_query`].
#[derive(Debug, Clone, Copy)]
pub struct WithQuery<F>(F);

/// An objective from a function that sees the cutoff and the cancel flag and returns an [`Outcome`].
pub fn with_query<F>(f: F) -> WithQuery<F>
where
    F: Fn(&[f64], &Query<'_>) -> Outcome + Sync,
{
    WithQuery(f)
}

impl<F> Objective for WithQuery<F>
where
    F: Fn(&[f64], &Query<'_>) -> Outcome + Sync,
{
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        answer.outcome = (self.0)(x, query);
    }
}

/// A function with a residual vector.
pub trait ResidualFunction: Sync {
    /// Appends the residuals at `x` to `out`, which comes empty; always the same number in the same order.
    ///
    /// # Errors
    /// The outcome to report instead: failed, above the cutoff (of the sum of squares), or abort.
    fn residuals(&self, x: &[f64], query: &Query<'_>, out: &mut Vec<f64>) -> Result<(), Outcome>;
}

impl<F: Fn(&[f64], &mut Vec<f64>) + Sync> ResidualFunction for F {
    fn residuals(&self, x: &[f64], _: &Query<'_>, out: &mut Vec<f64>) -> Result<(), Outcome> {
        self(x, out);
        Ok(())
    }
}

/// See [`residuals`].
#[derive(Debug, Clone, Copy)]
pub struct Residuals<R> {
    function: R,
    loss: RobustLoss,
}

/// An objective whose cost is the sum of the squared residuals, added from the first to the last in this
/// order, so that the cost has the same bits wherever it is computed. Gives up above the cutoff.
pub fn residuals<R: ResidualFunction>(function: R) -> Residuals<R> {
    Residuals { function, loss: RobustLoss::default() }
}

impl<R> Residuals<R> {
    /// A loss that counts large residuals less than their squares; residuals that are small against `scale`
    /// count as before. The cost is the sum of what the residuals count then, for every method.
    ///
    /// ```
    /// use dfo::{Loss, minimize, residuals, LeastSquares};
    ///
    /// // A line through points of which one is far off.
    /// let line = |x: &[f64], out: &mut Vec<f64>| {
    ///     out.extend([0.0, 1.0, 20.0, 3.0, 4.0].iter().enumerate().map(|(k, y)| x[0] + x[1] * k as f64 - y));
    /// };
    /// let robust = residuals(line).loss(Loss::Cauchy, 0.1)?;
    /// let report = minimize(robust).start(&[0.5, 0.5]).method(LeastSquares::default()).run()?;
    /// assert!(report.x[0].abs() < 0.05 && (report.x[1] - 1.0).abs() < 0.05, "{report}");
    /// # Ok::<(), dfo::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`RobustLoss::new`].
    pub fn loss(mut self, loss: Loss, scale: f64) -> Result<Self, Error> {
        self.loss = RobustLoss::new(loss, scale)?;
        Ok(self)
    }
}

impl<R: ResidualFunction> Objective for Residuals<R> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        answer.outcome = match self.function.residuals(x, query, &mut answer.residuals) {
            Ok(()) => self.loss.cost(&mut answer.residuals, query.cutoff),
            Err(outcome) => outcome,
        };
    }
    fn has_residuals(&self) -> bool {
        true
    }
    fn residual_loss(&self) -> RobustLoss {
        self.loss
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_are_summed_in_order_and_respect_the_cutoff() {
        let objective = residuals(|x: &[f64], out: &mut Vec<f64>| out.extend([1e8 * x[0], 1.0, -1.0, 2.0]));
        let at = |x: f64, cutoff: f64| {
            let answer = objective.answer(&[x], &Query::new(0, 0, cutoff));
            (answer.outcome, answer.residuals)
        };
        let sum = ((1e16 + 1.0) + 1.0) + 4.0;
        assert_eq!(at(1.0, f64::INFINITY).0, Outcome::Value(sum));
        assert_eq!(at(0.0, 6.0), (Outcome::Value(6.0), vec![0.0, 1.0, -1.0, 2.0]));
        assert_eq!(at(0.0, 5.9).0, Outcome::Above(5.9));
    }
}
