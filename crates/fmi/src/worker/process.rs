//! One worker process, as the process sees it that has started it.

use super::folder::{Folder, kill_processes_of};
use super::frame::{Frame, decode};
use super::launcher::Launcher;
use super::limits::WorkerLimits;
use super::notes::Notes;
use super::settings::{ASKED, FOLDER, LEVEL, VERSION};
use crate::description::Quirk;
use crate::error::{EndKind, FmiError, WorkerEnd};
use crate::sys::Page;
use base::RunContext;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use std::collections::VecDeque;
use std::io::{self, BufReader, ErrorKind, Read};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::thread::JoinHandle;
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

/// Bytes that are kept of what it prints.
const PRINTED: usize = 16 << 10;

/// Of these, characters that an error carries.
const PRINTED_IN_ERRORS: usize = 400;

/// Why there is no answer.
#[derive(Debug)]
pub(super) enum NoAnswer {
    /// It was cancelled; the process has ended, if it did not answer in time.
    Cancelled,
    /// The process has ended.
    Ended(WorkerEnd),
}

/// So long the last that a process printed is waited for after its end.
const LAST_WORDS: Duration = Duration::from_millis(100);

/// A worker process. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    socket: BufReader<UnixStream>,
    page: Page,
    printed: Arc<Mutex<VecDeque<u8>>>,
    /// The thread that reads it, until all who could print have ended.
    reader: Option<JoinHandle<()>>,
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
    /// Removed last: while files are open, it may be impossible.
    folder: Folder,
}

impl Process {
    /// Starts one, and waits until it is there.
    pub(super) fn start(
        launcher: &Launcher,
        limits: &WorkerLimits,
        context: &RunContext<'_>,
    ) -> Result<Self, FmiError> {
        let no_worker = |error: io::Error| FmiError::NoWorker { reason: error.to_string() };
        let folder = Folder::named();
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        socket.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        let (page, file) = Page::new().map_err(no_worker)?;
        let mut command = Command::new(&launcher.program);
        command
            .args(&launcher.arguments)
            .env(ASKED, limits.as_text())
            .env(FOLDER, folder.path())
            .env(LEVEL, log::max_level().as_str())
            .env("TMPDIR", folder.path())
            .stdin(OwnedFd::from(theirs))
            .stdout(file)
            .stderr(Stdio::piped())
            // Ctrl-C in a terminal goes to all processes of a group.
            .process_group(0);
        let child = command.spawn().map_err(|error| FmiError::NoWorker {
            reason: format!("{}: {error}", launcher.program.display()),
        })?;
        // It holds the other end of the socket.
        drop(command);
        let mut process = Self {
            child,
            socket: BufReader::with_capacity(BUFFER, socket),
            page,
            printed: Arc::default(),
            reader: None,
            buffer: Vec::new(),
            owner: std::process::id(),
            has_ended: false,
            loaded: None,
            quirks: Vec::new(),
            n_calls: 0,
            number: 0,
            last_took: Duration::MAX,
            first_size: None,
            most_memory: limits.memory.unwrap_or(u64::MAX),
            folder,
        };
        if let Some(output) = process.child.stderr.take() {
            let printed = Arc::clone(&process.printed);
            // Without it the process waits when the pipe is full.
            let reader = std::thread::Builder::new().name("fmufit-worker-output".to_owned());
            process.reader = Some(reader.spawn(move || keep_printed(output, &printed)).map_err(no_worker)?);
        }
        let mut hello = Frame::default();
        let (began, mut none) = (Instant::now(), None);
        let answered = process.receive(&mut hello, context, &mut none, Some(began + START));
        match answered {
            Ok(()) if hello.head::<String>().is_ok_and(|version| version == VERSION) => Ok(process),
            Ok(()) => {
                let version = hello.head::<String>().unwrap_or_default();
                let reason = format!("the program to be started serves version {version:?}, not {}", VERSION);
                Err(FmiError::NoWorker { reason })
            }
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
        let (page, child, most_memory) = (&self.page, &self.child, self.most_memory);
        let (mut asked_to_end, mut why) = (None::<Instant>, None);
        let mut wait = || {
            let now = Instant::now();
            // Processes that it has started may keep its end of the socket open.
            if is_over(child) {
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
            } else if size_of(child).is_some_and(|size| size > most_memory) {
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
        let has_died = kind == EndKind::Died && self.is_over_within(Duration::from_secs(2));
        let status = self.kill().filter(|_| has_died);
        let what = match (kind, status) {
            (EndKind::Hung, _) => "no answer within the time limit".to_owned(),
            (EndKind::Memory, _) => format!("more memory than its limit of {} bytes", self.most_memory),
            (EndKind::Garbage, _) => format!("garbage instead of an answer ({detail})"),
            (EndKind::Died, None) => "no connection any more".to_owned(),
            (EndKind::Died, Some(status)) => in_words(status),
        };
        // What was printed last arrives after the end. Who else has the pipe open may keep it so.
        let began = Instant::now();
        while self.reader.as_ref().is_some_and(|reader| !reader.is_finished()) && began.elapsed() < LAST_WORDS
        {
            std::thread::sleep(Duration::from_millis(1));
        }
        let (function, time) = last.map_or((None, None), |last| (Some(last.function), last.time));
        WorkerEnd { kind, what, function, time, output: self.output() }
    }

    fn is_over_within(&self, longest: Duration) -> bool {
        let began = Instant::now();
        while !is_over(&self.child) {
            if began.elapsed() > longest {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        true
    }

    /// The last that it has printed.
    fn output(&self) -> String {
        let printed = self.printed.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes: Vec<u8> = printed.iter().copied().collect();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
        let text = lines.join(" | ");
        let n = text.chars().count();
        let cut: String = text.chars().skip(n.saturating_sub(PRINTED_IN_ERRORS)).collect();
        if n > PRINTED_IN_ERRORS { format!("... {cut}") } else { cut }
    }

    /// True if it was ended, or its answer was not valid.
    pub(super) fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Bytes that it has in memory, where the system tells.
    pub(super) fn size(&self) -> Option<u64> {
        size_of(&self.child)
    }

    /// Ends it, and all processes that it has started; how it has ended.
    fn kill(&mut self) -> Option<ExitStatus> {
        if self.owner != std::process::id() {
            return None;
        }
        if self.has_ended {
            return self.child.wait().ok();
        }
        self.has_ended = true;
        // It leads the group, and has its number until it is waited for.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        let _ = self.child.kill();
        let status = self.child.wait().ok();
        kill_processes_of(self.child.id(), self.folder.path());
        status
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// True if a process has ended. It keeps its number until it is waited for.
fn is_over(child: &Child) -> bool {
    let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    matches!(waitid(WaitId::Pid(Pid::from_child(child)), options), Ok(Some(_)))
}

/// Bytes that a process has in memory, where the system tells.
fn size_of(child: &Child) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{}/statm", child.id())).ok()?;
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

/// Keeps the last of what a process prints.
fn keep_printed(mut from: impl Read, to: &Mutex<VecDeque<u8>>) {
    let mut buffer = [0; 4096];
    loop {
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => {
                let mut kept = to.lock().unwrap_or_else(PoisonError::into_inner);
                kept.extend(&buffer[..n]);
                let surplus = kept.len().saturating_sub(PRINTED);
                kept.drain(..surplus);
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(_) => break,
        }
    }
}
