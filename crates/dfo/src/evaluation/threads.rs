//! Evaluation of the points of a run in separate thread pools with one queue.

use super::evaluator::{CutoffUse, Evaluator, PollResult, Wait, call, cutoff_use};
use super::timing::Timing;
use crate::outcome::answer::Answer;
use crate::problem::objective::{CancelSignals, Objective, Query};
use rayon::{ThreadBuilder, ThreadPool, ThreadPoolBuilder};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::{Builder, Scope};
use std::time::{Duration, Instant};

/// Maximum number of workers. A larger number is a mistake, because no machine runs so large a number of
/// threads at once.
pub(crate) const MOST_WORKERS: usize = 1 << 15;

/// Stack size of a worker thread in bytes. Compiled models put large arrays on the stack.
const STACK_SIZE: usize = 16 << 20;

/// Maximum number of threads in one pool of rayon. A thread without work searches the queues of all others
/// in its pool before it sleeps. With 1000 threads in one pool, a run takes 1.6 to 2.5 times as long as with
/// plain threads (`benches/thousand.rs`).
const MOST_IN_POOL: usize = 64;

/// Time during which only the calling thread evaluates the first points, to measure whether handing
/// over evaluations is worthwhile.
const TRIAL: Duration = Duration::from_micros(100);

/// A point with its query and answer, passed to a thread and back.
#[derive(Debug)]
struct Job {
    x: Vec<f64>,
    query: Query<'static>,
    answer: Answer,
    /// Set when the answer is no longer needed.
    over: Arc<AtomicBool>,
    handed_in: Instant,
    /// True if a thread was free when the job was submitted.
    at_once: bool,
}

#[derive(Default)]
struct Queue {
    jobs: VecDeque<Job>,
    /// Time before which no job starts.
    opens: Option<Instant>,
    /// Number of evaluations that are running, including one on the calling thread.
    n_running: usize,
    /// True when the run ends.
    is_closed: bool,
}

/// Starts the threads of a run, which end before the scope `run` does. Starts fewer threads if the system
/// does not provide the requested number.
pub(crate) fn pools<'scope>(run: &'scope Scope<'scope, '_>, workers: usize) -> Vec<ThreadPool> {
    let (mut pools, mut left, mut size) = (Vec::new(), workers, MOST_IN_POOL);
    while left > 0 && size > 0 {
        size = size.min(left);
        let first = workers - left;
        let spawn = |thread: ThreadBuilder| {
            let name = format!("dfo-worker-{}", first + thread.index());
            Builder::new().name(name).stack_size(STACK_SIZE).spawn_scoped(run, || thread.run()).map(drop)
        };
        match ThreadPoolBuilder::new().num_threads(size).spawn_handler(spawn).build() {
            Ok(pool) => {
                pools.push(pool);
                left -= size;
            }
            Err(e) => {
                log::warn!("cannot start {left} of {workers} worker threads: {e}");
                size /= 2;
            }
        }
    }
    pools
}

/// State shared by the threads of a run.
pub(crate) struct Shared<'a> {
    objective: &'a dyn Objective,
    signals: CancelSignals<'a>,
    workers: usize,
    queue: Mutex<Queue>,
    /// Notified when a job may have become ready.
    ready: Condvar,
    answered: Sender<Job>,
}

impl<'a> Shared<'a> {
    /// Evaluates on the threads of `pools` while `go` runs on the calling thread.
    pub(crate) fn run<T>(
        pools: &[ThreadPool],
        objective: &'a dyn Objective,
        signals: CancelSignals<'a>,
        here: OnCallingThread,
        go: impl FnOnce(&mut Threads<'_>) -> T,
    ) -> T {
        let workers = pools.iter().map(ThreadPool::current_num_threads).sum();
        let (answered, receiver) = channel();
        let (queue, ready) = (Mutex::default(), Condvar::new());
        let shared = Self { objective, signals, workers, queue, ready, answered };
        shared.on_all(pools, Box::new(|| go(&mut Threads::new(&shared, receiver, here))))
    }

    /// Starts [`work`](Self::work) on all threads of `pools`, then runs `go` on the calling thread.
    fn on_all<T>(&self, pools: &[ThreadPool], go: Box<dyn FnOnce() -> T + '_>) -> T {
        let Some((first, others)) = pools.split_first() else { return go() };
        first.in_place_scope(|scope| {
            scope.spawn_broadcast(|_, _| self.work());
            self.on_all(others, go)
        })
    }

    /// Locks the queue. The queue is consistent at every instant, so poisoning by a panic is ignored.
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Waits for the next job. `is_done` is true if the thread has just finished a job. `None` when the run
    /// ends.
    fn next(&self, is_done: bool) -> Option<Job> {
        let mut queue = self.queue();
        queue.n_running -= usize::from(is_done);
        while !queue.is_closed {
            let left = queue.opens.map(|opens| opens.saturating_duration_since(Instant::now()));
            let is_free = !queue.jobs.is_empty() && queue.n_running < self.workers;
            queue = match left.filter(|left| !left.is_zero()) {
                Some(left) if is_free => {
                    self.ready.wait_timeout(queue, left).unwrap_or_else(|e| e.into_inner()).0
                }
                None if is_free => {
                    queue.n_running += 1;
                    return queue.jobs.pop_front();
                }
                _ => self.ready.wait(queue).unwrap_or_else(|e| e.into_inner()),
            };
        }
        None
    }

    /// Evaluates jobs until the run ends.
    fn work(&self) {
        let mut next = self.next(false);
        while let Some(mut job) = next {
            let Job { x, query, answer, over, .. } = &mut job;
            if over.load(Ordering::Relaxed) {
                answer.clear();
            } else {
                call(self.objective, x, &query.ended_by(self.signals.with_evaluation_flag(over)), answer);
            }
            // The receiver is dropped only while the calling thread unwinds.
            let _ = self.answered.send(job);
            next = self.next(true);
        }
    }
}

/// Condition under which the calling thread also evaluates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OnCallingThread {
    /// Evaluates if evaluations are known to be short.
    WhenShort,
    /// Evaluates if evaluations are too short to be handed over. Also makes the first evaluation, to measure
    /// its duration.
    AtFirst,
}

