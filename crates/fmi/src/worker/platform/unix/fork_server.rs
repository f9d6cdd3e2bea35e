//! The template process from which worker processes are forked, as seen by its parent process.
//!
//! The template starts the program and loads a problem once, which takes longer than a short evaluation.
//! Forking takes a millisecond. The template runs no foreign code, has one thread, and is the parent of its
//! forks and of the processes that they leave behind.

use super::end::{ProcessEnd, in_words};
use super::orders::{DESCRIPTORS, FOLDER, Order, TEMPORARY, send};
use crate::error::FmiError;
use crate::worker::folder::{Folder, remove, worker_folder};
use crate::worker::frame::{Frame, FrameSize};
use crate::worker::handshake::{Start, no_worker};
use crate::worker::launcher::Launcher;
use crate::worker::printed::Printed;
use rustix::process::Pid;
use std::ffi::{CStr, OsStr};
use std::io::{self, ErrorKind};
use std::net::Shutdown;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::PathBuf;
use std::process::{Child, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Maximum time for an order, and for the end of the template.
const LONGEST: Duration = Duration::from_secs(60);

/// Time between two checks for the end of the template.
const LOOK: Duration = Duration::from_millis(10);

/// A process from which worker processes are forked. It ends when this value is dropped.
#[derive(Debug)]
pub(in crate::worker) struct Starter {
    /// Path of the program.
    program: PathBuf,
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
    n_started: u32,
}

impl Starter {
    pub(in crate::worker) fn start(launcher: &Launcher) -> Result<Self, FmiError> {
        let folder = Folder::new().map_err(no_worker)?;
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        socket.set_read_timeout(Some(LOOK)).map_err(no_worker)?;
        socket.set_write_timeout(Some(LONGEST)).map_err(no_worker)?;
        let (printed, pipe) = Printed::pipe().map_err(no_worker)?;
        let name = |name: &'static CStr| OsStr::from_bytes(name.to_bytes());
        let child = launcher
            .command()
            .env(name(FOLDER), folder.path())
            .env(name(TEMPORARY), folder.path())
            .stdin(OwnedFd::from(theirs))
            .stdout(Stdio::null())
            .stderr(pipe)
            // Ctrl-C in a terminal is sent to all processes of a group.
            .process_group(0)
            .spawn();
        let child = child.map_err(|error| FmiError::NoWorker {
            reason: format!("{}: {error}", launcher.program.display()),
        })?;
        let orders = Mutex::new(Orders { child, socket, n_started: 0 });
        let (is_broken, is_over) = (AtomicBool::new(false), AtomicBool::new(false));
        let (program, owner) = (launcher.program.clone(), std::process::id());
        Ok(Self { program, printed, orders, is_broken, is_over, owner, folder })
    }

    pub(in crate::worker) fn load(&self, load: &Frame) -> io::Result<()> {
        send(&self.orders().socket, Order::Load, load, &[])
    }

    fn orders(&self) -> MutexGuard<'_, Orders> {
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(in crate::worker) fn is_broken(&self) -> bool {
        self.is_broken.load(Ordering::Relaxed)
    }

    /// True if all workers have ended together with the template.
    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    /// Starts a worker with these descriptors, without waiting for it. Returns its number.
    pub(super) fn begin_worker(
        &self,
        start: &Start,
        descriptors: [BorrowedFd<'_>; DESCRIPTORS],
    ) -> Result<u32, FmiError> {
        let mut orders = self.orders();
        orders.n_started += 1;
        let number = orders.n_started;
        let requested = Frame::of(&(number, start)).map_err(no_worker)?;
        match send(&orders.socket, Order::Start, &requested, &descriptors) {
            Ok(()) => Ok(number),
            Err(error) => {
                drop(orders);
                Err(self.without_worker(&error.to_string()))
            }
        }
    }

    /// Returns the error for a worker that failed to start. If the template has ended, the error contains the
    /// reason.
    pub(super) fn without_worker(&self, error: &str) -> FmiError {
        let reason = match self.end_in_words() {
            Some(end) => Some(self.printed.last_words()).filter(|printed| !printed.is_empty()).unwrap_or(end),
            None => error.to_owned(),
        };
        FmiError::NoWorker { reason: format!("{}: {reason}", self.program.display()) }
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
        let orders = self.orders();
        let ask = || -> io::Result<i32> {
            if self.is_broken() {
                return Err(ErrorKind::BrokenPipe.into());
            }
            send(&orders.socket, Order::End, &Frame::of(&number)?, &[])?;
            orders.receive()?.head()
        };
        let status = ask();
        if status.is_err() {
            self.is_broken.store(true, Ordering::Relaxed);
        }
        status.ok().map(ExitStatus::from_raw)
    }

    pub(in crate::worker) fn end(&self) {
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
    /// True if the template ends within this time.
    fn has_ended_within(&mut self, longest: Duration) -> bool {
        let is_running = |child: &mut Child| matches!(child.try_wait(), Ok(None));
        if is_running(&mut self.child) {
            let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
            pid.map(ProcessEnd::of).unwrap_or_default().is_over_within(longest);
        }
        !is_running(&mut self.child)
    }

    fn receive(&self) -> io::Result<Frame> {
        let (began, mut answer) = (Instant::now(), Frame::default());
        let mut wait = || match began.elapsed() > LONGEST {
            true => Err(ErrorKind::TimedOut.into()),
            false => Ok(()),
        };
        answer.read(&mut &self.socket, &mut Vec::new(), FrameSize::of_numbers(0), &mut wait)?;
        Ok(answer)
    }
}

impl Drop for Starter {
    fn drop(&mut self) {
        self.end();
    }
}
