//! The only gateway to the objective: what is known already, exact budgets, execution, entry into the ledger.

pub(crate) mod batch_ledger;
pub(crate) mod cache;
pub(crate) mod ledger;
pub(crate) mod speculative;
mod width_control;

use crate::answer::Answer;
use crate::evaluator::{
    BatchFunction, Batches, CallingThread, Evaluator, GivesUp, Job, Polled, Shared, Threads, Wait, WorkerPool,
};
use crate::method::{Batch, Method};
use crate::objective::{CancelSignals, Objective};
use crate::termination::Termination;
use crate::tolerances::Limits;
use batch_ledger::{BatchLedger, Replay, reset};
use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use width_control::{Dispatch, WidthControl};

pub(crate) use width_control::OnCallingThread;

/// The calling thread looks for interrupts at least this often while workers compute.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// What evaluates.
pub(crate) enum Executor<'a> {
    Serial(CallingThread<'a>),
    Pool {
        pool: &'a WorkerPool,
        objective: &'a dyn Objective,
        here: OnCallingThread,
        serial: CallingThread<'a>,
        spare: Vec<Job>,
    },
    Batches(Batches<'a>),
}

impl<'a> Executor<'a> {
    pub(crate) fn serial(objective: &'a dyn Objective) -> Self {
        Self::Serial(CallingThread::new(objective))
    }

    pub(crate) fn pool(pool: &'a WorkerPool, objective: &'a dyn Objective, here: OnCallingThread) -> Self {
        Self::Pool { pool, objective, here, serial: CallingThread::new(objective), spare: Vec::new() }
    }

    pub(crate) fn batches(function: &'a mut BatchFunction<'a>) -> Self {
        Self::Batches(Batches::new(function))
    }

    fn dispatch(&self) -> Dispatch {
        match self {
            Self::Serial(_) => Dispatch::Never,
            Self::Pool { .. } => Dispatch::Threads,
            Self::Batches(_) => Dispatch::Batches,
        }
    }
}

/// What the outside may want while a batch is computed.
pub(crate) struct RunControl<'a> {
    signals: CancelSignals<'a>,
    poll: Option<&'a mut dyn FnMut() -> bool>,
    last_poll: Option<Instant>,
}

/// Why no more evaluations may start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum StopCause {
    Interrupted,
    OutOfTime,
}

impl<'a> RunControl<'a> {
    /// Whether to go on; asks the user's poll function unless it was asked a moment ago.
    pub(crate) fn check(&mut self) -> Option<StopCause> {
        if self.signals.is_cancelled() {
            return Some(StopCause::Interrupted);
        }
        if self.signals.deadline.is_none() && self.poll.is_none() {
            return None;
        }
        let now = Instant::now();
        if let Some(poll) =
            self.poll.as_mut().filter(|_| self.last_poll.is_none_or(|t| now - t >= POLL_INTERVAL))
        {
            self.last_poll = Some(now);
            if poll() {
                return Some(StopCause::Interrupted);
            }
        }
        self.signals.deadline.filter(|d| now >= *d).map(|_| StopCause::OutOfTime)
    }

    /// How long the calling thread may wait for an answer before it must look up. `halted`: whether it knows of the
    /// deadline already.
    fn wait(&self, halted: bool) -> Wait<'a> {
        let soon = Instant::now() + POLL_INTERVAL;
        let until = self.signals.deadline.filter(|_| !halted).map_or(soon, |deadline| deadline.min(soon));
        Wait { until, signals: self.signals }
    }
}

/// Evaluates these points of the batch ledger's work. After a point of the path that ends the run nothing more begins.
fn gather(
    evaluator: &mut dyn Evaluator,
    batch_ledger: &BatchLedger,
    points: Range<usize>,
    control: &mut RunControl<'_>,
    answers: &mut [Answer],
) -> Option<StopCause> {
    let work = &batch_ledger.work;
    for k in points {
        evaluator.submit(work.point(k), work.query(k));
    }
    let (mut cause, mut answer) = (None, Answer::default());
    loop {
        match evaluator.poll(&control.wait(cause.is_some()), &mut answer) {
            Polled::Answered(id) => {
                let Some(k) = work.place_of(id) else { continue };
                std::mem::swap(&mut answers[k], &mut answer);
                if batch_ledger.is_last(k, &answers[k]) {
                    evaluator.withdraw();
                }
            }
            Polled::Waiting => {}
            Polled::Idle => return cause,
        }
        if cause.is_none() {
            cause = control.check();
            if cause.is_some() {
                evaluator.cancel();
            }
        }
    }
}

pub(crate) struct Gateway<'a> {
    executor: Executor<'a>,
    pub(crate) control: RunControl<'a>,
    limits: Limits,
    width_control: WidthControl,
    start: Instant,
    /// Seconds of the run before it was resumed.
    before: f64,
    /// The answers to the points of the batch ledger's work.
    answers: Vec<Answer>,
    pub(crate) batch_ledger: BatchLedger,
}

