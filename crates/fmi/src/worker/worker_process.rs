//! A worker process, as seen by its parent process.

use super::exceptions;
use super::frame::{Frame, FrameSize, PatientWriter, decode};
use super::handshake::{Arrival, Hello, Start, no_worker};
use super::input_function::answer_request;
use super::isolation::Question;
use super::load::LoadId;
use super::notes::Notes;
use super::platform::{Connection, ProcessHandle, Starter};
use super::printed::Printed;
use crate::description::Quirk;
use crate::error::{EndKind, FmiError, WorkerEnd};
use crate::sys::{Page, REFUSED};
use base::RunContext;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::io::{self, BufReader, ErrorKind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two checks for cancellation and limits during the wait for an answer.
const LOOK: Duration = Duration::from_millis(10);

/// Time allowed for the answer after the simulation of a worker has reached the time limit.
const GRACE: Duration = Duration::from_millis(250);

/// Time that a worker has to answer after cancellation. It is short because a user who has pressed Ctrl-C
/// waits for it.
const GRACE_OF_CANCELLED: Duration = Duration::from_millis(100);

/// Maximum time to spin for an answer, if there is a core for each side. Waking up takes up to 50 us on each
/// side.
const SPIN: Duration = Duration::from_millis(1);

/// Number of calls in progress in this process.
static CALLS: AtomicUsize = AtomicUsize::new(0);

static CORES: LazyLock<usize> = LazyLock::new(base::available_cores);

/// Size of the read buffer in bytes.
const BUFFER: usize = 64 << 10;

/// Reason why there is no answer.
#[derive(Debug)]
pub(super) enum NoAnswer {
    /// The call was cancelled. The process has ended if it did not answer in time.
    Cancelled,
    /// The process has ended.
    Ended(WorkerEnd),
    /// This process does not have enough memory for the answer. The worker has ended.
    Memory,
}

/// A worker process. It ends when this value is dropped.
#[derive(Debug)]
pub(super) struct Process {
    pub(super) handle: ProcessHandle,
    _place: Place,
    /// Functions that the worker does not call.
    pub(super) avoided_calls: Vec<String>,
    pub(super) channel: BufReader<Connection>,
    page: Page,
    printed: Printed,
    buffer: Vec<u8>,
    /// Process id of the parent. A child forked from the parent does not own any workers.
    owner: u32,
    has_ended: bool,
    /// Load of the worker.
    pub(super) loaded: Option<LoadId>,
    /// Quirks of the model that have not been reported.
    pub(super) quirks: Vec<Quirk>,
    pub(super) n_calls: u64,
    /// True if the worker has received a request other than loading.
    pub(super) is_used: bool,
    /// Number of requests that the worker asked to repeat.
    pub(super) n_repeated: u32,
    number: u32,
    /// Duration of the last answer.
    last_took: Duration,
    /// Memory in bytes after the first call.
    pub(super) first_size: Option<u64>,
    /// Maximum memory in bytes.
    most_memory: u64,
}

impl Process {
    /// Starts a worker; it [arrives](Self::arrive) later. `loaded` is the load of the starter.
    pub(super) fn begin(
        starter: &Arc<Starter>,
        loaded: LoadId,
        start: Start,
        place: Place,
    ) -> Result<Self, FmiError> {
        let (printed, pipe) = Printed::pipe().map_err(no_worker)?;
        let (handle, channel, page) = starter.start_worker(&start, pipe)?;
        channel.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        channel.set_write_timeout(Some(LOOK)).map_err(no_worker)?;
        Ok(Self {
            handle,
            _place: place,
            avoided_calls: start.avoided_calls,
            channel: BufReader::with_capacity(BUFFER, channel),
            page,
            printed,
            buffer: Vec::new(),
            owner: std::process::id(),
            has_ended: false,
            loaded: Some(loaded),
            quirks: Vec::new(),
            n_calls: 0,
            is_used: false,
            n_repeated: 0,
            number: 0,
            last_took: Duration::MAX,
            first_size: None,
            most_memory: start.limits.memory.unwrap_or(u64::MAX),
        })
    }

    /// Waits until the worker has arrived, at most for `longest`.
    pub(super) fn arrive(&mut self, context: &RunContext<'_>, longest: Duration) -> Result<(), FmiError> {
        let late = Instant::now() + longest;
        let Arrival { id } = self.greeting(context, late)?;
        if !self.handle.arrived(id) {
            return Err(self.handle.not_started("its process is not a child of that program"));
        }
        let Hello { has_loaded } = self.greeting(context, late)?;
        self.loaded = self.loaded.filter(|_| has_loaded);
        Ok(())
    }

    /// Receives the next message that a worker sends without a request.
    fn greeting<T: DeserializeOwned>(
        &mut self,
        context: &RunContext<'_>,
        late: Instant,
    ) -> Result<T, FmiError> {
        let mut greeting = Frame::default();
        let reported = match self.receive(context, late, &mut greeting) {
            Ok(()) if greeting.is_error => Err(greeting.head::<String>().unwrap_or_default()),
            Ok(()) => greeting.head().map_err(|error| error.to_string()),
            Err(NoAnswer::Cancelled) => return Err(FmiError::Cancelled),
            Err(NoAnswer::Ended(end)) => Err(end.to_string()),
            Err(NoAnswer::Memory) => Err("not enough memory for its first message".to_owned()),
        };
        reported.map_err(|error| self.handle.not_started(&error))
    }

    /// Sends a request and waits for the answer.
    pub(super) fn call(&mut self, question: &Question<'_>, answer: &mut Frame) -> Result<Notes, NoAnswer> {
        let Question { requested, context, limits, .. } = *question;
        self.page.set_cancelled(false);
        self.n_calls += 1;
        self.number = self.number.wrapping_add(1);
        let n_calls = Counted::one(&CALLS);
        let began = Instant::now();
        let may_spin = self.last_took < SPIN && 2 * n_calls.n <= *CORES;
        self.page.set_may_spin(may_spin);
        let (page, number) = (&self.page, self.number);
        let run_limit =
            limits.run.map(|limit| RunLimit { limit, runs: page.runs(), left: limits.runs, since: began });
        let mut watch = Watch { run_limit, ..Watch::new(page, &self.handle, self.most_memory, context) };
        let mut look = || watch.look();
        let mut to = PatientWriter { to: self.channel.get_ref(), wait: &mut look };
        let sent = requested.write(number, &mut to, &mut self.buffer);
        // If the process has ended, reading the answer fails.
        let outcome = match sent {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
            _ => {
                page.note_question(number);
                if may_spin {
                    page.wait_for_answer(number, SPIN);
                }
                loop {
                    let read = answer.read(&mut self.channel, &mut self.buffer, limits.size, &mut look);
                    if read.is_err() || !answer.is_asking {
                        break read;
                    }
                    let reported = answer_request(answer).and_then(|()| {
                        look()?;
                        let mut to = PatientWriter { to: self.channel.get_ref(), wait: &mut look };
                        answer.write(number, &mut to, &mut self.buffer)
                    });
                    match reported {
                        // If the process has ended, reading the answer fails.
                        Err(error) if error.kind() != ErrorKind::BrokenPipe => break Err(error),
                        _ => {}
                    }
                }
            }
        };
        let why = watch.why;
        outcome.map_err(|error| self.no_answer(why, &error))?;
        self.last_took = began.elapsed();
        if answer.number != self.number {
            // For example, the answer of a copy of the worker that the FMU has forked.
            return Err(NoAnswer::Ended(self.unreadable("it belongs to another request")));
        }
        if answer.notes.is_empty() {
            return Ok(Notes::default());
        }
        decode(&answer.notes).map_err(|error| NoAnswer::Ended(self.unreadable(&error.to_string())))
    }

    /// Waits for a message that the worker sends without a request.
    fn receive(&mut self, context: &RunContext<'_>, end: Instant, to: &mut Frame) -> Result<(), NoAnswer> {
        let watch = Watch::new(&self.page, &self.handle, self.most_memory, context);
        let mut watch = Watch { end: Some(end), ..watch };
        let mut look = || watch.look();
        let received = to.read(&mut self.channel, &mut self.buffer, FrameSize::of_numbers(0), &mut look);
        let why = watch.why;
        received.map_err(|error| self.no_answer(why, &error))
    }

    fn no_answer(&mut self, why: Option<KillReason>, error: &io::Error) -> NoAnswer {
        NoAnswer::Ended(match (why, error.kind()) {
            (Some(KillReason::Cancelled), _) => {
                self.kill();
                return NoAnswer::Cancelled;
            }
            (Some(KillReason::Hung), _) => self.ended(EndKind::Hung, ""),
            (Some(KillReason::Memory), _) => self.ended(EndKind::Memory, ""),
            (None, ErrorKind::OutOfMemory) => {
                self.kill();
                return NoAnswer::Memory;
            }
            (None, ErrorKind::InvalidData) => self.unreadable(&error.to_string()),
            (None, _) => self.ended(EndKind::Died, ""),
        })
    }

    /// Returns the failure of a process whose answer cannot be read.
    pub(super) fn unreadable(&mut self, why: &str) -> WorkerEnd {
        self.ended(EndKind::Garbage, why)
    }

    /// Ends the process if it is still running, and returns the reason for its end.
    #[cold]
    fn ended(&mut self, kind: EndKind, detail: &str) -> WorkerEnd {
        let last = self.page.last_call();
        // A process that has closed its channel is about to end.
        let has_died = kind == EndKind::Died && self.handle.has_ended_within(Duration::from_secs(2));
        let what = match (kind, self.kill()) {
            (EndKind::Hung, _) => "no answer within the time limit".to_owned(),
            (EndKind::Memory, _) => format!("memory limit of {} bytes exceeded", self.most_memory),
            (EndKind::Garbage, _) => format!("the answer of the worker is invalid ({detail})"),
            (EndKind::Died, _) if !has_died => "the worker closed the connection".to_owned(),
            (EndKind::Died, Some(end)) if self.page.is_without_memory() => {
                format!("{end} after an allocation beyond the memory limit of {} bytes", self.most_memory)
            }
            (EndKind::Died, Some(end)) => self.page.exception().map_or(end, exceptions::in_words),
            (EndKind::Died, None) => self.handle.unknown_end(),
        };
        let hint = self.page.is_refused().then(|| REFUSED.to_owned());
        let (function, time) = last.map_or((None, None), |last| (Some(last.function), last.time));
        WorkerEnd { kind, what, function, time, output: self.printed.last_words(), hint }
    }

    /// True if the process was ended, or if its answer was invalid.
    pub(super) fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// True if this process started the worker.
    pub(super) fn is_child(&self) -> bool {
        self.owner == std::process::id()
    }

    /// Returns the memory of the worker in bytes, if the system reports it.
    pub(super) fn size(&self) -> Option<u64> {
        self.handle.memory()
    }

    /// Ends the worker and all processes that it has started. Describes its end, if known.
    fn kill(&mut self) -> Option<String> {
        if self.has_ended || !self.is_child() {
            return None;
        }
        self.has_ended = true;
        self.handle.kill()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Numbers of the workers of a set that run at the same time.
#[derive(Debug, Clone, Default)]
pub(super) struct Places(Arc<Mutex<BTreeSet<u32>>>);

/// Number of a worker: the smallest free one.
#[derive(Debug)]
pub(super) struct Place {
    pub(super) number: u32,
    taken: Places,
}

impl Places {
    pub(super) fn take(&self) -> Place {
        let mut taken = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut number = 0;
        while !taken.insert(number) {
            number += 1;
        }
        Place { number, taken: self.clone() }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.taken.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.number);
    }
}

/// Increments a counter while it exists.
struct Counted {
    counter: &'static AtomicUsize,
    /// Value of the counter including this one.
    n: usize,
}

impl Counted {
    fn one(counter: &'static AtomicUsize) -> Self {
        Self { counter, n: counter.fetch_add(1, Ordering::Relaxed) + 1 }
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.counter.fetch_sub(1, Ordering::Relaxed);
    }
}

#[derive(Debug, Clone, Copy)]
enum KillReason {
    Cancelled,
    Hung,
    Memory,
}

/// Conditions that end the wait for an answer, measured with the clock of this process.
struct Watch<'a> {
    page: &'a Page,
    handle: &'a ProcessHandle,
    most_memory: u64,
    context: &'a RunContext<'a>,
    run_limit: Option<RunLimit>,
    /// Latest time of the answer.
    end: Option<Instant>,
    cancelled_at: Option<Instant>,
    why: Option<KillReason>,
    next_look: Instant,
}

impl<'a> Watch<'a> {
    fn new(page: &'a Page, handle: &'a ProcessHandle, most_memory: u64, context: &'a RunContext<'a>) -> Self {
        let next_look = Instant::now() + LOOK;
        let (run_limit, end, cancelled_at, why) = (None, None, None, None);
        Self { page, handle, most_memory, context, run_limit, end, cancelled_at, why, next_look }
    }

    /// Returns an error if the wait must end.
    fn look(&mut self) -> io::Result<()> {
        let now = Instant::now();
        if now < self.next_look {
            return Ok(());
        }
        self.next_look = now + LOOK;
        // Processes started by the worker may keep its end of the channel open.
        if self.handle.has_ended_within(Duration::ZERO) {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        if self.cancelled_at.is_none() && self.context.is_over() {
            self.page.set_cancelled(true);
            self.cancelled_at = Some(now);
        }
        let is_out_of_grace = self.cancelled_at.is_some_and(|since| now > since + GRACE_OF_CANCELLED);
        let runs = self.page.runs();
        let is_hung = self.run_limit.as_mut().is_some_and(|limit| limit.is_over(runs, now));
        if is_out_of_grace {
            self.why = Some(KillReason::Cancelled);
        } else if self.handle.memory().is_some_and(|size| size > self.most_memory) {
            // The system's limit does not count memory that is shared with other processes.
            self.why = Some(KillReason::Memory);
        } else if is_hung || self.end.is_some_and(|end| now > end) {
            self.why = Some(KillReason::Hung);
        }
        if self.why.is_some() { Err(ErrorKind::TimedOut.into()) } else { Ok(()) }
    }
}

/// The wall-clock limit for the simulations of a request.
struct RunLimit {
    limit: Duration,
    /// Number of simulations started at the last check, as reported by the worker.
    runs: u32,
    /// Number of simulations of the request that have not started. A worker that reports more receives no
    /// additional time.
    left: u32,
    since: Instant,
}

impl RunLimit {
    fn is_over(&mut self, runs: u32, now: Instant) -> bool {
        let begun = runs.wrapping_sub(self.runs).min(self.left);
        if begun > 0 {
            self.since = now;
        }
        (self.runs, self.left) = (runs, self.left - begun);
        // The worker also checks the limit, between two calls of the FMU.
        now > self.since + self.limit + GRACE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_limit_ignores_excess_simulations() {
        let (began, limit) = (Instant::now(), Duration::from_secs(2));
        let mut run_limit = RunLimit { limit, runs: u32::MAX, left: 2, since: began };
        let after = |seconds: f64| began + Duration::from_secs_f64(seconds);
        assert!(!run_limit.is_over(u32::MAX, after(1.0)));
        // The first simulation begins after 1.5 s, the second one after 3 s. There are no others.
        assert!(!run_limit.is_over(0, after(1.5)) && !run_limit.is_over(1, after(3.0)));
        assert!(!run_limit.is_over(2, after(5.0)) && run_limit.is_over(3, after(5.3)));
    }
}
