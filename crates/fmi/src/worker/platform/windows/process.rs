//! Starts worker processes, and the processes as seen by the one that has started them.

use super::order::{Channel, Order};
use crate::error::FmiError;
use crate::sys::Page;
use crate::sys::windows::{Job, give_handle, give_socket, memory_of};
use crate::worker::folder::{Folder, make, remove, worker_folder};
use crate::worker::frame::Frame;
use crate::worker::handshake::{Start, no_worker};
use crate::worker::launcher::Launcher;
use std::collections::BTreeMap;
use std::io::{self, PipeWriter};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::os::windows::io::OwnedHandle;
use std::os::windows::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use windows_sys::Win32::Foundation::{
    STATUS_ACCESS_VIOLATION, STATUS_CONTROL_C_EXIT, STATUS_DLL_NOT_FOUND, STATUS_HEAP_CORRUPTION,
    STATUS_ILLEGAL_INSTRUCTION, STATUS_INTEGER_DIVIDE_BY_ZERO, STATUS_NO_MEMORY, STATUS_STACK_BUFFER_OVERRUN,
    STATUS_STACK_OVERFLOW,
};
use windows_sys::Win32::System::Threading::{CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW};

/// Time between two checks for the end of a process.
const LOOK: Duration = Duration::from_millis(1);

/// Starts workers with one program.
#[derive(Debug)]
pub(in crate::worker) struct Starter {
    launcher: Launcher,
    workers: Mutex<Workers>,
    is_over: AtomicBool,
    folder: Folder,
}

#[derive(Debug, Default)]
struct Workers {
    running: BTreeMap<u32, Arc<Worker>>,
    n_started: u32,
}

/// A process with the processes that it has started, and its folder.
#[derive(Debug)]
struct Worker {
    child: Mutex<Child>,
    job: Job,
    folder: PathBuf,
}

/// Handle of a worker process.
#[derive(Debug)]
pub(in crate::worker) struct ProcessHandle {
    starter: Arc<Starter>,
    number: u32,
    worker: Arc<Worker>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns two connected sockets of this process.
fn pair() -> io::Result<(TcpStream, TcpStream)> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let ours = TcpStream::connect(listener.local_addr()?)?;
    loop {
        let (theirs, from) = listener.accept()?;
        // Another process may have connected first.
        if from == ours.local_addr()? {
            // Each message is written at once.
            ours.set_nodelay(true)?;
            theirs.set_nodelay(true)?;
            return Ok((ours, theirs));
        }
    }
}

impl Starter {
    pub(in crate::worker) fn start(launcher: &Launcher) -> Result<Self, FmiError> {
        let folder = Folder::new().map_err(no_worker)?;
        let (launcher, workers) = (launcher.clone(), Mutex::default());
        Ok(Self { launcher, workers, is_over: AtomicBool::new(false), folder })
    }

    /// Ignored: a worker loads the problem by itself.
    pub(in crate::worker) fn load(&self, _: &Frame) -> io::Result<()> {
        Ok(())
    }

    pub(in crate::worker) fn is_broken(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    pub(in crate::worker) fn start_worker(
        self: &Arc<Self>,
        start: &Start,
        printed: PipeWriter,
    ) -> Result<(ProcessHandle, Channel, Page), FmiError> {
        let mut workers = locked(&self.workers);
        let number = workers.n_started + 1;
        let folder = worker_folder(self.folder.path(), number);
        let begun = self.begin(start, printed, folder).map_err(|error| self.failed(&error.to_string()))?;
        let (worker, channel, page) = begun;
        workers.n_started = number;
        workers.running.insert(number, Arc::clone(&worker));
        Ok((ProcessHandle { starter: Arc::clone(self), number, worker }, channel, page))
    }

    fn begin(
        &self,
        start: &Start,
        printed: PipeWriter,
        folder: PathBuf,
    ) -> io::Result<(Arc<Worker>, Channel, Page)> {
        let (ours, theirs) = pair()?;
        let (page, handle) = Page::new()?;
        let job = Job::new(start.limits.memory)?;
        make(&folder)?;
        let surroundings = &start.surroundings;
        let is_folder = |path: &&Path| path.is_dir();
        let working_folder = surroundings.folder.as_ref().map(Path::new).filter(is_folder).unwrap_or(&folder);
        let spawned = self
            .launcher
            .command()
            .envs(surroundings.variables.iter().map(|(name, value)| (name, value)))
            .env("TEMP", &folder)
            .env("TMP", &folder)
            .current_dir(working_folder)
            .stdin(Stdio::piped())
            .stdout(printed.try_clone()?)
            .stderr(printed)
            // Ctrl-C in a terminal is sent to all processes of a group.
            .creation_flags(CREATE_NEW_PROCESS_GROUP | CREATE_NO_WINDOW)
            .spawn();
        let child = match spawned {
            Ok(child) => Mutex::new(child),
            Err(error) => {
                remove(&folder);
                return Err(error);
            }
        };
        let worker = Worker { child, job, folder };
        match worker.order(start, &theirs, &handle) {
            Ok(()) => Ok((Arc::new(worker), ours, page)),
            Err(error) => {
                worker.end();
                Err(error)
            }
        }
    }

    fn failed(&self, reason: &str) -> FmiError {
        FmiError::NoWorker { reason: format!("{}: {reason}", self.launcher.program.display()) }
    }

    pub(in crate::worker) fn end(&self) {
        self.is_over.store(true, Ordering::Relaxed);
        let running = std::mem::take(&mut locked(&self.workers).running);
        for worker in running.into_values() {
            worker.end();
        }
    }
}

impl Drop for Starter {
    fn drop(&mut self) {
        self.end();
    }
}

impl Worker {
    /// Adds the process to its group, and sends it the order. Until then, it waits and starts no process.
    fn order(&self, start: &Start, socket: &TcpStream, page: &OwnedHandle) -> io::Result<()> {
        let mut child = locked(&self.child);
        self.job.add(&child)?;
        let socket = give_socket(socket, &child)?;
        let page = give_handle(page, &child)?;
        let order = Order { socket, page, folder: self.folder.clone(), start };
        let mut to = child.stdin.take().ok_or(io::ErrorKind::BrokenPipe)?;
        Frame::of(&order)?.write(0, &mut to, &mut Vec::new())
    }

