//! Who computes: the calling thread, a pool of our own threads, or a function of the user's that takes whole batches.

use crate::ahead::GivesUp;
use crate::error::Error;
use crate::method::Batch;
use crate::objective::{Ends, Evaluation, Failure, FailureKind, Objective, Outcome};
use crate::pace::{HandingOver, Pace};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::any::Any;
use std::cell::Cell;
use std::fmt;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// More workers than this are a mistake: no machine runs so many threads at once.
const MOST_WORKERS: usize = 1 << 15;

/// Stack of a worker thread: compiled models put large arrays there.
const STACK_SIZE: usize = 16 << 20;

/// The calling thread looks for interrupts at least this often while workers compute.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Threads that evaluate objectives; never rayon's global pool. Can be shared by runs, also at once.
///
/// They are started when there is work for them that is worth it.
pub struct WorkerPool {
    workers: usize,
    pool: OnceLock<Option<ThreadPool>>,
}

impl WorkerPool {
    /// A pool of `workers` threads with stacks of 16 MiB.
    ///
    /// # Errors
    /// No workers asked for, or more than 32768.
    pub fn new(workers: usize) -> Result<Self, Error> {
        if !(1..=MOST_WORKERS).contains(&workers) {
            let range = "at least 1, and at most 32768";
            return Err(Error::Option { name: "workers", value: workers as f64, range });
        }
        Ok(Self { workers, pool: OnceLock::new() })
    }

    /// Number of threads.
    pub fn workers(&self) -> usize {
        self.workers
    }

    /// The threads; where the system refuses to start so many as many as there are cores, and `None` if it refuses these,
    /// too: then the calling thread evaluates.
    fn threads(&self) -> Option<&ThreadPool> {
        let start = |workers: usize| {
            let threads = ThreadPoolBuilder::new().num_threads(workers).stack_size(STACK_SIZE);
            threads.thread_name(|k| format!("dfo-worker-{k}")).build().inspect_err(|e| {
                log::warn!("cannot start {workers} worker threads, so fewer are used: {e}");
            })
        };
        let cores = || std::thread::available_parallelism().map_or(1, |n| n.get()).min(self.workers);
        self.pool.get_or_init(|| start(self.workers).or_else(|_| start(cores())).ok()).as_ref()
    }
}

impl fmt::Debug for WorkerPool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkerPool").field("workers", &self.workers()).finish()
    }
}

/// The points that a user's function is to evaluate.
#[derive(Debug, Clone, Copy)]
pub struct BatchView<'a> {
    batch: &'a Batch,
    first: usize,
    ends: Ends<'a>,
    /// What the function says about the time that each took.
    seconds: &'a [Cell<f64>],
}

impl<'a> BatchView<'a> {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.seconds.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.seconds.is_empty()
    }

    /// Number of parameters.
    pub fn n(&self) -> usize {
        self.batch.n()
    }

    /// Point `k` in the user's units.
    pub fn point(&self, k: usize) -> &'a [f64] {
        self.batch.point(self.first + k)
    }

    /// All points, row by row.
    pub fn as_flat(&self) -> &'a [f64] {
        let n = self.batch.n();
        &self.batch.as_flat()[self.first * n..(self.first + self.len()) * n]
    }

    /// Cutoff, ids and cancel flag of point `k`.
    pub fn evaluation(&self, k: usize) -> Evaluation<'a> {
        self.batch.evaluation(self.first + k).ended_by(self.ends)
    }

    /// Says how many seconds point `k` took, for the trace; else it is an equal share of the time of the call.
    pub fn set_seconds(&self, k: usize, seconds: f64) {
        self.seconds[k].set(seconds);
    }
}

/// A function that evaluates whole batches on the calling thread: one outcome per point, in order.
pub(crate) type BatchFunction<'a> = dyn FnMut(&BatchView<'_>) -> Vec<Outcome> + 'a;

/// When the calling thread evaluates rather than a pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Here {
    Never,
    /// When evaluations are known to be short.
    WhenShort,
    /// When they are too short to be handed over; and the first one, which shows how long they are.
    AtFirst,
}

pub(crate) enum Executor<'a> {
    Serial(&'a dyn Objective),
    Pool { pool: &'a WorkerPool, objective: &'a dyn Objective, here: Here },
    Foreign(&'a mut BatchFunction<'a>),
}

