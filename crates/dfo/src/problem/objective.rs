//! Objectives, which map a point to an answer.

use crate::error::Error;
use crate::outcome::answer::{Answer, EvaluationKind, Outcome};
use crate::problem::constraints::Constraints;
use crate::problem::loss::{Loss, RobustLoss};
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A flag that is never set.
pub(crate) static NEVER: AtomicBool = AtomicBool::new(false);

/// Signals that end a running evaluation. Only the owner of a flag sets and clears it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CancelSignals<'a> {
    /// Cancel flag set by the user.
    cancel: &'a AtomicBool,
    /// Flag of the run for one evaluation.
    over: &'a AtomicBool,
    pub(crate) deadline: Option<Instant>,
}

impl<'a> CancelSignals<'a> {
    pub(crate) fn new(cancel: &'a AtomicBool, deadline: Option<Instant>) -> Self {
        Self { cancel, over: &NEVER, deadline }
    }

    /// Adds a flag with which the run may end one evaluation.
    pub(crate) fn with_evaluation_flag<'b>(self, over: &'b AtomicBool) -> CancelSignals<'b>
    where
        'a: 'b,
    {
        CancelSignals { over, ..self }
    }

    /// True if the user's flag is set.
    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// True if the deadline has passed.
    pub(crate) fn is_late(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }
}

/// Request to an objective in addition to the point.
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// Kind of values requested at the point.
    pub kind: EvaluationKind,
    /// Cutoff of the cost; `f64::INFINITY` means no cutoff. If the partial cost is strictly greater, the
    /// objective may stop and return [`Outcome::Above`] with this value.
    pub cutoff: f64,
    /// Id of the point, counted over the run; the same for any number of workers. At least 2^63 if the point
    /// is evaluated speculatively.
    pub id: u64,
    /// Index of the batch that the point belongs to.
    pub batch: u64,
    signals: CancelSignals<'a>,
}

impl Query<'static> {
    /// Creates a query for the cost without time limit or cancel flag, for calling an objective by hand.
    pub fn new(id: u64, batch: u64, cutoff: f64) -> Self {
        Self { kind: EvaluationKind::Cost, cutoff, id, batch, signals: CancelSignals::new(&NEVER, None) }
    }

    /// Sets the kind of values requested.
    #[must_use]
    pub fn kind(self, kind: EvaluationKind) -> Self {
        Self { kind, ..self }
    }
}

impl Query<'_> {
    /// Adds a cancel flag and a deadline to the query.
    pub fn cancellable(self, cancel: &AtomicBool, deadline: Option<Instant>) -> Query<'_> {
        self.ended_by(CancelSignals::new(cancel, deadline))
    }

    /// Adds the signals of a run to the query.
    pub(crate) fn ended_by(self, signals: CancelSignals<'_>) -> Query<'_> {
        Query { kind: self.kind, cutoff: self.cutoff, id: self.id, batch: self.batch, signals }
    }

    /// True if the run is ending because of an interrupt or time limit. A long evaluation should check this
    /// from time to time, and then stop and return [`Outcome::cancelled`].
    pub fn cancelled(&self) -> bool {
        self.signals.is_cancelled() || self.signals.over.load(Ordering::Relaxed) || self.signals.is_late()
    }
}

/// A function to minimise. With workers, several threads call it at once.
///
/// Every closure `Fn(&[f64]) -> f64 + Sync` is an objective. See [`fallible`], [`with_query`] and
/// [`residuals`] for objectives with more features, and [`ByRef`] for a borrowed objective.
pub trait Objective: Sync {
    /// Evaluates the point `x` (user's units and order) and writes the result to `answer`, which is cleared
    /// beforehand. The result contains the outcome, the counted work, and the residuals if [`Query::kind`]
    /// requests them. With residuals, the cutoff is infinite.
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer);

    /// Evaluates the point and returns the answer, for calling an objective by hand.
    fn answer(&self, x: &[f64], query: &Query<'_>) -> Answer {
        let mut answer = Answer::default();
        self.evaluate(x, query, &mut answer);
        answer
    }

    /// True if the cost is computed from residuals that can be requested. Default false. The cost is their
    /// sum of squares or an increasing function of it, because least squares minimises the sum of squares.
    fn has_residuals(&self) -> bool {
        false
    }

    /// Returns the loss that has already been applied to the returned residuals. A [`Report`](crate::Report)
    /// contains the plain residuals.
    fn residual_loss(&self) -> RobustLoss {
        RobustLoss::default()
    }

    /// True if evaluations stop early above their cutoff. Default true. If false, no point is evaluated again
    /// because of a different cutoff.
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

