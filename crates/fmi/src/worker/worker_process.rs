//! One worker process, as the process sees it that has started it.

use super::end::{ProcessEnd, in_words};
use super::fork_server::{Hello, Start, Template, no_worker};
use super::frame::{Frame, decode};
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
use std::collections::BTreeSet;
use std::io::{BufReader, ErrorKind};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process::ExitStatus;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

/// Time between two checks for cancellation and limits while an answer is awaited.
const LOOK: Duration = Duration::from_millis(10);

/// A worker whose simulation has reached its time limit has so long to answer.
const GRACE: Duration = Duration::from_millis(250);

/// One that was asked to end what it does has so long: whoever has pressed Ctrl-C waits for it.
const GRACE_OF_CANCELLED: Duration = Duration::from_millis(100);

/// An answer that comes within this time is waited for without sleeping, as long as there is a core for each
/// side: to wake up takes up to 50 us, on each side.
const SPIN: Duration = Duration::from_millis(1);

/// Calls under way in this process.
static CALLS: AtomicUsize = AtomicUsize::new(0);

static CORES: LazyLock<usize> = LazyLock::new(|| available_parallelism().map_or(1, usize::from));

/// Bytes that are read at once.
const BUFFER: usize = 64 << 10;

/// Why there is no answer.
#[derive(Debug)]
pub(super) enum NoAnswer {
    /// It was cancelled; the process has ended, if it did not answer in time.
    Cancelled,
    /// The process has ended.
    Ended(WorkerEnd),
}

/// A worker process. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Process {
    /// `None` before it has said that it is there.
    pid: Option<Pid>,
    /// Its number among those of the template.
    number_of_worker: u32,
    _place: Place,
    /// Functions that it does not call.
    pub(super) avoided_calls: Vec<String>,
    template: Arc<Template>,
    end: ProcessEnd,
    socket: BufReader<UnixStream>,
    page: Page,
    printed: Printed,
    buffer: Vec<u8>,
    /// The process that has started it: a child that was forked meanwhile has no workers.
    owner: u32,
    has_ended: bool,
    /// The problem that it has loaded.
    pub(super) loaded: Option<LoadId>,
    /// Quirks of the model that nobody has been told of.
    pub(super) quirks: Vec<Quirk>,
    pub(super) n_calls: u64,
    number: u32,
    /// Time that the last answer took.
    last_took: Duration,
    /// Bytes in memory after the first call.
    pub(super) first_size: Option<u64>,
    /// Bytes that it may have in memory.
    most_memory: u64,
}