impl Executor<'_> {
    pub(crate) fn gives_up(&self) -> GivesUp {
        match self {
            Self::Serial(objective) | Self::Pool { objective, .. } => match objective.uses_cutoff() {
                true => GivesUp::Yes,
                false => GivesUp::No,
            },
            Self::Foreign(_) => GivesUp::Unknown,
        }
    }

    pub(crate) fn handing_over(&self) -> HandingOver {
        match self {
            Self::Serial(_) => HandingOver::Never,
            Self::Pool { .. } => HandingOver::Threads,
            Self::Foreign(_) => HandingOver::Batches,
        }
    }
}

/// What is to be evaluated.
#[derive(Clone, Copy)]
pub(crate) struct Order<'a> {
    pub(crate) work: &'a Batch,
    /// Of its points the first so many are what the path needs: an exception in one of them ends the run.
    pub(crate) needed: usize,
    pub(crate) pace: &'a Pace,
}

/// What the outside may want while a batch is computed.
pub(crate) struct Outside<'a> {
    pub(crate) ends: Ends<'a>,
    pub(crate) poll: Option<&'a mut dyn FnMut() -> bool>,
    pub(crate) last_poll: Option<Instant>,
}

/// Why no more evaluations may start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Halt {
    Interrupted,
    OutOfTime,
}

impl Outside<'_> {
    /// Whether to go on; asks the user's poll function unless it was asked a moment ago.
    pub(crate) fn check(&mut self) -> Option<Halt> {
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

    /// How long the calling thread may wait for a result before it must look up.
    fn patience(&self) -> Duration {
        match self.ends.deadline {
            Some(d) => POLL_INTERVAL.min(d.saturating_duration_since(Instant::now())),
            None => POLL_INTERVAL,
        }
    }
}

/// Evaluates points. Fills `outcomes` (all [`Outcome::Skipped`] on entry) and `seconds`.
pub(crate) fn execute(
    executor: &mut Executor<'_>,
    order: &Order<'_>,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    if let Some(halt) = outside.check() {
        return Some(halt);
    }
    let all = 0..order.work.len();
    match executor {
        Executor::Serial(objective) => serial(*objective, order, all, outside, outcomes, seconds),
        Executor::Pool { pool, objective, here } => {
            let (objective, here) = (*objective, *here);
            let mut rest = all;
            if here == Here::AtFirst && order.pace.is_new() {
                // How long an evaluation takes shows whether threads are worth starting.
                let halt = serial(objective, order, 0..1, outside, outcomes, seconds);
                if halt.is_some() || matches!(outcomes[0], Outcome::Abort(_)) {
                    return halt;
                }
                rest = 1..order.work.len();
            }
            let known = (rest.start > 0).then_some(seconds[0]);
            if rest.is_empty() || !order.pace.hands_over(rest.len(), here, known) {
                return serial(objective, order, rest, outside, outcomes, seconds);
            }
            pooled(pool, objective, order, rest, outside, outcomes, seconds)
        }
        Executor::Foreign(function) => foreign(*function, order, outside, outcomes, seconds),
    }
}

fn serial(
    objective: &dyn Objective,
    order: &Order<'_>,
    points: Range<usize>,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    for k in points {
        if k > 0
            && let Some(halt) = outside.check()
        {
            return Some(halt);
        }
        (outcomes[k], seconds[k]) = call(objective, order.work, k, outside.ends);
        if k < order.needed && matches!(outcomes[k], Outcome::Abort(_)) {
            return None;
        }
    }
    None
}

/// Lets no further evaluation start, and running ones give up, when the calling thread unwinds.
struct StopOnUnwind<'a> {
    stop: &'a AtomicBool,
    over: &'a AtomicBool,
}

impl Drop for StopOnUnwind<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.stop.store(true, Ordering::Release);
            self.over.store(true, Ordering::Relaxed);
        }
    }
}

