//! The template process from which worker processes are forked, as seen by its parent process.
//!
//! The template starts the program and loads a problem once, which takes longer than a short evaluation.
//! Forking takes a millisecond. The template runs no foreign code, has one thread, and is the parent of its
//! forks and of the processes that they leave behind.

use super::end::{ProcessEnd, in_words};
use super::folder::{Folder, remove, worker_folder};
use super::frame::{Frame, FrameSize};
use super::handshake::{ASKED, FOLDER, LEVEL, TEMPORARY, VERSION};
use super::launcher::Launcher;
use super::limits::WorkerLimits;
use super::load::{Load, LoadId};
use super::printed::Printed;
use super::surroundings::Surroundings;
use crate::error::FmiError;
use crate::sys::{PRELOAD, PRELOADED_BEFORE};
use log::LevelFilter;
use rustix::net::{SendAncillaryBuffer, SendAncillaryMessage, SendFlags, sendmsg};
use rustix::process::Pid;
use serde::{Deserialize, Serialize};
use std::ffi::{CStr, OsStr};
use std::io::{self, ErrorKind, IoSlice};
use std::mem::MaybeUninit;
use std::net::Shutdown;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

/// Order to the template. Its byte and the descriptors are sent before the frame. The template answers only
/// the last one; a worker reports its own arrival.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Order {
    /// Load the problem in the frame.
    Load = b'L',
    /// Start a worker: [`Start`], with [`DESCRIPTORS`]. An [`Arrival`] and a [`Hello`] follow on its socket,
    /// or an error with its message.
    Start = b'S',
    /// End a worker, by its number, and the processes that it has left behind. The answer is its exit status.
    End = b'E',
}

/// Number of descriptors: the socket, the shared page, and the pipe for printed output.
pub(super) const DESCRIPTORS: usize = 3;

/// A worker to be started.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Start {
    pub(super) number: u32,
    pub(super) limits: WorkerLimits,
    pub(super) level: LevelFilter,
    /// True if the worker [prepares](super::Service::prepare) before it reports that it is ready.
    pub(super) is_prepared: bool,
    pub(super) surroundings: Surroundings,
    /// Functions that are not called because they have ended a worker (see
    /// [`WorkerEnd::call_at_end_of_run`](crate::error::WorkerEnd::call_at_end_of_run)).
    pub(super) avoided_calls: Vec<String>,
    /// Number from 0, different for all workers of this program that run at the same time.
    pub(super) place: u32,
}

/// First message of a worker, before any foreign code runs in it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Arrival {
    pub(super) pid: i32,
}

/// Second message of a worker, which is then ready for its first request.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Hello {
    /// True if the template has loaded the problem.
    pub(super) has_loaded: bool,
}

/// Maximum time for an order, and for the end of the template.
const LONGEST: Duration = Duration::from_secs(60);

/// Time between two checks for the end of the template.
const LOOK: Duration = Duration::from_millis(10);

/// A process from which worker processes are forked. It ends when this value is dropped.
#[derive(Debug)]
pub(super) struct Template {
    program: Launcher,
    printed: Printed,
    orders: Mutex<Orders>,
    /// True if the template has ended, or is about to end.
    is_broken: AtomicBool,
    /// True if the template has ended together with all its workers.
    is_over: AtomicBool,
    /// Process id of the parent.
    owner: u32,
    folder: Folder,
}

#[derive(Debug)]
struct Orders {
    child: Child,
    socket: UnixStream,
    buffer: Vec<u8>,
    answer: Frame,
    n_started: u32,
    /// Load that was sent.
    load: Option<LoadId>,
}

/// A template that was started before a problem is known. It ends when this value is dropped, unless it is in
/// use.
#[derive(Debug)]
pub struct ForkServer(Mutex<Option<Template>>);

static AHEAD: Mutex<Weak<ForkServer>> = Mutex::new(Weak::new());

impl ForkServer {
    fn template(&self) -> MutexGuard<'_, Option<Template>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the template of this program, if one was started in advance and is still available.
    fn take(launcher: &Launcher) -> Option<Template> {
        let ahead = AHEAD.lock().unwrap_or_else(PoisonError::into_inner).upgrade()?;
        let is_usable =
            |template: &mut Template| template.owner == std::process::id() && template.program == *launcher;
        ahead.template().take_if(is_usable)
    }
}

