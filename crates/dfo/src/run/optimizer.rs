//! Ask / tell by ids: points are handed out one by one or many at once, and answered in any order.

use crate::error::Error;
use crate::evaluation::store::FIRST_ID;
use crate::evaluation::{ByHand, ContextPoller};
use crate::method_interface::interface::Method;
use crate::methods::BoxedMethod;
use crate::outcome::answer::{Answer, Outcome, Want};
use crate::outcome::termination::Termination;
use crate::outcome::trace::Trace;
use crate::problem::objective::Query;
use crate::run::drive::{Around, Drive};
use crate::run::report::Report;
use crate::run::start::StartedRun;
use base::RunContext;
use std::time::{Duration, Instant};

/// A point that is to be evaluated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Point {
    /// Its number, to answer by.
    pub id: u64,
    /// The batch that it belongs to.
    pub batch: u64,
    /// The point, in the user's units.
    pub x: Vec<f64>,
    /// Above this cost the outcome may be [`Outcome::Above`]; infinite if there is no cutoff.
    pub cutoff: f64,
    /// Kind of values that is requested.
    pub want: Want,
}

impl Point {
    /// Query to give to an [`Objective`](crate::Objective) with the point.
    pub fn query(&self) -> Query<'static> {
        Query::new(self.id, self.batch, self.cutoff).want(self.want)
    }
}

/// A run whose evaluations the caller makes: the same trace as [`minimize`](crate::minimize) makes, whatever
/// the order of the answers.
///
/// Methods work in rounds, so [`ask`](Self::ask) has nothing to give while the last answers of a round are
/// missing. Made by [`by_hand`](crate::by_hand), which has an example. With a checkpoint the state is written
/// as answers come (not too often), at the end, and by [`save`](Self::save).
#[derive(Debug)]
pub struct Optimizer {
    drive: Drive<BoxedMethod>,
    hand: ByHand,
    deadline: Option<Instant>,
}

impl Optimizer {
    /// A limit of time counts from here and is looked at when a batch is complete or asked for.
    pub(crate) fn start<T: Method + Send + 'static>(started: StartedRun<T>) -> Result<Self, Error> {
        let (workers, before) = (started.workers, started.before);
        let left = started.limits.max_time.map(|t| t.saturating_sub(Duration::from_secs_f64(before)));
        let deadline = RunContext::new().within(left).end();
        let drive = Drive::new(started.map_method(BoxedMethod::new), true);
        let mut optimizer = Self { drive, hand: ByHand::new(workers), deadline };
        optimizer.go_on(&RunContext::new())?;
        Ok(optimizer)
    }

    /// Goes on as far as the answers reach; an error where the checkpoint could not be written.
    fn advance(
        &mut self,
        context: &RunContext<'_>,
        go_on: impl FnOnce(&mut Drive<BoxedMethod>, &mut Around<'_, '_, '_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let control = ContextPoller::new(context.until(self.deadline));
        let mut around = Around { evaluator: &mut self.hand, control: &control, observer: None };
        go_on(&mut self.drive, &mut around)?;
        self.drive.unsaved.take().map_or(Ok(()), Err)
    }

    fn go_on(&mut self, context: &RunContext<'_>) -> Result<(), Error> {
        self.advance(context, |drive, around| drive.advance(around).map(|_| ()))
    }

    /// Writes the checkpoint, if there is one, with the answers of the round that is under way.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&mut self) -> Result<(), Error> {
        self.drive.save_now();
        self.drive.unsaved.take().map_or(Ok(()), Err)
    }

    /// Points to evaluate, at most so many; none while the answers to all points of a round are awaited, and
    /// none after the end.
    pub fn ask(&mut self, at_most: usize) -> Vec<Point> {
        self.ask_unless(at_most, &RunContext::new())
    }

    /// As [`ask`](Self::ask); where a call was cancelled before the method had chosen its points, it goes on
    /// with that, unless this context is cancelled, too: then there are none yet.
    pub fn ask_unless(&mut self, at_most: usize, context: &RunContext<'_>) -> Vec<Point> {
        let mut points = Vec::new();
        if self.drive.is_put_off() && self.go_on(context).is_err() {
            return points;
        }
        while self.drive.ended().is_none()
            && points.len() < at_most
            && let Some(handed) = self.hand.hand_out()
        {
            let Query { id, batch, cutoff, want, .. } = handed.query;
            points.push(Point { id, batch, x: handed.x.clone(), cutoff, want });
        }
        points
    }

    /// The answer to a point: its outcome, and the residuals where they are wanted. [`Outcome::Skipped`] and
    /// cancelled evaluations give the point back: it is handed out again where it is still needed.
    /// [`Outcome::Abort`] ends the run. After the end an answer changes nothing.
    ///
    /// # Errors
    /// An id that was not handed out, or was answered already; a checkpoint that cannot be written (the
    /// answer counts all the same).
    pub fn tell(&mut self, id: u64, answer: impl Into<Answer>) -> Result<(), Error> {
        self.tell_unless(id, answer, &RunContext::new())
    }

    /// As [`tell`](Self::tell); the answer counts, whatever the context says: where it is cancelled, the next
    /// points are chosen by [`ask`](Self::ask).
    ///
    /// # Errors
    /// As [`tell`](Self::tell).
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
        // What was evaluated ahead of need ends nothing before it is needed.
        let is_final = answer.outcome.is_known() || matches!(answer.outcome, Outcome::Abort(_));
        let ends = matches!(answer.outcome, Outcome::Abort(_)) && id < FIRST_ID;
        self.hand.answered(handed, answer, is_final);
        self.advance(context, |drive, around| match drive.advance(around)? {
            // The points before it will have no answer.
            false if ends => drive.abandon(around),
            _ => Ok(()),
        })
    }

    /// Ends the run: [`termination`](Self::termination) is [`Termination::Interrupted`] then, if it was not
    /// over already. What was told of an incomplete round is entered.
    ///
    /// # Errors
    /// The checkpoint cannot be written.
    pub fn stop(&mut self) -> Result<(), Error> {
        self.advance(&RunContext::new(), |drive, around| drive.interrupt(around))
    }

    /// Points handed out and not answered yet.
    pub fn n_pending(&self) -> usize {
        self.hand.n_pending()
    }

    /// The best point so far and its cost, of complete rounds.
    pub fn best(&self) -> Option<(&[f64], f64)> {
        self.drive.round.ledger.best.get()
    }

    /// Why the run is over; `None` while it is not. A run whose starting points all failed counts as
    /// [`Termination::AllFailed`] here; its [`report`](Self::report) is an error.
    pub fn termination(&self) -> Option<Termination> {
        self.drive.ended().map(|t| t.unwrap_or(Termination::AllFailed))
    }

    /// The method, to look into.
    pub fn method(&self) -> &dyn Method {
        &self.drive.method
    }

    /// All evaluations of complete rounds.
    pub fn trace(&self) -> &Trace {
        &self.drive.round.ledger.trace
    }

    /// The result so far; [`Termination::Interrupted`] while the run is not over.
    ///
    /// # Errors
    /// There is no point with a finite cost.
    pub fn report(&self) -> Result<Report, Error> {
        self.drive.report_so_far()
    }
}
