//! Who computes: the calling thread, a pool of our own threads, or a function of the user's that takes whole batches.

use crate::error::Error;
use crate::method::Batch;
use crate::objective::{Ends, Evaluation, Failure, FailureKind, Objective, Outcome};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Stack of a worker thread: compiled models put large arrays there.
const STACK_SIZE: usize = 16 << 20;

/// The calling thread looks for interrupts at least this often while workers compute.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Threads that evaluate objectives; never rayon's global pool. Can be shared by runs, also at once.
pub struct WorkerPool {
    pool: ThreadPool,
}

impl WorkerPool {
    /// Starts `workers` threads with stacks of 16 MiB.
    ///
    /// # Errors
    /// No workers asked for, or the system refused.
    pub fn new(workers: usize) -> Result<Self, Error> {
        if workers == 0 {
            return Err(Error::Option { name: "workers", value: 0.0, range: "at least 1" });
        }
        ThreadPoolBuilder::new()
            .num_threads(workers)
            .stack_size(STACK_SIZE)
            .thread_name(|k| format!("dfo-worker-{k}"))
            .build()
            .map(|pool| Self { pool })
            .map_err(|e| Error::Pool { workers, message: e.to_string() })
    }

    /// Number of threads.
    pub fn workers(&self) -> usize {
        self.pool.current_num_threads()
    }
}

impl fmt::Debug for WorkerPool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkerPool").field("workers", &self.workers()).finish()
    }
}

/// The part of a batch that a user's function is to evaluate: what the budget leaves of it.
#[derive(Debug, Clone, Copy)]
pub struct BatchView<'a> {
    batch: &'a Batch,
    len: usize,
    ends: Ends<'a>,
}

impl<'a> BatchView<'a> {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Number of parameters.
    pub fn n(&self) -> usize {
        self.batch.n()
    }

    /// Point `k` in the user's units.
    pub fn point(&self, k: usize) -> &'a [f64] {
        self.batch.point(k)
    }

    /// All points, row by row.
    pub fn as_flat(&self) -> &'a [f64] {
        &self.batch.as_flat()[..self.len * self.batch.n()]
    }

    /// Cutoff, ids and cancel flag of point `k`.
    pub fn evaluation(&self, k: usize) -> Evaluation<'a> {
        self.batch.evaluation(k).ended_by(self.ends)
    }
}

/// A function that evaluates whole batches on the calling thread: one outcome per point, in order.
pub(crate) type BatchFunction<'a> = dyn FnMut(&BatchView<'_>) -> Vec<Outcome> + 'a;

pub(crate) enum Executor<'a> {
    Serial(&'a dyn Objective),
    Pool(&'a WorkerPool, &'a dyn Objective),
    Foreign(&'a mut BatchFunction<'a>),
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

/// Evaluates the first `len` points. Fills `outcomes` (all [`Outcome::Skipped`] on entry) and `seconds`.
pub(crate) fn execute(
    executor: &mut Executor<'_>,
    batch: &Batch,
    len: usize,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    if let Some(halt) = outside.check() {
        return Some(halt);
    }
    match executor {
        Executor::Serial(objective) => serial(*objective, batch, len, outside, outcomes, seconds),
        Executor::Pool(pool, objective) => pooled(pool, *objective, batch, len, outside, outcomes, seconds),
        Executor::Foreign(function) => foreign(function, batch, len, outside, outcomes, seconds),
    }
}

fn serial(
    objective: &dyn Objective,
    batch: &Batch,
    len: usize,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    for k in 0..len {
        if k > 0
            && let Some(halt) = outside.check()
        {
            return Some(halt);
        }
        (outcomes[k], seconds[k]) = call(objective, batch, k, outside.ends);
        if matches!(outcomes[k], Outcome::Abort(_)) {
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
    batch: &Batch,
    len: usize,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    if pool.pool.current_thread_index().is_some() {
        // An objective that itself minimises on the pool it runs on: waiting for its own threads would be for ever.
        return serial(objective, batch, len, outside, outcomes, seconds);
    }
    let (next, stop, over) = (AtomicUsize::new(0), AtomicBool::new(false), AtomicBool::new(false));
    let (next, stop, over) = (&next, &stop, &over);
    let deadline = outside.ends.deadline;
    let ends = outside.ends.with_flag_of_batch(over);
    let (sender, receiver) = channel();
    let mut halt = None;
    pool.pool.in_place_scope(|scope| {
        // Each worker takes the next point in request order: when point k has started, all before it have too, so
        // an abort at k never loses a point that a serial run would have had.
        for _ in 0..pool.workers().min(len) {
            let sender = sender.clone();
            scope.spawn(move |_| {
                while !stop.load(Ordering::Acquire) {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k >= len {
                        break;
                    }
                    let (outcome, seconds) = call(objective, batch, k, ends);
                    if matches!(outcome, Outcome::Abort(_)) {
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
    batch: &Batch,
    len: usize,
    outside: &mut Outside<'_>,
    outcomes: &mut [Outcome],
    seconds: &mut [f64],
) -> Option<Halt> {
    let view = BatchView { batch, len, ends: outside.ends };
    let start = Instant::now();
    let answer = catch_unwind(AssertUnwindSafe(|| function(&view)));
    let each = start.elapsed().as_secs_f64() / len as f64;
    match answer {
        Ok(answer) if answer.len() == len => {
            for (k, outcome) in answer.into_iter().enumerate() {
                // A function that was interrupted says so by leaving points out.
                outcomes[k] = match outcome {
                    Outcome::Skipped => Outcome::Skipped,
                    other => other.checked(batch.cutoff(k)),
                };
            }
        }
        Ok(answer) => {
            let got = answer.len();
            outcomes[0] = Outcome::Abort(format!("{got} outcomes were returned for a batch of {len} points"));
        }
        Err(payload) => outcomes[..len].fill(Outcome::Failed(panicked(payload.as_ref()))),
    }
    seconds[..len].fill(each);
    outside.check()
}

/// One call of the objective: panics caught, the outcome made regular, the time taken.
fn call(objective: &dyn Objective, batch: &Batch, k: usize, ends: Ends<'_>) -> (Outcome, f64) {
    let evaluation = batch.evaluation(k).ended_by(ends);
    let start = Instant::now();
    // Unwind safety: the objective is only lent, and one that breaks itself by panicking can only fail again.
    let outcome = match catch_unwind(AssertUnwindSafe(|| objective.evaluate(batch.point(k), &evaluation))) {
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