/// Starts the program of worker processes in advance, without waiting for it. The process ends when the last
/// returned `ForkServer` is dropped, unless it is in use. Returns `None` if the program cannot be started.
/// The error is reported when a worker is needed.
pub fn start_fork_server() -> Option<Arc<ForkServer>> {
    let mut known = AHEAD.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(ahead) = known.upgrade().filter(|ahead| ahead.template().is_some()) {
        return Some(ahead);
    }
    let template = Template::start(&Launcher::known()?).ok()?;
    let ahead = Arc::new(ForkServer(Mutex::new(Some(template))));
    *known = Arc::downgrade(&ahead);
    Some(ahead)
}

impl Template {
    /// Returns a template that loads this problem. Uses a template that was started in advance, or starts a
    /// new one.
    pub(super) fn loading(launcher: &Launcher, load: &Load) -> Result<Self, FmiError> {
        let template = ForkServer::take(launcher).map_or_else(|| Self::start(launcher), Ok)?;
        let mut orders = template.orders();
        load.frame().and_then(|frame| orders.send(Order::Load, &frame, &[])).map_err(no_worker)?;
        orders.load = Some(load.id);
        drop(orders);
        Ok(template)
    }

    pub(super) fn start(launcher: &Launcher) -> Result<Self, FmiError> {
        let folder = Folder::new().map_err(no_worker)?;
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        socket.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        socket.set_write_timeout(Some(LONGEST)).map_err(no_worker)?;
        let (printed, pipe) = Printed::pipe().map_err(no_worker)?;
        let name = |name: &'static CStr| OsStr::from_bytes(name.to_bytes());
        let mut command = Command::new(&launcher.program);
        command
            .args(&launcher.arguments)
            .env(ASKED, VERSION)
            .env(name(FOLDER), folder.path())
            .env(LEVEL, log::max_level().as_str())
            .env(name(TEMPORARY), folder.path())
            .stdin(OwnedFd::from(theirs))
            .stdout(Stdio::null())
            .stderr(pipe)
            // Ctrl-C in a terminal is sent to all processes of a group.
            .process_group(0);
        if let Some(library) = &launcher.preload {
            let before = std::env::var_os(PRELOAD).unwrap_or_default();
            let mut libraries = before.clone();
            libraries.push(if before.is_empty() { "" } else { ":" });
            libraries.push(library);
            command.env(PRELOAD, libraries).env(PRELOADED_BEFORE, before);
        }
        let child = command.spawn().map_err(|error| FmiError::NoWorker {
            reason: format!("{}: {error}", launcher.program.display()),
        })?;
        let (buffer, answer) = (Vec::new(), Frame::default());
        let orders = Orders { child, socket, buffer, answer, n_started: 0, load: None };
        let (program, owner) = (launcher.clone(), std::process::id());
        Ok(Self {
            program,
            printed,
            orders: Mutex::new(orders),
            is_broken: AtomicBool::new(false),
            is_over: AtomicBool::new(false),
            owner,
            folder,
        })
    }

    fn orders(&self) -> MutexGuard<'_, Orders> {
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// True if the template cannot start workers any more.
    pub(super) fn is_broken(&self) -> bool {
        self.is_broken.load(Ordering::Relaxed)
    }