/// Threads of a run.
pub(crate) struct Threads<'e> {
    shared: &'e Shared<'e>,
    here: OnCallingThread,
    timing: Timing,
    /// Jobs that are not handed to the threads yet.
    waiting: VecDeque<Job>,
    /// Jobs handed to the threads: id and cancel flag.
    away: Vec<(u64, Arc<AtomicBool>)>,
    spare: Vec<Job>,
    receiver: Receiver<Job>,
}

impl<'e> Threads<'e> {
    fn new(shared: &'e Shared<'e>, receiver: Receiver<Job>, here: OnCallingThread) -> Self {
        let (waiting, away, spare) = (VecDeque::new(), Vec::new(), Vec::new());
        Self { shared, here, timing: Timing::new(), waiting, away, spare, receiver }
    }

    /// Hands all waiting jobs to the threads. No job starts before `opens`.
    fn hand_over(&mut self, opens: Option<Instant>) {
        if self.waiting.is_empty() {
            return;
        }
        let n = self.waiting.len();
        let mut queue = self.shared.queue();
        queue.opens = opens;
        let now = Instant::now();
        // If the queue opens later, the waiting time of a job is not the handover time.
        let mut free = if opens.is_some() { 0 } else { self.shared.workers.saturating_sub(self.away.len()) };
        for mut job in self.waiting.drain(..) {
            (job.handed_in, job.at_once) = (now, free > 0);
            free = free.saturating_sub(1);
            self.away.push((job.query.id, Arc::clone(&job.over)));
            queue.jobs.push_back(job);
        }
        drop(queue);
        (0..n).for_each(|_| self.shared.ready.notify_one());
    }

    /// Opens the queue for the threads after the calling thread has evaluated. With `all`, takes back the
    /// jobs that have not started.
    fn take_back(&mut self, all: bool) {
        let mut queue = self.shared.queue();
        queue.opens = None;
        queue.n_running -= 1;
        if all {
            for job in queue.jobs.drain(..) {
                self.away.retain(|(id, _)| *id != job.query.id);
                self.waiting.push_back(job);
            }
        }
        drop(queue);
        self.shared.ready.notify_all();
    }

    /// Evaluates a point on the calling thread.
    fn evaluate(&mut self, mut job: Job, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        if job.over.load(Ordering::Relaxed) {
            job.answer.clear();
        } else {
            call(self.shared.objective, &job.x, &job.query.ended_by(wait.signals), &mut job.answer);
            self.timing.evaluated(job.answer.seconds);
        }
        self.finish(job, answer)
    }

    fn finish(&mut self, mut job: Job, answer: &mut Answer) -> PollResult {
        std::mem::swap(answer, &mut job.answer);
        let id = job.query.id;
        self.spare.push(job);
        PollResult::Answered(id)
    }

    /// True if the calling thread evaluates the next waiting point.
    fn stays(&self) -> bool {
        let stays = self.timing.stays(self.waiting.len(), self.shared.workers);
        match self.here {
            OnCallingThread::AtFirst => stays.unwrap_or(true),
            OnCallingThread::WhenShort => stays.unwrap_or(false) && self.timing.is_short(),
        }
    }
}

impl Evaluator for Threads<'_> {
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

    fn poll(&mut self, wait: &Wait<'_>, answer: &mut Answer) -> PollResult {
        if self.away.is_empty() {
            if self.waiting.is_empty() {
                return PollResult::Idle;
            }
            if self.stays() {
                let Some(first) = self.waiting.pop_front() else { return PollResult::Idle };
                let is_trial = self.timing.is_long().is_none() && !self.waiting.is_empty();
                if is_trial {
                    self.shared.queue().n_running += 1;
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
            Err(RecvTimeoutError::Timeout) => PollResult::Waiting,
            Err(RecvTimeoutError::Disconnected) => PollResult::Idle,
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

impl Drop for Threads<'_> {
    /// Cancels running evaluations, because the scope waits for them even if the calling thread panics.
    fn drop(&mut self) {
        self.shared.queue().is_closed = true;
        self.away.iter().for_each(|(_, over)| over.store(true, Ordering::Relaxed));
        self.shared.ready.notify_all();
    }
}
