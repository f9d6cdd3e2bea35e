//! The process that worker processes are copied from, as the process sees it that has started it.
//!
//! It starts the program and loads a problem once, which takes longer than a short evaluation; a copy of it
//! takes a millisecond. It runs no foreign code, has one thread, and is the parent of its copies and of
//! whatever they leave behind.

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

/// Order to the template; its byte goes before the frame, and the descriptors with it. Only the last one has
/// an answer of the template: a worker says by itself that it is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Order {
    /// To load what the frame says.
    Load = b'L',
    /// To start a worker: [`Start`], with [`DESCRIPTORS`]; on its socket follow an [`Arrival`] and a
    /// [`Hello`], or an error with its text.
    Start = b'S',
    /// To end a worker, by its number, and what it has left behind; the answer is its status.
    End = b'E',
}

/// The socket, the shared page, and the pipe for what is printed.
pub(super) const DESCRIPTORS: usize = 3;

/// A worker to be started.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Start {
    pub(super) number: u32,
    pub(super) limits: WorkerLimits,
    pub(super) level: LevelFilter,
    /// It [prepares](super::Service::prepare) before it says that it is there.
    pub(super) is_prepared: bool,
    pub(super) surroundings: Surroundings,
    /// Functions that are not called because they have ended a worker (see
    /// [`WorkerEnd::call_at_end_of_run`](crate::error::WorkerEnd::call_at_end_of_run)).
    pub(super) avoided_calls: Vec<String>,
    /// From 0, other than that of all other workers of this program that run at the same time.
    pub(super) place: u32,
}

/// First message of a worker, before any foreign code runs in it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Arrival {
    pub(super) pid: i32,
}

/// Second message of a worker, which is ready for its first question.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Hello {
    /// Its template has loaded what it was to load.
    pub(super) has_loaded: bool,
}

/// An order is done after this time, and its end.
const LONGEST: Duration = Duration::from_secs(60);

/// Time between two looks whether it has ended.
const LOOK: Duration = Duration::from_millis(10);

/// A process that worker processes are copied from. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Template {
    program: Launcher,
    printed: Printed,
    orders: Mutex<Orders>,
    /// It has ended, or is about to.
    is_broken: AtomicBool,
    /// It has ended with all of its workers.
    is_over: AtomicBool,
    /// The process that has started it.
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
    /// The load that was sent.
    load: Option<LoadId>,
}

/// A template that was started before there is a problem to load. It ends with this, unless it was taken.
#[derive(Debug)]
pub struct ForkServer(Mutex<Option<Template>>);

static AHEAD: Mutex<Weak<ForkServer>> = Mutex::new(Weak::new());

impl ForkServer {
    fn template(&self) -> MutexGuard<'_, Option<Template>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The template of this program, if one was started ahead and nobody has taken it.
    fn take(launcher: &Launcher) -> Option<Template> {
        let ahead = AHEAD.lock().unwrap_or_else(PoisonError::into_inner).upgrade()?;
        let is_usable =
            |template: &mut Template| template.owner == std::process::id() && template.program == *launcher;
        ahead.template().take_if(is_usable)
    }
}

/// Starts the program of worker processes, which will be needed soon; does not wait for it. It ends when the
/// last returned `ForkServer` is dropped before it is needed. `None`: it cannot be started; who needs it
/// meets the error.
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
    /// One that was started before, or is started now, and is to load this.
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
            // Ctrl-C in a terminal goes to all processes of a group.
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

    /// True if it can start no workers any more.
    pub(super) fn is_broken(&self) -> bool {
        self.is_broken.load(Ordering::Relaxed)
    }

    /// True if all of its workers have ended with it.
    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    /// Has a worker with these descriptors started, which gets the next number; does not wait for it. Its
    /// number, and what it has loaded if the template could load it.
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

    /// Error for a worker that was not started: the template, if it has ended, can start no other one.
    pub(super) fn without_worker(&self, error: &str) -> FmiError {
        let reason = match self.end_in_words() {
            Some(end) => Some(self.printed.last_words()).filter(|printed| !printed.is_empty()).unwrap_or(end),
            None => error.to_owned(),
        };
        FmiError::NoWorker { reason: format!("{}: {reason}", self.program.program.display()) }
    }

    /// How it has ended, if it has.
    pub(super) fn end_in_words(&self) -> Option<String> {
        let mut orders = self.orders();
        orders.has_ended_within(LOOK);
        let status = orders.child.try_wait().ok().flatten()?;
        self.is_broken.store(true, Ordering::Relaxed);
        Some(in_words(status))
    }

    /// True if a process is a child of the template, as its workers are; on systems that do not tell, true
    /// for any process.
    pub(super) fn is_parent_of(&self, pid: Pid) -> bool {
        let parent = |pid: u32| -> Option<u32> {
            let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
            // The state and the parent follow the name of the program, which may hold anything (proc(5)).
            stat.rsplit(')').next()?.split_ascii_whitespace().nth(1)?.parse().ok()
        };
        let template = self.orders().child.id();
        parent(self.owner).is_none() || parent(pid.as_raw_nonzero().get().cast_unsigned()) == Some(template)
    }

    /// Removes the folder of a worker that has ended without the template.
    pub(super) fn remove_folder(&self, number: u32) {
        remove(&worker_folder(self.folder.path(), number));
    }

    /// Ends a worker, and all processes that it has started; how it has ended.
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

    /// Ends it, with all of its workers and what they have started.
    pub(super) fn end(&self) {
        // A child that was forked meanwhile has no templates.
        if self.owner != std::process::id() {
            return;
        }
        self.is_broken.store(true, Ordering::Relaxed);
        let mut orders = self.orders();
        let _ = orders.socket.shutdown(Shutdown::Both);
        if orders.n_started == 0 {
            // Nothing is lost.
            let _ = orders.child.kill();
        }
        let began = Instant::now();
        let mut has_ended = false;
        // There may be many processes to be ended.
        while !has_ended && began.elapsed() < LONGEST {
            has_ended = orders.has_ended_within(LOOK);
        }
        let _ = orders.child.kill();
        let status = orders.child.wait();
        // Else each worker is ended alone, and its folder removed.
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
        // Elsewhere the signal is ignored, as in all programs of Rust and Python.
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

/// No worker can be started.
pub(super) fn no_worker(error: io::Error) -> FmiError {
    FmiError::NoWorker { reason: error.to_string() }
}