    /// True if all workers have ended together with the template.
    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    /// Starts a worker with these descriptors and the next number, without waiting for it. Returns its
    /// number, and its load if the template could load it.
    pub(super) fn begin_worker(
        &self,
        mut start: Start,
        descriptors: [BorrowedFd<'_>; DESCRIPTORS],
    ) -> Result<(u32, Option<LoadId>), FmiError> {
        let mut orders = self.orders();
        orders.n_started += 1;
        start.number = orders.n_started;
        let asked = Frame::of(&start).map_err(no_worker)?;
        match orders.send(Order::Start, &asked, &descriptors) {
            Ok(()) => Ok((start.number, orders.load)),
            Err(error) => {
                drop(orders);
                Err(self.without_worker(&error.to_string()))
            }
        }
    }

    /// Returns the error for a worker that was not started. If the template has ended, the error contains the
    /// reason.
    pub(super) fn without_worker(&self, error: &str) -> FmiError {
        let reason = match self.end_in_words() {
            Some(end) => Some(self.printed.last_words()).filter(|printed| !printed.is_empty()).unwrap_or(end),
            None => error.to_owned(),
        };
        FmiError::NoWorker { reason: format!("{}: {reason}", self.program.program.display()) }
    }

    /// Describes how the template ended; `None` if it is running.
    pub(super) fn end_in_words(&self) -> Option<String> {
        let mut orders = self.orders();
        orders.has_ended_within(LOOK);
        let status = orders.child.try_wait().ok().flatten()?;
        self.is_broken.store(true, Ordering::Relaxed);
        Some(in_words(status))
    }

    /// True if a process is a child of the template, as all its workers are. Always true on systems that do
    /// not report parents.
    pub(super) fn is_parent_of(&self, pid: Pid) -> bool {
        let parent = |pid: u32| -> Option<u32> {
            let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
            // The state and the parent follow the name of the program, which may contain any characters
            // (proc(5)).
            stat.rsplit(')').next()?.split_ascii_whitespace().nth(1)?.parse().ok()
        };
        let template = self.orders().child.id();
        parent(self.owner).is_none() || parent(pid.as_raw_nonzero().get().cast_unsigned()) == Some(template)
    }

    /// Removes the folder of a worker whose template ended before it.
    pub(super) fn remove_folder(&self, number: u32) {
        remove(&worker_folder(self.folder.path(), number));
    }

    /// Ends a worker and all processes that it has started. Returns its exit status.
    pub(super) fn end_worker(&self, number: u32) -> Option<ExitStatus> {
        let mut orders = self.orders();
        let mut ask = || -> io::Result<i32> {
            if self.is_broken() {
                return Err(ErrorKind::BrokenPipe.into());
            }
            orders.send(Order::End, &Frame::of(&number)?, &[])?;
            orders.receive()?;
            orders.answer.head()
        };
        let status = ask();
        if status.is_err() {
            self.is_broken.store(true, Ordering::Relaxed);
        }
        status.ok().map(ExitStatus::from_raw)
    }

    /// Ends the template, with all its workers and the processes that they have started.
    pub(super) fn end(&self) {
        // A forked child does not own any templates.
        if self.owner != std::process::id() {
            return;
        }
        self.is_broken.store(true, Ordering::Relaxed);
        let mut orders = self.orders();
        let _ = orders.socket.shutdown(Shutdown::Both);
        if orders.n_started == 0 {
            // No worker is lost.
            let _ = orders.child.kill();
        }
        let began = Instant::now();
        let mut has_ended = false;
        // The template may have to end many processes.
        while !has_ended && began.elapsed() < LONGEST {
            has_ended = orders.has_ended_within(LOOK);
        }
        let _ = orders.child.kill();
        let status = orders.child.wait();
        // Otherwise, each worker is ended separately, and its folder removed.
        self.is_over.store(has_ended && status.is_ok_and(|status| status.success()), Ordering::Relaxed);
    }
}

impl Orders {
    fn send(&mut self, order: Order, frame: &Frame, descriptors: &[BorrowedFd<'_>]) -> io::Result<()> {
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(DESCRIPTORS))];
        let mut control = SendAncillaryBuffer::new(&mut space);
        if !descriptors.is_empty() && !control.push(SendAncillaryMessage::ScmRights(descriptors)) {
            return Err(ErrorKind::InvalidInput.into());
        }
        let bytes = [order as u8];
        // On other systems the signal is ignored, as in all Rust and Python programs.
        #[cfg(target_os = "linux")]
        let flags = SendFlags::NOSIGNAL;
        #[cfg(not(target_os = "linux"))]
        let flags = SendFlags::empty();
        let send = || sendmsg(&self.socket, &[IoSlice::new(&bytes)], &mut control, flags);
        rustix::io::retry_on_intr(send)?;
        frame.write(0, &mut &self.socket, &mut self.buffer)
    }

    /// True if the template ends within this time.
    fn has_ended_within(&mut self, longest: Duration) -> bool {
        let is_running = |child: &mut Child| matches!(child.try_wait(), Ok(None));
        if is_running(&mut self.child) {
            let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
            pid.map(ProcessEnd::of).unwrap_or_default().is_over_within(longest);
        }
        !is_running(&mut self.child)
    }

    fn receive(&mut self) -> io::Result<()> {
        let began = Instant::now();
        let mut wait = || match began.elapsed() > LONGEST {
            true => Err(ErrorKind::TimedOut.into()),
            false => Ok(()),
        };
        self.answer.read(&mut &self.socket, &mut self.buffer, FrameSize::of_numbers(0), &mut wait)
    }
}

impl Drop for Template {
    fn drop(&mut self) {
        self.end();
    }
}

/// Returns the error for a worker that cannot be started.
pub(super) fn no_worker(error: io::Error) -> FmiError {
    FmiError::NoWorker { reason: error.to_string() }
}
