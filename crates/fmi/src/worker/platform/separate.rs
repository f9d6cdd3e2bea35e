//! Starts worker processes one by one, and the processes as seen by the one that has started them.
//!
//! A process of Windows is started natively, or under Wine.

#[cfg(windows)]
use super::windows::{Connection, Group, begin, ended_in_words, memory_of};
#[cfg(not(windows))]
use super::wine::{Connection, Group, begin, ended_in_words, memory_of};
use crate::error::FmiError;
use crate::sys::Page;
use crate::worker::folder::{Folder, make, remove, worker_folder};
use crate::worker::frame::Frame;
use crate::worker::handshake::{Start, no_worker};
use crate::worker::launcher::Launcher;
use std::collections::BTreeMap;
use std::io::{self, PipeWriter};
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time between two checks for the end of a process.
const LOOK: Duration = Duration::from_millis(1);

/// Maximum length of the path of a worker's folder. With its drive and a separator, Windows returns at most
/// 260 characters as the folder for temporary files (`GetTempPath2W`).
const LONGEST_FOLDER: usize = 256;

/// Starts workers with one program.
#[derive(Debug)]
pub(in crate::worker) struct Starter {
    launcher: Launcher,
    /// Process id of the owner. A forked child does not own the workers.
    owner: u32,
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
    group: Group,
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

fn check_length(folder: &Path) -> io::Result<()> {
    if folder.as_os_str().len() <= LONGEST_FOLDER {
        return Ok(());
    }
    let path = folder.display();
    Err(io::Error::other(format!(
        "TMPDIR: the path {path} has more than {LONGEST_FOLDER} bytes, the maximum on Windows"
    )))
}

impl Starter {
    pub(in crate::worker) fn start(launcher: &Launcher) -> Result<Self, FmiError> {
        let folder = Folder::of_starter().map_err(no_worker)?;
        let (launcher, workers) = (launcher.clone(), Mutex::default());
        let (is_over, owner) = (AtomicBool::new(false), std::process::id());
        Ok(Self { launcher, owner, workers, is_over, folder })
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
    ) -> Result<(ProcessHandle, Connection, Page), FmiError> {
        let mut workers = locked(&self.workers);
        let number = workers.n_started + 1;
        let folder = worker_folder(self.folder.path(), number);
        let begun = check_length(&folder).and_then(|()| make(&folder)).and_then(|()| {
            let begun = begin(&self.launcher, start, printed, &folder);
            begun.inspect_err(|_| remove(&folder))
        });
        let (child, group, connection, page) = begun.map_err(|error| self.failed(&error.to_string()))?;
        let worker = Arc::new(Worker { child: Mutex::new(child), group, folder });
        workers.n_started = number;
        workers.running.insert(number, Arc::clone(&worker));
        Ok((ProcessHandle { starter: Arc::clone(self), number, worker }, connection, page))
    }

    fn failed(&self, reason: &str) -> FmiError {
        let reason = format!("{}: {reason}", self.launcher.program.display());
        match self.launcher.models {
            // Such a model cannot run in this process instead.
            Some(models) => {
                let reason = format!("Cannot start a worker process ({reason})");
                FmiError::NoWindowsProgram { models, reason }
            }
            None => FmiError::NoWorker { reason },
        }
    }

    pub(in crate::worker) fn end(&self) {
        if self.owner != std::process::id() {
            return;
        }
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
        self.group.end();
        let _ = child.kill();
        let status = child.wait().ok();
        remove(&self.folder);
        status
    }
}

impl ProcessHandle {
    pub(in crate::worker) fn arrived(&mut self, id: u32) -> bool {
        self.worker.group.has_number(&locked(&self.worker.child), id)
    }

    pub(in crate::worker) fn has_ended_within(&self, longest: Duration) -> bool {
        self.worker.has_ended_within(longest)
    }

    pub(in crate::worker) fn memory(&self) -> Option<u64> {
        memory_of(&locked(&self.worker.child))
    }

    pub(in crate::worker) fn kill(&self) -> Option<String> {
        locked(&self.starter.workers).running.remove(&self.number)?;
        self.worker.end().map(ended_in_words)
    }

    pub(in crate::worker) fn unknown_end(&self) -> String {
        "the process ended with an unknown status".to_owned()
    }

    pub(in crate::worker) fn not_started(&self, error: &str) -> FmiError {
        match self.worker.has_ended_within(LOOK).then(|| self.worker.status()).flatten() {
            Some(status) => self.starter.failed(&format!("{error} ({})", ended_in_words(status))),
            None => self.starter.failed(error),
        }
    }
}
