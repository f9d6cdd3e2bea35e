//! Evaluates the points of a run in a thread pool of its own, with one queue.

use super::evaluator::{CutoffUse, Evaluator, Polled, Wait, call, cutoff_use};
use super::timing::Timing;
use crate::outcome::answer::Answer;
use crate::problem::objective::{CancelSignals, Objective, Query};
use rayon::{ScopeFifo, ThreadBuilder, ThreadPool, ThreadPoolBuilder};
use std::cell::Cell;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::{Builder, Scope};
use std::time::{Duration, Instant};

/// More workers than this are a mistake: no machine runs so many threads at once.
pub(crate) const MOST_WORKERS: usize = 1 << 15;

/// Stack of a worker thread: compiled models put large arrays there.
const STACK_SIZE: usize = 16 << 20;

/// So long the calling thread has the first points to itself, to see whether evaluations are worth handing
/// over.
const TRIAL: Duration = Duration::from_micros(100);

thread_local! {
    /// True while a thread of a pool is at work.
    static EVALUATES: Cell<bool> = const { Cell::new(false) };
}

/// A point on its way to a thread and back.
#[derive(Debug)]
struct Job {
    x: Vec<f64>,
    query: Query<'static>,
    answer: Answer,
    /// Raised where its answer is not needed any more.
    over: Arc<AtomicBool>,
    handed_in: Instant,
    /// True if a thread was free when it was handed in.
    at_once: bool,
}

#[derive(Default)]
struct Queue {
    jobs: VecDeque<Job>,
    /// Nothing begins before.
    opens: Option<Instant>,
    /// Tasks of the pool: each does one job after the other, until none is left.
    n_tasks: usize,
    /// True if the calling thread evaluates, too.
    is_joined: bool,
}

/// Starts the threads of a run, which end before the scope `run` does. Fewer if the system refuses so many;
/// `None` if it refuses all.
pub(crate) fn pool<'scope>(run: &'scope Scope<'scope, '_>, workers: usize) -> Option<ThreadPool> {
    let spawn = |thread: ThreadBuilder| {
        let name = format!("dfo-worker-{}", thread.index());
        Builder::new().name(name).stack_size(STACK_SIZE).spawn_scoped(run, || thread.run()).map(drop)
    };
    let mut n = workers;
    while n > 0 {
        match ThreadPoolBuilder::new().num_threads(n).spawn_handler(spawn).build() {
            Ok(pool) => return Some(pool),
            Err(e) => log::warn!("cannot start {n} worker threads: {e}; trying {}", n / 2),
        }
        n /= 2;
    }
    None
}

/// State that the threads of a run share.
pub(crate) struct Shared<'a> {
    objective: &'a dyn Objective,
    signals: CancelSignals<'a>,
    workers: usize,
    queue: Mutex<Queue>,
    opened: Condvar,
}

impl<'a> Shared<'a> {
    pub(crate) fn new(objective: &'a dyn Objective, signals: CancelSignals<'a>, workers: usize) -> Self {
        Self { objective, signals, workers, queue: Mutex::default(), opened: Condvar::new() }
    }

    /// The queue is whole at every instant, whoever panicked.
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// The next job, once the queue is open; `None` ends the task that asks.
    fn next(&self) -> Option<Job> {
        let mut queue = self.queue();
        loop {
            let early = queue.opens.map(|opens| opens.saturating_duration_since(Instant::now()));
            let Some(left) = early.filter(|left| !left.is_zero() && !queue.jobs.is_empty()) else {
                let job = queue.jobs.pop_front();
                queue.n_tasks -= usize::from(job.is_none());
                return job;
            };
            queue = self.opened.wait_timeout(queue, left).unwrap_or_else(|e| e.into_inner()).0;
        }
    }

    /// One task of the pool. An objective that waits for tasks of rayon may be given this one: then it ends
    /// at once, for a job that began within another evaluation would take its thread-local state.
    fn work(&self, sender: &Sender<Job>) {
        if EVALUATES.replace(true) {
            self.queue().n_tasks -= 1;
            return;
        }
        while let Some(mut job) = self.next() {
            let Job { x, query, answer, over, .. } = &mut job;
            if over.load(Ordering::Relaxed) {
                answer.clear();
            } else {
                call(self.objective, x, &query.ended_by(self.signals.with_own_flag(over)), answer);
            }
            // The receiver is gone only while the calling thread unwinds.
            let _ = sender.send(job);
        }
        EVALUATES.set(false);
    }
}

/// When the calling thread evaluates, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OnCallingThread {
    /// When evaluations are known to be short.
    WhenShort,
    /// When they are too short to be handed over; and the first one, which shows how long they are.
    AtFirst,
}

/// The threads of a run, which work for it within a scope of their pool.
pub(crate) struct Threads<'s, 'e> {
    scope: &'s ScopeFifo<'e>,
    shared: &'e Shared<'e>,
    here: OnCallingThread,
    timing: Timing,
    /// Not given to the threads yet.
    waiting: VecDeque<Job>,
    /// Given to the threads: number and flag.
    away: Vec<(u64, Arc<AtomicBool>)>,
    spare: Vec<Job>,
    sender: Sender<Job>,
    receiver: Receiver<Job>,
}

impl<'s, 'e> Threads<'s, 'e> {
    pub(crate) fn new(scope: &'s ScopeFifo<'e>, shared: &'e Shared<'e>, here: OnCallingThread) -> Self {
        let (sender, receiver) = channel();
        let (waiting, away, spare) = (VecDeque::new(), Vec::new(), Vec::new());
        Self { scope, shared, here, timing: Timing::new(), waiting, away, spare, sender, receiver }
    }