impl<'a> Gateway<'a> {
    pub(crate) fn new(
        executor: Executor<'a>,
        mut batch_ledger: BatchLedger,
        limits: Limits,
        (before, spent): (f64, Duration),
        control: (&'a AtomicBool, Option<&'a mut dyn FnMut() -> bool>),
        workers: usize,
    ) -> Self {
        let start = Instant::now();
        let left = limits
            .max_time
            .map(|t| t.saturating_sub(Duration::try_from_secs_f64(before).unwrap_or(Duration::MAX)))
            .map(|t| t.saturating_sub(spent));
        let deadline = left.and_then(|t| start.checked_add(t));
        batch_ledger.gives_up = match &executor {
            Executor::Serial(serial) | Executor::Pool { serial, .. } => serial.gives_up(),
            Executor::Batches(_) => GivesUp::Unknown,
        };
        let (cancel, poll) = control;
        Self {
            width_control: WidthControl::new(workers, executor.dispatch()),
            executor,
            control: RunControl { signals: CancelSignals::new(cancel, deadline), poll, last_poll: None },
            limits,
            start,
            before,
            answers: Vec::new(),
            batch_ledger,
        }
    }

    pub(crate) fn elapsed(&self) -> f64 {
        self.before + self.start.elapsed().as_secs_f64()
    }

    /// The limit that forbids to start another evaluation, if one does.
    pub(crate) fn exhausted(&self) -> Option<Termination> {
        if !self.batch_ledger.replay.is_empty() {
            // Evaluations made before the run was resumed are known already.
            return None;
        }
        if self.limits.max_evaluations.is_some_and(|m| self.batch_ledger.ledger.n_evaluations >= m) {
            return Some(Termination::MaxEvaluations);
        }
        self.control.signals.is_late().then_some(Termination::MaxTime)
    }

    /// Evaluates what the budget allows of a batch that `method` asked for, in request order, and what it may need next
    /// where that is faster. Returns why the run must end, if it must; then the batch may be incomplete. Nothing is
    /// entered into the ledger before [`close`](Self::close).
    pub(crate) fn evaluate<M: Method + ?Sized>(
        &mut self,
        batch: &Batch,
        method: &mut M,
    ) -> Option<Termination> {
        self.batch_ledger.open(batch, &self.limits);
        let started = Instant::now();
        let needed = self.batch_ledger.n_needed();
        let width =
            self.width_control.width(method.details().lookahead, self.batch_ledger.ledger.n_evaluations);
        if needed > 0 && width > needed {
            self.batch_ledger.speculate(method, width - needed, &self.limits);
        }
        reset(&mut self.answers, self.batch_ledger.work.len());
        let cause = self.control.check().or_else(|| self.execute());
        if needed > 0 {
            self.width_control.measured(
                needed,
                started.elapsed().as_secs_f64(),
                self.answers.iter().map(|a| a.seconds),
            );
        }
        self.verdict(cause)
    }

    /// Evaluates the batch ledger's work.
    fn execute(&mut self) -> Option<StopCause> {
        let Self { executor, batch_ledger, control, width_control, answers, .. } = self;
        let mut rest = 0..batch_ledger.work.len();
        match executor {
            Executor::Serial(serial) => gather(serial, batch_ledger, rest, control, answers),
            Executor::Batches(batches) => gather(batches, batch_ledger, rest, control, answers),
            Executor::Pool { pool, objective, here, serial, spare } => {
                if *here == OnCallingThread::AtFirst && width_control.is_new() && !rest.is_empty() {
                    // How long an evaluation takes shows whether threads are worth starting.
                    let cause = gather(serial, batch_ledger, 0..1, control, answers);
                    if cause.is_some() || batch_ledger.is_last(0, &answers[0]) {
                        return cause;
                    }
                    rest = 1..batch_ledger.work.len();
                }
                let known = (rest.start > 0).then(|| answers[0].seconds);
                let away = !rest.is_empty() && width_control.hands_over(rest.len(), *here, known);
                let Some(threads) = away.then(|| pool.threads()).flatten() else {
                    return gather(serial, batch_ledger, rest, control, answers);
                };
                let shared = Shared::new(*objective, control.signals);
                threads.in_place_scope(|scope| {
                    let mut threads = Threads::new(scope, &shared, spare);
                    gather(&mut threads, batch_ledger, rest, control, answers)
                })
            }
        }
    }

    /// Why the run must end after what the path needs was evaluated.
    fn verdict(&self, cause: Option<StopCause>) -> Option<Termination> {
        let last = self.batch_ledger.last(&self.answers);
        let stopped = self.batch_ledger.stopped(last);
        if matches!(stopped, Some(Termination::Aborted(_))) {
            return stopped;
        }
        match cause {
            Some(StopCause::Interrupted) => return Some(Termination::Interrupted),
            Some(StopCause::OutOfTime) => return Some(Termination::MaxTime),
            None => {}
        }
        let n_needed =
            last.map_or(self.batch_ledger.n_needed(), |(place, _)| self.batch_ledger.n_before(place));
        if self.answers[..n_needed].iter().any(|answer| !answer.outcome.is_known()) {
            // An evaluation gave up although nothing above noticed: the deadline passed inside of it, or the
            // objective was told to stop elsewhere.
            let is_late = self.control.signals.is_late();
            return Some(if is_late { Termination::MaxTime } else { Termination::Interrupted });
        }
        stopped
    }

    /// What of the batch just evaluated is known for good.
    pub(crate) fn known(&self, batch: &Batch) -> Vec<Replay> {
        self.batch_ledger.known(batch, &self.answers)
    }

    /// Enters the batch just evaluated into the ledger.
    pub(crate) fn close(&mut self, batch: &Batch) {
        self.batch_ledger.close(batch, &mut self.answers);
    }
}
