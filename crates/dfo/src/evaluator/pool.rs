//! Threads of our own.

use super::calls::{Evaluator, Polled, Wait, call};
use crate::answer::Answer;
use crate::error::Error;
use crate::objective::{Ends, Objective, Query};
use rayon::{Scope, ThreadPool, ThreadPoolBuilder};
use std::fmt;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Instant;

/// More workers than this are a mistake: no machine runs so many threads at once.
const MOST_WORKERS: usize = 1 << 15;

/// Stack of a worker thread: compiled models put large arrays there.
const STACK_SIZE: usize = 16 << 20;

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
    /// too: then the calling thread evaluates. `None` also for one of the threads themselves: an objective that
    /// minimises on the pool it runs on would wait for its own threads for ever.
    pub(crate) fn threads(&self) -> Option<&ThreadPool> {
        let start = |workers: usize| {
            let threads = ThreadPoolBuilder::new().num_threads(workers).stack_size(STACK_SIZE);
            threads.thread_name(|k| format!("dfo-worker-{k}")).build().inspect_err(|e| {
                log::warn!("cannot start {workers} worker threads, so fewer are used: {e}");
            })
        };
        let cores = || std::thread::available_parallelism().map_or(1, |n| n.get()).min(self.workers);
        let started = self.pool.get_or_init(|| start(self.workers).or_else(|_| start(cores())).ok());
        started.as_ref().filter(|threads| threads.current_thread_index().is_none())
    }
}

impl fmt::Debug for WorkerPool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WorkerPool").field("workers", &self.workers()).finish()
    }
}

/// What the threads see of a batch.
pub(crate) struct Shared<'a> {
    objective: &'a dyn Objective,
    ends: Ends<'a>,
    /// Nothing more begins.
    stop: AtomicBool,
    /// What is running gives up.
    over: AtomicBool,
}

impl<'a> Shared<'a> {
    pub(crate) fn new(objective: &'a dyn Objective, ends: Ends<'a>) -> Self {
        Self { objective, ends, stop: AtomicBool::new(false), over: AtomicBool::new(false) }
    }
}

/// A point on its way to a thread and back.
#[derive(Debug)]
pub(crate) struct Job {
    x: Vec<f64>,
    query: Query<'static>,
    answer: Answer,
}

/// The threads of a pool while they evaluate a batch.
pub(crate) struct Threads<'p, 's> {
    scope: &'p Scope<'s>,
    shared: &'s Shared<'s>,
    spare: &'p mut Vec<Job>,
    sender: Sender<Job>,
    receiver: Receiver<Job>,
    n_open: usize,
}

impl<'p, 's> Threads<'p, 's> {
    pub(crate) fn new(scope: &'p Scope<'s>, shared: &'s Shared<'s>, spare: &'p mut Vec<Job>) -> Self {
        let (sender, receiver) = channel();
        Self { scope, shared, spare, sender, receiver, n_open: 0 }
    }
}

impl Evaluator for Threads<'_, '_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let Job { x: mut room, answer, .. } =
            self.spare.pop().unwrap_or_else(|| Job { x: Vec::new(), query, answer: Answer::default() });
        room.clear();
        room.extend_from_slice(x);
        let mut job = Job { x: room, query, answer };
        let (shared, sender) = (self.shared, self.sender.clone());
        self.n_open += 1;
        // Spawned from outside, jobs begin in the order of their coming: when one has begun, all before it have too, so an
        // abort at one never loses a point that a serial run would have had.
        self.scope.spawn(move |_| {
            let Job { x, query, answer } = &mut job;
            if shared.stop.load(Ordering::Acquire) {
                answer.clear();
            } else {
                call(
                    shared.objective,
                    x,
                    &query.ended_by(shared.ends.with_flag_of_batch(&shared.over)),
                    answer,
                );
            }
            // Nobody listens any more only while the calling thread unwinds.
            let _ = sender.send(job);
        });
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        if self.n_open == 0 {
            return Polled::Idle;
        }
        match self.receiver.recv_timeout(wait.until.saturating_duration_since(Instant::now())) {
            Ok(mut job) => {
                self.n_open -= 1;
                std::mem::swap(answer, &mut job.answer);
                let id = job.query.id;
                self.spare.push(job);
                Polled::Answered(id)
            }
            Err(RecvTimeoutError::Timeout) => Polled::Waiting,
            Err(RecvTimeoutError::Disconnected) => Polled::Idle,
        }
    }

    fn withdraw(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
    }

    fn cancel(&mut self) {
        self.withdraw();
        self.shared.over.store(true, Ordering::Relaxed);
    }
}

impl Drop for Threads<'_, '_> {
    /// A panic in the poll function must not wait for the rest of the batch.
    fn drop(&mut self) {
        if self.n_open > 0 {
            self.cancel();
        }
    }
}