impl Process {
    /// Has one started; it [arrives](Self::arrive) later.
    pub(super) fn begin(
        template: &Arc<Template>,
        limits: &WorkerLimits,
        is_prepared: bool,
        surroundings: Surroundings,
        avoided_calls: &[String],
    ) -> Result<Self, FmiError> {
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        socket.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        let (page, file) = Page::new().map_err(no_worker)?;
        let (printed, pipe) = Printed::pipe().map_err(no_worker)?;
        let (level, place) = (log::max_level(), Place::take());
        let start = Start {
            number: 0,
            limits: *limits,
            level,
            is_prepared,
            surroundings,
            avoided_calls: avoided_calls.to_vec(),
            place: place.0,
        };
        let (number_of_worker, loaded) =
            template.begin_worker(start, [theirs.as_fd(), file.as_fd(), pipe.as_fd()])?;
        // It holds the other ends.
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
            number: 0,
            last_took: Duration::MAX,
            first_size: None,
            most_memory: limits.memory.unwrap_or(u64::MAX),
        })
    }

    /// Waits until it is there, no longer than so.
    pub(super) fn arrive(&mut self, context: &RunContext<'_>, longest: Duration) -> Result<(), FmiError> {
        let (mut hello, late) = (Frame::default(), Some(Instant::now() + longest));
        let said = match self.receive(&mut hello, context, &mut None, late) {
            Ok(()) if hello.is_error => Err(hello.head::<String>().unwrap_or_default()),
            Ok(()) => hello.head::<Hello>().map_err(|error| error.to_string()),
            Err(NoAnswer::Cancelled) => return Err(FmiError::Cancelled),
            Err(NoAnswer::Ended(end)) => Err(end.to_string()),
        };
        let Hello { pid, has_loaded } = said.map_err(|error| self.template.without_worker(&error))?;
        self.pid = Pid::from_raw(pid);
        self.end = self.pid.map(ProcessEnd::of).unwrap_or_default();
        self.loaded = self.loaded.filter(|_| has_loaded);
        Ok(())
    }

    /// Asks for something and waits for the answer. `run_limit`: the wall-clock time of a single simulation.
    pub(super) fn call(
        &mut self,
        asked: &Frame,
        answer: &mut Frame,
        context: &RunContext<'_>,
        run_limit: Option<Duration>,
    ) -> Result<Notes, NoAnswer> {
        self.page.set_cancelled(false);
        self.n_calls += 1;
        self.number = self.number.wrapping_add(1);
        let began = Instant::now();
        let n_calls = Counted::one(&CALLS);
        let may_spin = self.last_took < SPIN && 2 * n_calls.n <= *CORES;
        let sent = asked.write(self.number, &mut self.socket.get_ref(), &mut self.buffer);
        self.page.note_question(self.number, may_spin);
        // What cannot be sent shows in the answer.
        let mut limit = run_limit.map(|limit| RunLimit { limit, runs: self.page.runs(), since: began });
        if let Err(error) = sent
            && error.kind() != ErrorKind::BrokenPipe
        {
            return Err(NoAnswer::Ended(self.ended(EndKind::Garbage, &error.to_string())));
        }
        if may_spin {
            self.page.wait_for_answer(self.number, SPIN);
        }
        self.receive(answer, context, &mut limit, None)?;
        self.last_took = began.elapsed();
        if answer.number != self.number {
            // Of a copy of the worker, for example, that the FMU has made.
            return Err(NoAnswer::Ended(self.ended(EndKind::Garbage, "the answer to another question")));
        }
        if answer.notes.is_empty() {
            return Ok(Notes::default());
        }
        decode(&answer.notes)
            .map_err(|error| NoAnswer::Ended(self.ended(EndKind::Garbage, &error.to_string())))
    }

    fn receive(
        &mut self,
        answer: &mut Frame,
        context: &RunContext<'_>,
        limit: &mut Option<RunLimit>,
        end: Option<Instant>,
    ) -> Result<(), NoAnswer> {
        let (page, end_of, pid, most_memory) = (&self.page, &self.end, self.pid, self.most_memory);
        let (mut asked_to_end, mut why) = (None::<Instant>, None);
        let mut wait = || {
            let now = Instant::now();
            // Processes that it has started may keep its end of the socket open.
            if end_of.is_over_within(Duration::ZERO) {
                return Err(ErrorKind::UnexpectedEof.into());
            }
            if asked_to_end.is_none() && context.is_over() {
                page.set_cancelled(true);
                asked_to_end = Some(now);
            }
            let is_out_of_grace = asked_to_end.is_some_and(|since| now > since + GRACE_OF_CANCELLED);
            let is_hung = limit.as_mut().is_some_and(|limit| limit.is_over(page.runs(), now));
            if is_out_of_grace {
                why = Some(KillReason::Cancelled);
            } else if pid.and_then(size_of).is_some_and(|size| size > most_memory) {
                // What it shares with others the system's limit does not count.
                why = Some(KillReason::Memory);
            } else if is_hung || end.is_some_and(|end| now > end) {
                why = Some(KillReason::Hung);
            }
            if why.is_some() { Err(ErrorKind::TimedOut.into()) } else { Ok(()) }
        };
        let received = answer.read(&mut self.socket, &mut self.buffer, &mut wait);
        let Err(error) = received else { return Ok(()) };
        Err(match (why, error.kind()) {
            (Some(KillReason::Cancelled), _) => {
                self.kill();
                NoAnswer::Cancelled
            }
            (Some(KillReason::Hung), _) => NoAnswer::Ended(self.ended(EndKind::Hung, "")),
            (Some(KillReason::Memory), _) => NoAnswer::Ended(self.ended(EndKind::Memory, "")),
            (None, ErrorKind::InvalidData) => {
                NoAnswer::Ended(self.ended(EndKind::Garbage, &error.to_string()))
            }
            (None, _) => NoAnswer::Ended(self.ended(EndKind::Died, "")),
        })
    }

    /// Why the process is gone, after it was ended if it is not.
    #[cold]
    fn ended(&mut self, kind: EndKind, detail: &str) -> WorkerEnd {
        let last = self.page.last_call();
        // A process that has closed its socket is about to end.
        let has_died = kind == EndKind::Died && self.end.is_over_within(Duration::from_secs(2));
        let status = self.kill();
        let what = match (kind, status) {
            (EndKind::Hung, _) => "no answer within the time limit".to_owned(),
            (EndKind::Memory, _) => format!("more memory than its limit of {} bytes", self.most_memory),
            (EndKind::Garbage, _) => format!("garbage instead of an answer ({detail})"),
            (EndKind::Died, _) if !has_died => "it has closed the connection".to_owned(),
            (EndKind::Died, Some(status)) if self.page.is_without_memory() => {
                let limit = self.most_memory;
                format!("{} after an allocation beyond the memory limit of {limit} bytes", in_words(status))
            }
            (EndKind::Died, Some(status)) => in_words(status),
            // Its status was for the template.
            (EndKind::Died, None) => format!(
                "the process ended; how is not known, for the process that it was copied from had ended before: {}",
                self.template.end_in_words().unwrap_or_else(|| "it does not answer".to_owned())
            ),
        };
        let hint = self.page.is_refused().then(|| REFUSED.to_owned());
        let (function, time) = last.map_or((None, None), |last| (Some(last.function), last.time));
        WorkerEnd { kind, what, function, time, output: self.printed.last_words(), hint }
    }

    /// True if it was ended, or its answer was not valid.
    pub(super) fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Bytes that it has in memory, where the system tells.
    pub(super) fn size(&self) -> Option<u64> {
        self.pid.and_then(size_of)
    }

    /// Ends it, and all processes that it has started; how it has ended.
    fn kill(&mut self) -> Option<ExitStatus> {
        if self.has_ended || self.owner != std::process::id() {
            return None;
        }
        self.has_ended = true;
        if self.template.is_over() {
            return None;
        }
        let status = self.template.end_worker(self.number_of_worker);
        if let Some(pid) = self.pid.filter(|_| status.is_none() && !self.end.is_over_within(Duration::ZERO)) {
            // The template has ended.
            let _ = kill_process(pid, Signal::KILL);
            self.end.is_over_within(Duration::from_secs(1));
        }
        status
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Bytes that a process has in memory, where the system tells.
fn size_of(pid: Pid) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{}/statm", pid.as_raw_nonzero())).ok()?;
    let pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}

/// Number of a worker among those of this program that run at the same time: the smallest that is free.
#[derive(Debug)]
struct Place(u32);

static TAKEN: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

impl Place {
    fn take() -> Self {
        let mut taken = TAKEN.lock().unwrap_or_else(PoisonError::into_inner);
        let mut place = 0;
        while !taken.insert(place) {
            place += 1;
        }
        Self(place)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        TAKEN.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.0);
    }
}

/// One more, as long as it lives.
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

/// The wall-clock limit of the simulations of an evaluation.
struct RunLimit {
    limit: Duration,
    /// Simulations begun when it was looked at last.
    runs: u32,
    since: Instant,
}

impl RunLimit {
    fn is_over(&mut self, runs: u32, now: Instant) -> bool {
        if runs != self.runs {
            (self.runs, self.since) = (runs, now);
        }
        // The worker looks at the limit itself, between two calls of the FMU.
        now > self.since + self.limit + GRACE
    }
}
