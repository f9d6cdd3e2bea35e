//! A worker process, as seen by its parent process.

use super::end::{ProcessEnd, in_words};
use super::fork_server::{Arrival, Hello, Start, Template, no_worker};
use super::frame::{Frame, FrameSize, PatientWriter, decode};
use super::input_function::answer_wanted;
use super::isolation::Question;
use super::limits::WorkerLimits;
use super::load::LoadId;
use super::notes::Notes;
use super::printed::Printed;
use super::surroundings::Surroundings;
use crate::description::Quirk;
use crate::error::{EndKind, FmiError, WorkerEnd};
use crate::sys::{Page, REFUSED};
use base::RunContext;
use rustix::process::{Pid, Signal, kill_process};
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::io::{self, BufReader, ErrorKind};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process::ExitStatus;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two checks for cancellation and limits while an answer is awaited.
const LOOK: Duration = Duration::from_millis(10);

/// Time that a worker has to answer after its simulation has reached the time limit.
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
    /// Process id; `None` before the worker has arrived.
    pid: Option<Pid>,
    /// Number of the worker among the workers of its template.
    number_of_worker: u32,
    _place: Place,
    /// Functions that the worker does not call.
    pub(super) avoided_calls: Vec<String>,
    template: Arc<Template>,
    end: ProcessEnd,
    socket: BufReader<UnixStream>,
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
    /// Starts a worker; it [arrives](Self::arrive) later.
    pub(super) fn begin(
        template: &Arc<Template>,
        limits: &WorkerLimits,
        is_prepared: bool,
        surroundings: Surroundings,
        avoided_calls: &[String],
        places: &Places,
    ) -> Result<Self, FmiError> {
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        socket.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        socket.set_write_timeout(Some(LOOK)).map_err(no_worker)?;
        let (page, file) = Page::new().map_err(no_worker)?;
        let (printed, pipe) = Printed::pipe().map_err(no_worker)?;
        let (level, place) = (log::max_level(), places.take());
        let start = Start {
            number: 0,
            limits: *limits,
            level,
            is_prepared,
            surroundings,
            avoided_calls: avoided_calls.to_vec(),
            place: place.number,
        };
        let (number_of_worker, loaded) =
            template.begin_worker(start, [theirs.as_fd(), file.as_fd(), pipe.as_fd()])?;
        // The child has the other ends.
        Ok(Self {
            pid: None,
            number_of_worker,
            _place: place,
            avoided_calls: avoided_calls.to_vec(),
            template: Arc::clone(template),
            end: ProcessEnd::default(),
            socket: BufReader::with_capacity(BUFFER, socket),
            page,
            printed,
            buffer: Vec::new(),
            owner: std::process::id(),
            has_ended: false,
            loaded,
            quirks: Vec::new(),
            n_calls: 0,
            is_used: false,
            n_repeated: 0,
            number: 0,
            last_took: Duration::MAX,
            first_size: None,
            most_memory: limits.memory.unwrap_or(u64::MAX),
        })
    }

    /// Waits until the worker has arrived, at most for `longest`.
    pub(super) fn arrive(&mut self, context: &RunContext<'_>, longest: Duration) -> Result<(), FmiError> {
        let late = Instant::now() + longest;
        let Arrival { pid } = self.greeting(context, late)?;
        // A number below 1 would refer to several processes (kill(2)).
        let pid = Some(pid).filter(|pid| *pid > 0).and_then(Pid::from_raw);
        let Some(pid) = pid.filter(|pid| self.template.is_parent_of(*pid)) else {
            return Err(self.template.without_worker("its process is no child of that program"));
        };
        self.pid = Some(pid);
        self.end = ProcessEnd::of(pid);
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
        let said = match self.receive(context, late, &mut greeting) {
            Ok(()) if greeting.is_error => Err(greeting.head::<String>().unwrap_or_default()),
            Ok(()) => greeting.head().map_err(|error| error.to_string()),
            Err(NoAnswer::Cancelled) => return Err(FmiError::Cancelled),
            Err(NoAnswer::Ended(end)) => Err(end.to_string()),
            Err(NoAnswer::Memory) => Err("no memory for its greeting".to_owned()),
        };
        said.map_err(|error| self.template.without_worker(&error))
    }

    /// Sends a request and waits for the answer.
    pub(super) fn call(&mut self, question: &Question<'_>, answer: &mut Frame) -> Result<Notes, NoAnswer> {
        let Question { asked, context, limits, .. } = *question;
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
        let whose = (self.pid, self.most_memory);
        let mut watch = Watch::new(page, &self.end, whose, context, run_limit, None);
        let mut look = || watch.look();
        let mut to = PatientWriter { to: self.socket.get_ref(), wait: &mut look };
        let sent = asked.write(number, &mut to, &mut self.buffer);
        // If the process has ended, reading the answer fails.
        let outcome = match sent {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
            _ => {
                page.note_question(number);
                if may_spin {
                    page.wait_for_answer(number, SPIN);
                }
                loop {
                    let read = answer.read(&mut self.socket, &mut self.buffer, limits.size, &mut look);
                    if read.is_err() || !answer.is_asking {
                        break read;
                    }
                    let told = answer_wanted(answer).and_then(|()| {
                        look()?;
                        let mut to = PatientWriter { to: self.socket.get_ref(), wait: &mut look };
                        answer.write(number, &mut to, &mut self.buffer)
                    });
                    match told {
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
            return Err(NoAnswer::Ended(self.unreadable("it is the answer to another question")));
        }
        if answer.notes.is_empty() {
            return Ok(Notes::default());
        }
        decode(&answer.notes).map_err(|error| NoAnswer::Ended(self.unreadable(&error.to_string())))
    }

    /// Waits for a message that the worker sends without a request.
    fn receive(&mut self, context: &RunContext<'_>, end: Instant, to: &mut Frame) -> Result<(), NoAnswer> {
        let whose = (self.pid, self.most_memory);
        let mut watch = Watch::new(&self.page, &self.end, whose, context, None, Some(end));
        let mut look = || watch.look();
        let received = to.read(&mut self.socket, &mut self.buffer, FrameSize::of_numbers(0), &mut look);
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

    /// Returns the end of a process whose answer cannot be read.
    pub(super) fn unreadable(&mut self, why: &str) -> WorkerEnd {
        self.ended(EndKind::Garbage, why)
    }

    /// Ends the process if it is still running, and returns the reason for its end.
    #[cold]
    fn ended(&mut self, kind: EndKind, detail: &str) -> WorkerEnd {
        let last = self.page.last_call();
        // A process that has closed its socket is about to end.
        let has_died = kind == EndKind::Died && self.end.is_over_within(Duration::from_secs(2));
        let status = self.kill();
        let what = match (kind, status) {
            (EndKind::Hung, _) => "no answer within the time limit".to_owned(),
            (EndKind::Memory, _) => format!("more memory than its limit of {} bytes", self.most_memory),
            (EndKind::Garbage, _) => format!("the worker's answer could not be read ({detail})"),
            (EndKind::Died, _) if !has_died => "it has closed the connection".to_owned(),
            (EndKind::Died, Some(status)) if self.page.is_without_memory() => {
                let limit = self.most_memory;
                format!("{} after an allocation beyond the memory limit of {limit} bytes", in_words(status))
            }
            (EndKind::Died, Some(status)) => in_words(status),
            // The template received the exit status.
            (EndKind::Died, None) => format!(
                "the process ended; how is not known, for the process that it was copied from had ended before: {}",
                self.template.end_in_words().unwrap_or_else(|| "it does not answer".to_owned())
            ),
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
    pub(super) fn is_own(&self) -> bool {
        self.owner == std::process::id()
    }

    /// Returns the memory of the worker in bytes, if the system reports it.
    pub(super) fn size(&self) -> Option<u64> {
        self.pid.and_then(size_of)
    }

    /// Ends the worker and all processes that it has started. Returns its exit status.
    fn kill(&mut self) -> Option<ExitStatus> {
        if self.has_ended || !self.is_own() {
            return None;
        }
        self.has_ended = true;
        if self.template.is_over() {
            return None;
        }
        let status = self.template.end_worker(self.number_of_worker);
        if status.is_none() {
            // The template has ended.
            if let Some(pid) = self.pid.filter(|_| !self.end.is_over_within(Duration::ZERO)) {
                let _ = kill_process(pid, Signal::KILL);
                self.end.is_over_within(Duration::from_secs(1));
            }
            self.template.remove_folder(self.number_of_worker);
        }
        status
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Returns the memory of a process in bytes, if the system reports it.
fn size_of(pid: Pid) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{}/statm", pid.as_raw_nonzero())).ok()?;
    let pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}

/// Numbers of the workers of a set that run at the same time.
#[derive(Debug, Clone, Default)]
pub(super) struct Places(Arc<Mutex<BTreeSet<u32>>>);

/// Number of a worker: the smallest free one.
#[derive(Debug)]
struct Place {
    number: u32,
    taken: Places,
}

impl Places {
    fn take(&self) -> Place {
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
    end_of: &'a ProcessEnd,
    pid: Option<Pid>,
    most_memory: u64,
    context: &'a RunContext<'a>,
    run_limit: Option<RunLimit>,
    /// Latest time of the answer.
    end: Option<Instant>,
    asked_to_end: Option<Instant>,
    why: Option<KillReason>,
    next_look: Instant,
}

impl<'a> Watch<'a> {
    fn new(
        page: &'a Page,
        end_of: &'a ProcessEnd,
        (pid, most_memory): (Option<Pid>, u64),
        context: &'a RunContext<'a>,
        run_limit: Option<RunLimit>,
        end: Option<Instant>,
    ) -> Self {
        let next_look = Instant::now() + LOOK;
        Self {
            page,
            end_of,
            pid,
            most_memory,
            context,
            run_limit,
            end,
            asked_to_end: None,
            why: None,
            next_look,
        }
    }

    /// Returns an error if the wait must end.
    fn look(&mut self) -> io::Result<()> {
        let now = Instant::now();
        if now < self.next_look {
            return Ok(());
        }
        self.next_look = now + LOOK;
        // Processes started by the worker may keep its end of the socket open.
        if self.end_of.is_over_within(Duration::ZERO) {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        if self.asked_to_end.is_none() && self.context.is_over() {
            self.page.set_cancelled(true);
            self.asked_to_end = Some(now);
        }
        let is_out_of_grace = self.asked_to_end.is_some_and(|since| now > since + GRACE_OF_CANCELLED);
        let runs = self.page.runs();
        let is_hung = self.run_limit.as_mut().is_some_and(|limit| limit.is_over(runs, now));
        if is_out_of_grace {
            self.why = Some(KillReason::Cancelled);
        } else if self.pid.and_then(size_of).is_some_and(|size| size > self.most_memory) {
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
    use crate::worker::Launcher;

    #[test]
    fn worker_must_be_child_of_template() {
        let template = Arc::new(Template::start(&Launcher::of("/bin/cat")).unwrap());
        let mut process = Process::begin(
            &template,
            &WorkerLimits::default(),
            false,
            Surroundings::present(),
            &[],
            &Places::default(),
        )
        .unwrap();
        let context = RunContext::new();
        for pid in [-1, 0, i32::MIN, 1, std::process::id().cast_signed()] {
            let (socket, theirs) = UnixStream::pair().unwrap();
            process.socket = BufReader::new(socket);
            Frame::of(&Arrival { pid }).unwrap().write(0, &mut &theirs, &mut Vec::new()).unwrap();
            let error = process.arrive(&context, Duration::from_secs(10)).unwrap_err().to_string();
            assert!(error.contains("its process is no child of that program"), "{pid}: {error}");
            assert_eq!(process.pid, None, "{pid}");
        }
        template.end();
    }

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
