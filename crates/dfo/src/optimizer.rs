//! Ask / tell by ids: points are handed out one by one or many at once, and answered in any order.

use crate::answer::{Answer, Outcome, Want};
use crate::checkpoint::Writer;
use crate::description::StartedRun;
use crate::drive::{end, limited, reached};
use crate::error::Error;
use crate::gateway::batch_ledger::BatchLedger;
use crate::gateway::batch_ledger::reset;
use crate::method::{Batch, Lookahead, Method};
use crate::methods::BoxedMethod;
use crate::objective::Query;
use crate::report::{self, Report, Resumed};
use crate::termination::Termination;
use crate::tolerances::Limits;
use crate::trace::Trace;
use std::collections::BTreeSet;
use std::time::Instant;

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
    /// What is to be known of it.
    pub want: Want,
}

impl Point {
    /// What to tell an [`Objective`](crate::Objective) with the point.
    pub fn query(&self) -> Query<'static> {
        Query::new(self.id, self.batch, self.cutoff).want(self.want)
    }
}

/// A run whose evaluations the caller makes: the same trace as [`minimize`](crate::minimize) makes, whatever the order of the
/// answers.
///
/// Methods work in rounds, so [`ask`](Self::ask) has nothing to give while the last answers of a round are missing.
/// Made by [`by_hand`](crate::by_hand), which has an example. With a checkpoint the state is written when a round is
/// complete (not too often), at the end, and by [`save`](Self::save).
#[derive(Debug)]
pub struct Optimizer {
    method: BoxedMethod,
    batch_ledger: BatchLedger,
    limits: Limits,
    batch: Batch,
    /// The points not handed out yet, by their places.
    due: BTreeSet<usize>,
    /// Points that wait for an answer, handed out or not.
    n_open: usize,
    answers: Vec<Answer>,
    /// When each point was handed out; `None` where it was not, or was answered.
    handed: Vec<Option<Instant>>,
    start: Instant,
    workers: usize,
    writer: Option<Writer>,
    /// Seconds of the run before it was resumed.
    before: f64,
    /// Whether the checkpoint holds the end of the run.
    written: bool,
    /// Why the method was chosen, where the user left it open.
    method_reason: Option<String>,
    /// What it was continued from.
    resumed: Option<Resumed>,
    /// `Some(None)`: the method had nothing to start from.
    ended: Option<Option<Termination>>,
}

