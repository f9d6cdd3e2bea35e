//! One worker process, as the process sees it that has started it.

use super::frame::{Frame, decode};
use super::limits::WorkerLimits;
use super::notes::Notes;
use super::printed::Printed;
use super::template::{Template, no_worker};
use crate::description::Quirk;
use crate::error::{EndKind, FmiError, WorkerEnd};
use crate::sys::Page;
use base::RunContext;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufReader, ErrorKind};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

/// Time between two checks for cancellation and limits while an answer is awaited.
const LOOK: Duration = Duration::from_millis(10);

/// A worker that was asked to end what it does, or whose simulation has reached its time limit, has so long
/// to answer.
const GRACE: Duration = Duration::from_millis(250);

/// A worker is there after this time.
const START: Duration = Duration::from_secs(60);

/// An answer that comes within this time is waited for without sleeping, as long as there is a core for each
/// side: to wake up takes up to 50 us.
const SPIN: Duration = Duration::from_micros(200);

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
    pid: Pid,
    /// Its number among those of the template.
    number_of_worker: u32,
    template: Arc<Template>,
    /// Readable when it has ended; `None` where the system has no such thing.
    end: Option<OwnedFd>,
    socket: BufReader<UnixStream>,
    page: Page,
    printed: Printed,
    buffer: Vec<u8>,
    /// The process that has started it: a child that was forked meanwhile has no workers.
    owner: u32,
    has_ended: bool,
    /// The problem that it has loaded.
    pub(super) loaded: Option<u64>,
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
    /// Starts one, and waits until it is there.
    pub(super) fn start(
        template: &Arc<Template>,
        limits: &WorkerLimits,
        context: &RunContext<'_>,
    ) -> Result<Self, FmiError> {
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        socket.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        let (page, file) = Page::new().map_err(no_worker)?;
        let (printed, pipe) = Printed::pipe().map_err(no_worker)?;
        let worker = template.worker(limits, [theirs.as_fd(), file.as_fd(), pipe.as_fd()], context)?;
        // It holds the other ends.
        drop((theirs, pipe));
        let mut process = Self {
            pid: worker.pid,
            number_of_worker: worker.number,
            template: Arc::clone(template),
            end: end_of(worker.pid),
            socket: BufReader::with_capacity(BUFFER, socket),
            page,
            printed,
            buffer: Vec::new(),
            owner: std::process::id(),
            has_ended: false,
            loaded: worker.loaded,
            quirks: Vec::new(),
            n_calls: 0,
            number: 0,
            last_took: Duration::MAX,
            first_size: None,
            most_memory: limits.memory.unwrap_or(u64::MAX),
        };
        let (began, mut none) = (Instant::now(), None);
        match process.receive(&mut Frame::default(), context, &mut none, Some(began + START)) {
            Ok(()) => Ok(process),
            Err(NoAnswer::Cancelled) => Err(FmiError::Cancelled),
            Err(NoAnswer::Ended(end)) => Err(FmiError::NoWorker { reason: end.to_string() }),
        }
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
        let (page, end_of, pid, most_memory) = (&self.page, self.end.as_ref(), self.pid, self.most_memory);
        let (mut asked_to_end, mut why) = (None::<Instant>, None);
        let mut wait = || {
            let now = Instant::now();
            // Processes that it has started may keep its end of the socket open.
            if is_over_within(end_of, Duration::ZERO) {
                return Err(ErrorKind::UnexpectedEof.into());
            }
            if asked_to_end.is_none() && context.is_over() {
                page.set_cancelled(true);
                asked_to_end = Some(now);
            }
            let is_out_of_grace = asked_to_end.is_some_and(|since| now > since + GRACE);
            let is_hung = limit.as_mut().is_some_and(|limit| limit.is_over(page.runs(), now));
            if is_out_of_grace {
                why = Some(Stop::Cancelled);
            } else if size_of(pid).is_some_and(|size| size > most_memory) {
                // What it shares with others the system's limit does not count.
                why = Some(Stop::Memory);
            } else if is_hung || end.is_some_and(|end| now > end) {
                why = Some(Stop::Hung);
            }
            if why.is_some() { Err(ErrorKind::TimedOut.into()) } else { Ok(()) }
        };
        let received = answer.read(&mut self.socket, &mut self.buffer, &mut wait);
        let Err(error) = received else { return Ok(()) };
        Err(match (why, error.kind()) {
            (Some(Stop::Cancelled), _) => {
                self.kill();
                NoAnswer::Cancelled
            }
            (Some(Stop::Hung), _) => NoAnswer::Ended(self.ended(EndKind::Hung, "")),
            (Some(Stop::Memory), _) => NoAnswer::Ended(self.ended(EndKind::Memory, "")),
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
        let has_died = kind == EndKind::Died && is_over_within(self.end.as_ref(), Duration::from_secs(2));
        let status = self.kill().filter(|_| has_died);
        let what = match (kind, status) {
            (EndKind::Hung, _) => "no answer within the time limit".to_owned(),
            (EndKind::Memory, _) => format!("more memory than its limit of {} bytes", self.most_memory),
            (EndKind::Garbage, _) => format!("garbage instead of an answer ({detail})"),
            (EndKind::Died, None) => "no connection any more".to_owned(),
            (EndKind::Died, Some(status)) => in_words(status),
        };
        let (function, time) = last.map_or((None, None), |last| (Some(last.function), last.time));
        WorkerEnd { kind, what, function, time, output: self.printed.last_words() }
    }

    /// True if it was ended, or its answer was not valid.
    pub(super) fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Bytes that it has in memory, where the system tells.
    pub(super) fn size(&self) -> Option<u64> {
        size_of(self.pid)
    }

    /// Ends it, and all processes that it has started; how it has ended.
    fn kill(&mut self) -> Option<ExitStatus> {
        if self.has_ended || self.owner != std::process::id() {
            return None;
        }
        self.has_ended = true;
        let status = self.template.end(self.number_of_worker);
        if status.is_none() && !is_over_within(self.end.as_ref(), Duration::ZERO) {
            // The template has ended.
            let _ = kill_process(self.pid, Signal::KILL);
            is_over_within(self.end.as_ref(), Duration::from_secs(1));
        }
        status
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Readable when a process has ended, which keeps its number until the template is told to end it.
#[cfg(target_os = "linux")]
fn end_of(pid: Pid) -> Option<OwnedFd> {
    rustix::process::pidfd_open(pid, rustix::process::PidfdFlags::empty()).ok()
}

#[cfg(not(target_os = "linux"))]
fn end_of(_: Pid) -> Option<OwnedFd> {
    None
}

/// True if a process ends within this time. Where nothing tells, only its socket does, and it ends soon after
/// that.
fn is_over_within(end: Option<&OwnedFd>, longest: Duration) -> bool {
    let Some(end) = end else {
        std::thread::sleep(longest.min(LOOK));
        return !longest.is_zero();
    };
    let longest = Timespec { tv_sec: longest.as_secs() as i64, tv_nsec: longest.subsec_nanos().into() };
    matches!(poll(&mut [PollFd::new(end, PollFlags::IN)], Some(&longest)), Ok(n) if n > 0)
}

/// Bytes that a process has in memory, where the system tells.
fn size_of(pid: Pid) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{}/statm", pid.as_raw_nonzero())).ok()?;
    let pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
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
enum Stop {
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

fn in_words(status: ExitStatus) -> String {
    let signal = status.signal();
    match (signal, status.code()) {
        (Some(libc::SIGSEGV), _) => "segmentation fault".to_owned(),
        (Some(libc::SIGABRT), _) => "abort".to_owned(),
        (Some(libc::SIGBUS), _) => "bus error".to_owned(),
        (Some(libc::SIGFPE), _) => "arithmetic exception".to_owned(),
        (Some(libc::SIGILL), _) => "illegal instruction".to_owned(),
        (Some(libc::SIGKILL), _) => "killed from outside, or for want of memory".to_owned(),
        (Some(libc::SIGXCPU | libc::SIGXFSZ), _) => "a limit of resources was reached".to_owned(),
        (Some(signal), _) => format!("signal {signal}"),
        (None, Some(code)) => format!("the process was ended with exit({code})"),
        (None, None) => "the process ended".to_owned(),
    }
}