    fn status(&self) -> Option<ExitStatus> {
        locked(&self.child).try_wait().ok().flatten()
    }

    fn has_ended_within(&self, longest: Duration) -> bool {
        let began = Instant::now();
        while self.status().is_none() {
            if began.elapsed() >= longest {
                return false;
            }
            std::thread::sleep(LOOK);
        }
        true
    }

    /// Ends the process and all processes that it has started, and removes its folder. Returns its exit
    /// status.
    fn end(&self) -> Option<ExitStatus> {
        let mut child = locked(&self.child);
        self.job.end();
        // A process that could not be added to the group.
        let _ = child.kill();
        let status = child.wait().ok();
        remove(&self.folder);
        status
    }
}

impl ProcessHandle {
    pub(in crate::worker) fn arrived(&mut self, id: u32) -> bool {
        locked(&self.worker.child).id() == id
    }

    pub(in crate::worker) fn has_ended_within(&self, longest: Duration) -> bool {
        self.worker.has_ended_within(longest)
    }

    pub(in crate::worker) fn memory(&self) -> Option<u64> {
        memory_of(&locked(&self.worker.child))
    }

    pub(in crate::worker) fn kill(&self) -> Option<String> {
        locked(&self.starter.workers).running.remove(&self.number)?;
        self.worker.end().map(in_words)
    }

    pub(in crate::worker) fn unknown_end(&self) -> String {
        "the process ended with an unknown status".to_owned()
    }

    pub(in crate::worker) fn not_started(&self, error: &str) -> FmiError {
        match self.worker.has_ended_within(LOOK).then(|| self.worker.status()).flatten() {
            Some(status) => self.starter.failed(&format!("{error} ({})", in_words(status))),
            None => self.starter.failed(error),
        }
    }
}

/// Exit code of `abort` in the C runtime.
const ABORT: i32 = 3;

/// Describes how a process ended. An exception that nothing handles is the exit code.
fn in_words(status: ExitStatus) -> String {
    let Some(code) = status.code() else { return "the process ended".to_owned() };
    match code {
        STATUS_ACCESS_VIOLATION => "access violation".to_owned(),
        STATUS_STACK_OVERFLOW => "stack overflow".to_owned(),
        STATUS_INTEGER_DIVIDE_BY_ZERO => "integer division by zero".to_owned(),
        STATUS_ILLEGAL_INSTRUCTION => "illegal instruction".to_owned(),
        STATUS_HEAP_CORRUPTION => "heap corruption".to_owned(),
        STATUS_STACK_BUFFER_OVERRUN | ABORT => "abort".to_owned(),
        STATUS_NO_MEMORY => "out of memory".to_owned(),
        STATUS_DLL_NOT_FOUND => "a DLL was not found".to_owned(),
        STATUS_CONTROL_C_EXIT => "Ctrl-C".to_owned(),
        // The severity of a status is in its two highest bits (NTSTATUS).
        code if code.cast_unsigned() >> 30 == 3 => format!("exception 0x{code:08X}"),
        code => format!("the process called exit({code})"),
    }
}
