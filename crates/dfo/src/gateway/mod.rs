//! The only gateway to the objective: what is known already, exact budgets, execution, entry into the ledger.

pub(crate) mod ahead;
pub(crate) mod cache;
pub(crate) mod desk;
pub(crate) mod ledger;
mod pace;

use crate::answer::Answer;
use crate::evaluator::{
    BatchFunction, Batches, CallingThread, Evaluator, GivesUp, Job, Polled, Shared, Threads, Wait, WorkerPool,
};
use crate::method::{Batch, Method};
use crate::objective::{Ends, Objective};
use crate::termination::Termination;
use crate::tolerances::Limits;
use desk::{Desk, Replay, reset};
use pace::{HandingOver, Pace};
use std::ops::Range;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

pub(crate) use pace::Here;

/// The calling thread looks for interrupts at least this often while workers compute.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Who computes.
pub(crate) enum Executor<'a> {
    Serial(CallingThread<'a>),
    Pool {
        pool: &'a WorkerPool,
        objective: &'a dyn Objective,
        here: Here,
        serial: CallingThread<'a>,
        spare: Vec<Job>,
    },
    Batches(Batches<'a>),
}

impl<'a> Executor<'a> {
    pub(crate) fn serial(objective: &'a dyn Objective) -> Self {
        Self::Serial(CallingThread::new(objective))
    }

    pub(crate) fn pool(pool: &'a WorkerPool, objective: &'a dyn Objective, here: Here) -> Self {
        Self::Pool { pool, objective, here, serial: CallingThread::new(objective), spare: Vec::new() }
    }

    pub(crate) fn batches(function: &'a mut BatchFunction<'a>) -> Self {
        Self::Batches(Batches::new(function))
    }

    fn handing_over(&self) -> HandingOver {
        match self {
            Self::Serial(_) => HandingOver::Never,
            Self::Pool { .. } => HandingOver::Threads,
            Self::Batches(_) => HandingOver::Batches,
        }
    }
}

/// What the outside may want while a batch is computed.
struct Outside<'a> {
    ends: Ends<'a>,
    poll: Option<&'a mut dyn FnMut() -> bool>,
    last_poll: Option<Instant>,
}

/// Why no more evaluations may start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Halt {
    Interrupted,
    OutOfTime,
}

impl<'a> Outside<'a> {
    /// Whether to go on; asks the user's poll function unless it was asked a moment ago.
    fn check(&mut self) -> Option<Halt> {
        if self.ends.is_cancelled() {
            return Some(Halt::Interrupted);
        }
        if self.ends.deadline.is_none() && self.poll.is_none() {
            return None;
        }
        let now = Instant::now();
        if let Some(poll) =
            self.poll.as_mut().filter(|_| self.last_poll.is_none_or(|t| now - t >= POLL_INTERVAL))
        {
            self.last_poll = Some(now);
            if poll() {
                return Some(Halt::Interrupted);
            }
        }
        self.ends.deadline.filter(|d| now >= *d).map(|_| Halt::OutOfTime)
    }

    /// How long the calling thread may wait for an answer before it must look up. `halted`: whether it knows of the
    /// deadline already.
    fn wait(&self, halted: bool) -> Wait<'a> {
        let soon = Instant::now() + POLL_INTERVAL;
        let until = self.ends.deadline.filter(|_| !halted).map_or(soon, |deadline| deadline.min(soon));
        Wait { until, ends: self.ends }
    }
}

/// Evaluates these points of the desk's work: one that the path needs and that ends the run lets nothing more begin.
fn gather(
    evaluator: &mut dyn Evaluator,
    desk: &Desk,
    points: Range<usize>,
    outside: &mut Outside<'_>,
    answers: &mut [Answer],
) -> Option<Halt> {
    let work = &desk.work;
    for k in points {
        evaluator.submit(work.point(k), work.query(k));
    }
    let (mut halt, mut answer) = (None, Answer::default());
    loop {
        match evaluator.poll(&outside.wait(halt.is_some()), &mut answer) {
            Polled::Answered(id) => {
                let Some(k) = work.place_of(id) else { continue };
                std::mem::swap(&mut answers[k], &mut answer);
                if desk.is_last(k, &answers[k]) {
                    evaluator.withdraw();
                }
            }
            Polled::Waiting => {}
            Polled::Idle => return halt,
        }
        if halt.is_none() {
            halt = outside.check();
            if halt.is_some() {
                evaluator.cancel();
            }
        }
    }
}

pub(crate) struct Gateway<'a> {
    executor: Executor<'a>,
    outside: Outside<'a>,
    limits: Limits,
    pace: Pace,
    start: Instant,
    /// Seconds of the run before it was resumed.
    before: f64,
    /// The answers to the points of the desk's work.
    answers: Vec<Answer>,
    pub(crate) desk: Desk,
}

