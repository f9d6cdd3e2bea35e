//! Ask/tell by point ids: points are handed out individually or in groups and are answered in any order.

use crate::error::Error;
use crate::evaluation::store::FIRST_ID;
use crate::evaluation::{ByHand, ContextPoller};
use crate::method_interface::interface::Method;
use crate::outcome::answer::{Answer, EvaluationKind, Outcome};
use crate::outcome::termination::Termination;
use crate::outcome::trace::Trace;
use crate::problem::objective::Query;
use crate::run::drive::{Around, Drive};
use crate::run::report::Report;
use crate::run::start::StartedRun;
use base::RunContext;
use std::time::{Duration, Instant};

/// A point to evaluate.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Point {
    /// Id of the point, for the answer.
    pub id: u64,
    /// Index of the batch that the point belongs to.
    pub batch: u64,
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Cost above which the outcome may be [`Outcome::Above`]; infinite if there is no cutoff.
    pub cutoff: f64,
    /// Kind of the requested values.
    pub kind: EvaluationKind,
}

impl Point {
    /// Returns the query to pass to an [`Objective`](crate::Objective) together with the point.
    pub fn query(&self) -> Query<'static> {
        Query::new(self.id, self.batch, self.cutoff).kind(self.kind)
    }
}

/// A run whose evaluations are made by the caller. Its trace is identical to the trace of
/// [`minimize`](crate::minimize), in whatever order the answers come.
///
/// Methods work in rounds. While the last answers of a round are missing, [`ask`](Self::ask) may return no
/// points. Created by [`by_hand`](crate::by_hand), which has an example. With a checkpoint, the state is
/// written as answers come (not too often), at the end, and by [`save`](Self::save).
#[derive(Debug)]
pub struct Optimizer {
    drive: Drive,
    hand: ByHand,
    deadline: Option<Instant>,
}

impl Optimizer {
    /// Starts the run. A time limit counts from this call and is checked when a batch is complete or
    /// requested.
    pub(crate) fn start(started: StartedRun) -> Result<Self, Error> {
        let (workers, before) = (started.workers, started.before);
        let left = started.limits.max_time.map(|t| t.saturating_sub(Duration::from_secs_f64(before)));
        let deadline = RunContext::new().within(left).end();
        let drive = Drive::new(started, true);
        let mut optimizer = Self { drive, hand: ByHand::new(workers), deadline };
        optimizer.go_on(&RunContext::new())?;
        Ok(optimizer)
    }