fn pooled(
    pool: &WorkerPool,
    objective: &dyn Objective,
    order: &Order<'_>,
    points: Range<usize>,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    // An objective that itself minimises on the pool it runs on: waiting for its own threads would be for ever.
    let elsewhere = |threads: &&ThreadPool| threads.current_thread_index().is_none();
    let Some(threads) = pool.threads().filter(elsewhere) else {
        return serial(objective, order, points, outside, outcomes, seconds);
    };
    let Order { work: batch, needed, .. } = *order;
    let (next, end) = (AtomicUsize::new(points.start), points.end);
    let (stop, over) = (AtomicBool::new(false), AtomicBool::new(false));
    let (next, stop, over) = (&next, &stop, &over);
    let deadline = outside.ends.deadline;
    let ends = outside.ends.with_flag_of_batch(over);
    let (sender, receiver) = channel();
    let mut halt = None;
    threads.in_place_scope(|scope| {
        // Each worker takes the next point in request order: when point k has started, all before it have too, so
        // an abort at k never loses a point that a serial run would have had.
        for _ in 0..pool.workers().min(points.len()) {
            let sender = sender.clone();
            scope.spawn(move |_| {
                while !stop.load(Ordering::Acquire) {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k >= end {
                        break;
                    }
                    let (outcome, seconds) = call(objective, batch, k, ends);
                    if k < needed && matches!(outcome, Outcome::Abort(_)) {
                        stop.store(true, Ordering::Release);
                    }
                    if sender.send((k, outcome, seconds)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        // A panic in the poll function must not wait for the rest of the batch.
        let _end = StopOnUnwind { stop, over };
        loop {
            match receiver.recv_timeout(outside.patience()) {
                Ok((k, outcome, elapsed)) => (outcomes[k], seconds[k]) = (outcome, elapsed),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if halt.is_none() {
                halt = outside.check();
                if halt.is_some() {
                    stop.store(true, Ordering::Release);
                    over.store(true, Ordering::Relaxed);
                }
            } else if outside.ends.deadline.is_some() {
                // The patience is zero once the deadline is over; do not spin while the last evaluations end.
                outside.ends.deadline = None;
            }
        }
    });
    outside.ends.deadline = deadline;
    halt
}

fn foreign(
    function: &mut BatchFunction<'_>,
    order: &Order<'_>,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    let len = order.work.len();
    if let Some(why) = in_one_call(function, order.work, 0..len, outside, outcomes, seconds) {
        outcomes.fill(Outcome::Failed(why));
        // One point that panics is no reason for the others to fail.
        for k in (0..len).filter(|_| len > 1) {
            if let Some(halt) = outside.check() {
                outcomes[k..].fill(Outcome::Skipped);
                return Some(halt);
            }
            if let Some(why) = in_one_call(function, order.work, k..k + 1, outside, outcomes, seconds) {
                outcomes[k] = Outcome::Failed(why);
            }
        }
    }
    outside.check()
}

/// One call of a function for whole batches. Fills outcomes and seconds of the points, unless it panics.
fn in_one_call(
    function: &mut BatchFunction<'_>,
    batch: &Batch,
    points: Range<usize>,
    outside: &Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Failure> {
    let len = points.len();
    let own = vec![Cell::new(f64::NAN); len];
    let view = BatchView { batch, first: points.start, ends: outside.ends, seconds: &own };
    let start = Instant::now();
    let answer = catch_unwind(AssertUnwindSafe(|| function(&view)));
    let share = start.elapsed().as_secs_f64() / len as f64;
    let (outcomes, seconds) = (&mut outcomes[points.clone()], &mut seconds[points.clone()]);
    for (seconds, own) in seconds.iter_mut().zip(&own) {
        *seconds = if own.get().is_nan() { share } else { own.get() };
    }
    match answer {
        Ok(answer) if answer.len() == len => {
            for ((k, outcome), answer) in points.zip(outcomes).zip(answer) {
                // A function that was interrupted says so by leaving points out.
                *outcome = match answer {
                    Outcome::Skipped => Outcome::Skipped,
                    other => other.checked(batch.cutoff(k)),
                };
            }
            None
        }
        Ok(answer) => {
            let got = answer.len();
            outcomes[0] = Outcome::Abort(format!("{got} outcomes were returned for a batch of {len} points"));
            None
        }
        Err(payload) => Some(panicked(payload.as_ref())),
    }
}

/// One call of the objective: panics caught, the outcome made regular, the time taken.
fn call(objective: &dyn Objective, batch: &Batch, k: usize, ends: Ends<'_>) -> (Outcome, f64) {
    let evaluation = batch.evaluation(k).ended_by(ends);
    let start = Instant::now();
    // Unwind safety: the objective is only lent, and one that breaks itself by panicking can only fail again.
    let outcome = match catch_unwind(AssertUnwindSafe(|| objective.evaluate(batch.point(k), &evaluation))) {
        // What is known above the cutoff depends on the cutoff, which may be another where points are evaluated ahead.
        Ok(Outcome::Value(v)) if v > evaluation.cutoff && v.is_finite() && objective.uses_cutoff() => {
            Outcome::Above(evaluation.cutoff)
        }
        Ok(outcome) => outcome.checked(evaluation.cutoff),
        Err(payload) => Outcome::Failed(panicked(payload.as_ref())),
    };
    (outcome, start.elapsed().as_secs_f64())
}

fn panicked(payload: &(dyn Any + Send)) -> Failure {
    let text = payload
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message");
    Failure { kind: FailureKind::Panic, message: format!("panic: {text}") }
}