impl<'a> Gateway<'a> {
    pub(crate) fn new(
        executor: Executor<'a>,
        mut desk: Desk,
        limits: Limits,
        before: f64,
        outside: (&'a AtomicBool, Option<&'a mut dyn FnMut() -> bool>),
        workers: usize,
    ) -> Self {
        let start = Instant::now();
        let left = limits
            .max_time
            .map(|t| t.saturating_sub(Duration::try_from_secs_f64(before).unwrap_or(Duration::MAX)));
        let deadline = left.and_then(|t| start.checked_add(t));
        desk.gives_up = match &executor {
            Executor::Serial(serial) | Executor::Pool { serial, .. } => serial.gives_up(),
            Executor::Batches(_) => GivesUp::Unknown,
        };
        let (cancel, poll) = outside;
        Self {
            pace: Pace::new(workers, executor.handing_over()),
            executor,
            outside: Outside { ends: Ends::new(cancel, deadline), poll, last_poll: None },
            limits,
            start,
            before,
            answers: Vec::new(),
            desk,
        }
    }

    pub(crate) fn elapsed(&self) -> f64 {
        self.before + self.start.elapsed().as_secs_f64()
    }

    /// The limit that forbids to start another evaluation, if one does.
    pub(crate) fn exhausted(&self) -> Option<Termination> {
        if !self.desk.replay.is_empty() {
            // Evaluations are at hand that were paid for already.
            return None;
        }
        if self.limits.max_evaluations.is_some_and(|m| self.desk.ledger.n_evaluations >= m) {
            return Some(Termination::MaxEvaluations);
        }
        self.outside.ends.is_late().then_some(Termination::MaxTime)
    }

    /// Evaluates what the budget allows of a batch that `method` asked for, in request order, and what it may need next
    /// where that is faster. Returns why the run must end, if it must; then the batch may be incomplete. Nothing is
    /// entered into the ledger before [`close`](Self::close).
    pub(crate) fn evaluate<M: Method + ?Sized>(
        &mut self,
        batch: &Batch,
        method: &mut M,
    ) -> Option<Termination> {
        self.desk.open(batch, &self.limits);
        let begun = Instant::now();
        let needed = self.desk.n_needed();
        let width = self.pace.width(method.details().lookahead, self.desk.ledger.n_evaluations);
        if needed > 0 && width > needed {
            self.desk.look_ahead(method, width - needed, &self.limits);
        }
        reset(&mut self.answers, self.desk.work.len());
        let halt = self.outside.check().or_else(|| self.execute());
        if needed > 0 {
            self.pace.measured(needed, begun.elapsed().as_secs_f64(), self.answers.iter().map(|a| a.seconds));
        }
        self.verdict(halt)
    }

    /// Evaluates the desk's work.
    fn execute(&mut self) -> Option<Halt> {
        let Self { executor, desk, outside, pace, answers, .. } = self;
        let mut rest = 0..desk.work.len();
        match executor {
            Executor::Serial(serial) => gather(serial, desk, rest, outside, answers),
            Executor::Batches(batches) => gather(batches, desk, rest, outside, answers),
            Executor::Pool { pool, objective, here, serial, spare } => {
                if *here == Here::AtFirst && pace.is_new() && !rest.is_empty() {
                    // How long an evaluation takes shows whether threads are worth starting.
                    let halt = gather(serial, desk, 0..1, outside, answers);
                    if halt.is_some() || desk.is_last(0, &answers[0]) {
                        return halt;
                    }
                    rest = 1..desk.work.len();
                }
                let known = (rest.start > 0).then(|| answers[0].seconds);
                let away = !rest.is_empty() && pace.hands_over(rest.len(), *here, known);
                let Some(threads) = away.then(|| pool.threads()).flatten() else {
                    return gather(serial, desk, rest, outside, answers);
                };
                let shared = Shared::new(*objective, outside.ends);
                threads.in_place_scope(|scope| {
                    let mut threads = Threads::new(scope, &shared, spare);
                    gather(&mut threads, desk, rest, outside, answers)
                })
            }
        }
    }

    /// Why the run must end after what the path needs was evaluated.
    fn verdict(&self, halt: Option<Halt>) -> Option<Termination> {
        let stopped = self.desk.stopped(&self.answers);
        if matches!(stopped, Some(Termination::Aborted(_))) {
            return stopped;
        }
        match halt {
            Some(Halt::Interrupted) => return Some(Termination::Interrupted),
            Some(Halt::OutOfTime) => return Some(Termination::MaxTime),
            None => {}
        }
        let last = self.desk.last(&self.answers);
        let n_needed = last.map_or(self.desk.n_needed(), |(place, _)| self.desk.n_before(place));
        if self.answers[..n_needed].iter().any(|answer| !answer.outcome.is_known()) {
            // An evaluation gave up although nothing above noticed: the deadline passed inside of it, or the
            // objective was told to stop by somebody else.
            let is_late = self.outside.ends.is_late();
            return Some(if is_late { Termination::MaxTime } else { Termination::Interrupted });
        }
        stopped
    }

    /// What of the batch just evaluated is known for good.
    pub(crate) fn known(&self, batch: &Batch) -> Vec<Replay> {
        self.desk.known(batch, &self.answers)
    }

    /// Enters the batch just evaluated into the ledger.
    pub(crate) fn close(&mut self, batch: &Batch) {
        self.desk.close(batch, &mut self.answers);
    }
}