    /// Gives all that waits to the threads; nothing begins before `opens`.
    fn hand_over(&mut self, opens: Option<Instant>) {
        if self.waiting.is_empty() {
            return;
        }
        let mut queue = self.shared.queue();
        queue.opens = opens;
        let now = Instant::now();
        // In a queue that opens later the time of a job is not that of handing it over.
        let mut free = if opens.is_some() { 0 } else { self.shared.workers.saturating_sub(self.away.len()) };
        for mut job in self.waiting.drain(..) {
            (job.handed_in, job.at_once) = (now, free > 0);
            free = free.saturating_sub(1);
            self.away.push((job.query.id, Arc::clone(&job.over)));
            queue.jobs.push_back(job);
        }
        self.start_tasks(queue);
    }

    /// Lets the threads begin; or takes `all` back that none has begun.
    fn take_back(&mut self, all: bool) {
        let mut queue = self.shared.queue();
        (queue.opens, queue.is_joined) = (None, false);
        if all {
            for job in queue.jobs.drain(..) {
                self.away.retain(|(id, _)| *id != job.query.id);
                self.waiting.push_back(job);
            }
        }
        self.start_tasks(queue);
        self.shared.opened.notify_all();
    }

    /// Starts tasks for the waiting jobs. At most `workers` evaluations run at once.
    fn start_tasks(&self, mut queue: MutexGuard<'_, Queue>) {
        let busy = queue.n_tasks + usize::from(queue.is_joined);
        let n = self.shared.workers.saturating_sub(busy).min(queue.jobs.len());
        queue.n_tasks += n;
        drop(queue);
        for _ in 0..n {
            let (shared, sender) = (self.shared, self.sender.clone());
            self.scope.spawn_fifo(move |_| shared.work(&sender));
        }
    }

    /// Evaluates a point on the calling thread.
    fn evaluate(&mut self, mut job: Job, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        if job.over.load(Ordering::Relaxed) {
            job.answer.clear();
        } else {
            call(self.shared.objective, &job.x, &job.query.ended_by(wait.signals), &mut job.answer);
            self.timing.evaluated(job.answer.seconds);
        }
        self.finish(job, answer)
    }

    fn finish(&mut self, mut job: Job, answer: &mut Answer) -> Polled {
        std::mem::swap(answer, &mut job.answer);
        let id = job.query.id;
        self.spare.push(job);
        Polled::Answered(id)
    }

    /// True if the calling thread takes the next point that waits.
    fn stays(&self) -> bool {
        let stays = self.timing.stays(self.waiting.len(), self.shared.workers);
        match self.here {
            OnCallingThread::AtFirst => stays.unwrap_or(true),
            OnCallingThread::WhenShort => stays.unwrap_or(false) && self.timing.is_short(),
        }
    }
}

impl Evaluator for Threads<'_, '_> {
    fn submit(&mut self, x: &[f64], query: Query<'static>) {
        let mut job = self.spare.pop().unwrap_or_else(|| Job {
            x: Vec::new(),
            query,
            answer: Answer::default(),
            over: Arc::default(),
            handed_in: Instant::now(),
            at_once: false,
        });
        job.x.clear();
        job.x.extend_from_slice(x);
        job.query = query;
        job.over.store(false, Ordering::Relaxed);
        self.waiting.push_back(job);
    }

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> Polled {
        if self.away.is_empty() {
            if self.waiting.is_empty() {
                return Polled::Idle;
            }
            if self.stays() {
                let Some(first) = self.waiting.pop_front() else { return Polled::Idle };
                let is_trial = self.timing.is_long().is_none() && !self.waiting.is_empty();
                if is_trial {
                    self.shared.queue().is_joined = true;
                    self.hand_over(Some(Instant::now() + TRIAL));
                }
                let polled = self.evaluate(first, wait, answer);
                if is_trial {
                    let n = self.away.len();
                    self.take_back(self.timing.stays(n, self.shared.workers).unwrap_or(true));
                }
                return polled;
            }
        }
        self.hand_over(None);
        match self.receiver.recv_timeout(wait.left()) {
            Ok(job) => {
                self.away.retain(|(id, _)| *id != job.query.id);
                if !job.over.load(Ordering::Relaxed) {
                    let seconds = job.answer.seconds;
                    self.timing.evaluated(seconds);
                    if job.at_once {
                        self.timing.handed_over(job.handed_in.elapsed().as_secs_f64() - seconds);
                    }
                }
                self.finish(job, answer)
            }
            Err(RecvTimeoutError::Timeout) => Polled::Waiting,
            Err(RecvTimeoutError::Disconnected) => Polled::Idle,
        }
    }

    fn cancel(&mut self, id: u64) {
        let away = self.away.iter().filter(|(of, _)| *of == id).map(|(_, over)| over);
        let waiting = self.waiting.iter().filter(|job| job.query.id == id).map(|job| &job.over);
        away.chain(waiting).for_each(|over| over.store(true, Ordering::Relaxed));
    }

    fn width(&self) -> usize {
        self.shared.workers
    }

    fn pays_ahead(&self) -> bool {
        self.shared.workers > 1 && self.timing.is_long() == Some(true)
    }

    fn cutoff_use(&self) -> CutoffUse {
        cutoff_use(self.shared.objective)
    }
}

impl Drop for Threads<'_, '_> {
    /// Cancels running evaluations, because the scope waits for them, also if the calling thread panics.
    fn drop(&mut self) {
        self.shared.queue().jobs.clear();
        self.away.iter().for_each(|(_, over)| over.store(true, Ordering::Relaxed));
        self.shared.opened.notify_all();
    }
}