/// A borrowed objective.
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

/// Objective created by [`fallible`].
#[derive(Debug, Clone, Copy)]
pub struct Fallible<F>(F);

/// Creates an objective from a function that may fail. `Err(e)` becomes a failed evaluation with the text of
/// `e`.
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

/// Objective created by [`constrained`].
#[derive(Debug, Clone)]
pub struct Constrained<O, C> {
    objective: O,
    function: C,
    constraints: Constraints,
}

/// Adds the function of the nonlinear constraints to an objective. The function appends one value per
/// constraint to the empty vector. It is called before the objective, which is not evaluated where a
/// constraint with `keep_feasible` is violated. Pass the same `constraints` to the run.
///
/// ```
/// use dfo::{Constraints, DifferentialEvolution, NonlinearConstraint, constrained, minimize};
///
/// // The nearest point to the origin on or outside the unit circle around (2, 0).
/// let inside = NonlinearConstraint { lower: f64::NEG_INFINITY, upper: 1.0, keep_feasible: false };
/// let constraints = Constraints { nonlinear: vec![inside], ..Constraints::default() };
/// let circle = |x: &[f64], c: &mut Vec<f64>| c.push((x[0] - 2.0).powi(2) + x[1] * x[1]);
/// let cost = |x: &[f64]| x[0] * x[0] + x[1] * x[1];
/// let report = minimize(constrained(cost, circle, constraints.clone()))
///     .bounds(&[-3.0; 2], &[3.0; 2])?
///     .constraints(constraints)
///     .method(DifferentialEvolution::default())
///     .seed(1)
///     .run()?;
/// assert!((report.x[0] - 1.0).abs() < 1e-3 && report.constr_violation <= 1e-6, "{report}");
/// # Ok::<(), dfo::Error>(())
/// ```
pub fn constrained<O: Objective, C: Fn(&[f64], &mut Vec<f64>) + Sync>(
    objective: O,
    function: C,
    constraints: Constraints,
) -> Constrained<O, C> {
    Constrained { objective, function, constraints }
}

impl<O: Objective, C: Fn(&[f64], &mut Vec<f64>) + Sync> Objective for Constrained<O, C> {
    fn evaluate(&self, x: &[f64], query: &Query<'_>, answer: &mut Answer) {
        (self.function)(x, &mut answer.constraints);
        if self.constraints.forbids(&answer.constraints) {
            answer.outcome = Outcome::infeasible();
        } else {
            self.objective.evaluate(x, query, answer);
        }
    }
    fn has_residuals(&self) -> bool {
        self.objective.has_residuals()
    }
    fn residual_loss(&self) -> RobustLoss {
        self.objective.residual_loss()
    }
    fn uses_cutoff(&self) -> bool {
        self.objective.uses_cutoff()
    }
}

/// Objective created by [`with_query`].
#[derive(Debug, Clone, Copy)]
pub struct WithQuery<F>(F);

/// Creates an objective from a function that receives the query with its cutoff and cancel flag, and returns
/// an [`Outcome`].
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

/// A function that returns a residual vector.
pub trait ResidualFunction: Sync {
    /// Appends the residuals at `x` to the empty vector `out`. Their number and order must not change.
    ///
    /// # Errors
    /// Returns the outcome to report instead: a failure, above the cutoff (of the sum of squares), or an
    /// abort.
    fn residuals(&self, x: &[f64], query: &Query<'_>, out: &mut Vec<f64>) -> Result<(), Outcome>;
}

impl<F: Fn(&[f64], &mut Vec<f64>) + Sync> ResidualFunction for F {
    fn residuals(&self, x: &[f64], _: &Query<'_>, out: &mut Vec<f64>) -> Result<(), Outcome> {
        self(x, out);
        Ok(())
    }
}

/// Objective created by [`residuals`].
#[derive(Debug, Clone, Copy)]
pub struct Residuals<R> {
    function: R,
    loss: RobustLoss,
}

/// Creates an objective whose cost is the sum of squared residuals. They are added in order from the first to
/// the last, so the cost is bit-for-bit identical wherever it is computed. The evaluation stops above the
/// cutoff.
pub fn residuals<R: ResidualFunction>(function: R) -> Residuals<R> {
    Residuals { function, loss: RobustLoss::default() }
}

impl<R> Residuals<R> {
    /// Sets a loss that reduces the weight of large residuals. Residuals that are small relative to `scale`
    /// count as before. The cost is then the sum of the reduced contributions, for every method.
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
    /// Returns the errors of [`RobustLoss::new`].
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