    /// Advances the run as far as the answers allow. Returns an error if the checkpoint could not be written.
    fn advance(
        &mut self,
        context: &RunContext<'_>,
        go_on: impl FnOnce(&mut Drive, &mut Around<'_, '_, '_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let control = ContextPoller::new(context.until(self.deadline));
        let mut around = Around { evaluator: &mut self.hand, control: &control, observer: None };
        go_on(&mut self.drive, &mut around)?;
        self.drive.unsaved.take().map_or(Ok(()), Err)
    }

    fn go_on(&mut self, context: &RunContext<'_>) -> Result<(), Error> {
        self.advance(context, |drive, around| drive.advance(around).map(|_| ()))
    }

    /// Writes the checkpoint, if there is one, including the answers of the current round.
    ///
    /// # Errors
    /// Returns an error if the file cannot be written.
    pub fn save(&mut self) -> Result<(), Error> {
        self.drive.save_now();
        self.drive.unsaved.take().map_or(Ok(()), Err)
    }

    /// Returns at most `at_most` points to evaluate. Returns none while the round waits for the answers to
    /// all of its points, and none after the end.
    pub fn ask(&mut self, at_most: usize) -> Vec<Point> {
        self.ask_unless(at_most, &RunContext::new())
    }

    /// Like [`ask`](Self::ask), with a context. If an earlier call was cancelled before the method had chosen
    /// its points, this call completes the choice. If this context is cancelled as well, no points are
    /// returned yet.
    pub fn ask_unless(&mut self, at_most: usize, context: &RunContext<'_>) -> Vec<Point> {
        let mut points = Vec::new();
        if self.drive.is_put_off() && self.go_on(context).is_err() {
            return points;
        }
        while self.drive.ended().is_none()
            && points.len() < at_most
            && let Some(handed) = self.hand.hand_out()
        {
            let Query { id, batch, cutoff, kind, .. } = handed.query;
            points.push(Point { id, batch, x: handed.x.clone(), cutoff, kind });
        }
        points
    }

    /// Answers a point with its outcome, and with its residuals if they are requested. [`Outcome::Skipped`]
    /// and cancelled evaluations return the point, which is handed out again if it is still needed.
    /// [`Outcome::Abort`] ends the run. After the end, answers have no effect. If a constraint forbids the
    /// evaluation of the point, only its constraint values count.
    ///
    /// # Errors
    /// Returns an error if the id was not handed out or was already answered. Also returns an error if a
    /// checkpoint cannot be written; the answer still counts.
    pub fn tell(&mut self, id: u64, answer: impl Into<Answer>) -> Result<(), Error> {
        self.tell_unless(id, answer, &RunContext::new())
    }

    /// Like [`tell`](Self::tell), with a context. The answer counts even if the context is cancelled. In that
    /// case, [`ask`](Self::ask) chooses the next points.
    ///
    /// # Errors
    /// Returns the errors of [`tell`](Self::tell).
    pub fn tell_unless(
        &mut self,
        id: u64,
        answer: impl Into<Answer>,
        context: &RunContext<'_>,
    ) -> Result<(), Error> {
        let mut answer = answer.into();
        let Some(handed) = self.hand.take_back(id) else { return Err(Error::UnknownPoint { id }) };
        if self.drive.ended().is_some() {
            return Ok(());
        }
        answer.outcome = match answer.outcome {
            Outcome::Skipped => Outcome::Skipped,
            other => other.checked(handed.query.cutoff),
        };
        let constraints = &self.drive.round.ledger.constraints;
        let are_complete = answer.constraints.len() == constraints.nonlinear.len();
        if are_complete && answer.outcome.is_conclusive() && constraints.forbids(&answer.constraints) {
            answer.outcome = Outcome::infeasible();
        }
        // An abort of a speculative point does not end the run until the path needs the point.
        let is_final = answer.outcome.is_conclusive() || matches!(answer.outcome, Outcome::Abort(_));
        let ends = matches!(answer.outcome, Outcome::Abort(_)) && id < FIRST_ID;
        self.hand.answered(handed, answer, is_final);
        self.advance(context, |drive, around| match drive.advance(around)? {
            // The earlier points will not be answered.
            false if ends => drive.abandon(around),
            _ => Ok(()),
        })
    }

    /// Ends the run. Unless the run was already over, its [`termination`](Self::termination) becomes
    /// [`Termination::Interrupted`]. Answers of the incomplete round are recorded.
    ///
    /// # Errors
    /// Returns an error if the checkpoint cannot be written.
    pub fn stop(&mut self) -> Result<(), Error> {
        self.advance(&RunContext::new(), |drive, around| drive.interrupt(around))
    }

    /// Returns the number of points handed out but not answered yet.
    pub fn n_pending(&self) -> usize {
        self.hand.n_pending()
    }

    /// Returns the best point of all complete rounds, with its cost.
    pub fn best(&self) -> Option<(&[f64], f64)> {
        self.drive.round.ledger.best.get()
    }

    /// Returns the reason why the run ended; `None` while it is running. If all starting points failed, the
    /// reason is [`Termination::AllFailed`], and [`report`](Self::report) returns an error.
    pub fn termination(&self) -> Option<Termination> {
        self.drive.ended().map(|t| t.unwrap_or(Termination::AllFailed))
    }

    /// Returns the method, for inspection.
    pub fn method(&self) -> &dyn Method {
        &self.drive.method
    }

    /// Returns all evaluations of complete rounds.
    pub fn trace(&self) -> &Trace {
        &self.drive.round.ledger.trace
    }

    /// Returns the result so far. Its termination is [`Termination::Interrupted`] while the run is not over.
    ///
    /// # Errors
    /// Returns an error if no point has a finite cost.
    pub fn report(&self) -> Result<Report, Error> {
        self.drive.report_so_far()
    }
}