impl Optimizer {
    /// A limit of time counts from here and is looked at when a batch is complete or asked for.
    pub(crate) fn start<T: Method + Send + 'static>(started: StartedRun<T>) -> Result<Self, Error> {
        let StartedRun {
            method,
            batch_ledger,
            limits,
            workers,
            writer,
            observed,
            before,
            method_reason,
            resumed,
            ..
        } = started;
        let method = BoxedMethod::new(method);
        // A run that was resumed may be over already.
        let ended = observed.and_then(|_| reached(&method, &batch_ledger, &limits)).map(Some);
        let mut optimizer = Self {
            method,
            batch_ledger,
            limits,
            batch: Batch::new(),
            due: BTreeSet::new(),
            n_open: 0,
            answers: Vec::new(),
            handed: Vec::new(),
            start: Instant::now(),
            workers,
            writer,
            before,
            written: false,
            method_reason,
            resumed,
            ended,
        };
        optimizer.advance()?;
        Ok(optimizer)
    }

    fn elapsed(&self) -> f64 {
        self.before + self.start.elapsed().as_secs_f64()
    }

    /// Writes the checkpoint, if there is one, with the answers of the round that is under way.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&mut self) -> Result<(), Error> {
        let replay = match self.ended {
            None => self.batch_ledger.known(&self.batch, &self.answers),
            Some(_) => self.batch_ledger.replay.clone(),
        };
        let seconds = self.elapsed();
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let details = self.method.details();
        let observed = details.operation.map(|_| details.n_iterations);
        writer.write(
            &self.method,
            &self.batch_ledger,
            &replay,
            (observed, self.batch_ledger.ledger.trace.end()),
            seconds,
        )
    }

    /// Points to evaluate, at most so many; none while the answers to all points of a round are awaited, and none after
    /// the end.
    pub fn ask(&mut self, at_most: usize) -> Vec<Point> {
        let mut points = Vec::new();
        if self.ended.is_some() {
            return points;
        }
        let work = &self.batch_ledger.work;
        while points.len() < at_most
            && let Some(k) = self.due.pop_first()
        {
            self.handed[k] = Some(Instant::now());
            let (id, x) = (work.id(k), work.point(k).to_vec());
            let Query { cutoff, want, .. } = work.query(k);
            points.push(Point { id, batch: work.index(), x, cutoff, want });
        }
        points
    }

    /// The answer to a point: its outcome, and the residuals where they are wanted. [`Outcome::Skipped`] and cancelled evaluations give the point back: it is handed out
    /// again. [`Outcome::Abort`] ends the run.
    ///
    /// # Errors
    /// An id that was not handed out, or was answered already; a checkpoint that cannot be written (the answer counts
    /// all the same).
    pub fn tell(&mut self, id: u64, answer: impl Into<Answer>) -> Result<(), Error> {
        let mut answer = answer.into();
        let work = &self.batch_ledger.work;
        let place = work.place_of(id).filter(|_| self.ended.is_none());
        let Some((k, handed)) = place.and_then(|k| self.handed[k].take().map(|handed| (k, handed))) else {
            return Err(Error::UnknownPoint { id });
        };
        answer.outcome = match answer.outcome {
            Outcome::Skipped => Outcome::Skipped,
            other => other.checked(work.query(k).cutoff),
        };
        let abort = match &answer.outcome {
            // What was evaluated ahead of need ends nothing before it is needed.
            Outcome::Abort(message) if k < self.batch_ledger.n_needed() => {
                Some(Termination::Aborted(message.clone()))
            }
            Outcome::Abort(_) => None,
            other if !other.is_known() => {
                self.due.insert(k);
                self.n_open += 1;
                answer.clear();
                None
            }
            _ => None,
        };
        self.n_open -= 1;
        answer.seconds = handed.elapsed().as_secs_f64();
        self.answers[k] = answer;
        if let Some((place, _)) = self.batch_ledger.last(&self.answers) {
            // Nothing after it is needed; what was handed out already is waited for.
            let from = self.batch_ledger.n_before(place + 1);
            self.n_open -= self.due.split_off(&from).len();
        }
        if abort.is_some() || self.n_open == 0 {
            let completed =
                self.complete(self.batch_ledger.stopped(self.batch_ledger.last(&self.answers)).or(abort));
            return completed.and(self.advance());
        }
        Ok(())
    }

    /// Enters the batch as far as it is known and tells the method.
    fn complete(&mut self, stopped: Option<Termination>) -> Result<(), Error> {
        // The state before this batch, and what is known of the batch. A file that cannot be written costs no answer.
        let saved = if stopped.is_some() { self.save() } else { Ok(()) };
        self.batch_ledger.close(&self.batch, &mut self.answers);
        self.method.tell(self.batch_ledger.told())?;
        self.batch_ledger.ledger.trim(false);
        self.ended = end(&self.method, &self.batch_ledger, &self.limits, stopped.as_ref(), false);
        self.written = stopped.is_some();
        saved
    }

    /// Writes the checkpoint where a round has ended, if it is time to.
    fn save_now_and_then(&mut self) -> Result<(), Error> {
        let due = self.ended.is_some() || self.writer.as_ref().is_some_and(Writer::is_due);
        if due && !std::mem::replace(&mut self.written, self.ended.is_some()) { self.save() } else { Ok(()) }
    }

    /// Goes on to the next batch with something to evaluate.
    fn advance(&mut self) -> Result<(), Error> {
        while self.ended.is_none() {
            self.method.ask(&mut self.batch);
            if self.batch.is_empty() {
                self.ended = end(&self.method, &self.batch_ledger, &self.limits, None, false);
                continue;
            }
            let spent =
                self.limits.max_evaluations.is_some_and(|m| self.batch_ledger.ledger.n_evaluations >= m);
            let late = self.limits.max_time.is_some_and(|t| self.elapsed() >= t.as_secs_f64());
            // Evaluations made before the run was resumed are known already.
            if (spent || late) && self.batch_ledger.replay.is_empty() {
                let why = if spent { Termination::MaxEvaluations } else { Termination::MaxTime };
                self.ended = Some(Some(limited(&self.method, &self.batch_ledger, why)));
                break;
            }
            self.batch_ledger.open(&self.batch, &self.limits);
            let width = match self.method.details().lookahead {
                Lookahead::None => 1,
                Lookahead::Points(points) => points,
                Lookahead::Workers | Lookahead::Measured => self.workers,
            };
            let needed = self.batch_ledger.n_needed();
            self.batch_ledger.speculate(&mut self.method, width.saturating_sub(needed), &self.limits);
            let len = self.batch_ledger.work.len();
            self.due.clear();
            self.due.extend(0..len);
            self.n_open = len;
            reset(&mut self.answers, len);
            self.handed.clear();
            self.handed.resize(len, None);
            if len > 0 {
                break;
            }
            let stopped = self.batch_ledger.stopped(self.batch_ledger.last(&self.answers));
            self.complete(stopped)?;
        }
        self.save_now_and_then()
    }

    /// Ends the run: [`termination`](Self::termination) is [`Termination::Interrupted`] then, if it was not over
    /// already. What was told of an incomplete round is entered.
    ///
    /// # Errors
    /// The checkpoint cannot be written.
    pub fn stop(&mut self) -> Result<(), Error> {
        if self.ended.is_some() {
            return Ok(());
        }
        if self.n_open < self.answers.len() {
            self.complete(Some(Termination::Interrupted))?;
        } else {
            self.save()?;
        }
        self.ended = Some(Some(Termination::Interrupted));
        Ok(())
    }

    /// Points handed out and not answered yet.
    pub fn n_pending(&self) -> usize {
        self.handed.iter().flatten().count()
    }

    /// The best point so far and its cost, of complete rounds.
    pub fn best(&self) -> Option<(&[f64], f64)> {
        self.batch_ledger.ledger.best.get()
    }

    /// Why the run is over; `None` while it is not. A run whose starting points all failed counts as
    /// [`Termination::AllFailed`] here; its [`report`](Self::report) is an error.
    pub fn termination(&self) -> Option<Termination> {
        self.ended.as_ref().map(|t| t.clone().unwrap_or(Termination::AllFailed))
    }

    /// The method, to look into.
    pub fn method(&self) -> &dyn Method {
        &self.method
    }

    /// All evaluations of complete rounds.
    pub fn trace(&self) -> &Trace {
        &self.batch_ledger.ledger.trace
    }

    /// The result so far; [`Termination::Interrupted`] while the run is not over.
    ///
    /// # Errors
    /// There is no point with a finite cost.
    pub fn report(&self) -> Result<Report, Error> {
        let termination = self.ended.clone().unwrap_or(Some(Termination::Interrupted));
        let mut ledger = self.batch_ledger.ledger.clone();
        let (workers, seconds) = (self.workers, self.elapsed());
        let report = report::conclude(
            &self.method,
            &mut ledger,
            &self.limits,
            workers,
            termination,
            seconds,
            &mut || false,
        )?;
        let (method_reason, resumed) = (self.method_reason.clone(), self.resumed.clone());
        Ok(Report { method_reason, resumed, ..report })
    }
}
