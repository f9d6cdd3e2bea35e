//! The process from which worker processes are forked. It executes orders until the other end is closed.

use super::orders::{FOLDER, Order, receive};
use super::this_worker::become_worker;
use crate::sys::unix::{close_inherited, fork};
use crate::worker::folder::{remove, worker_folder};
use crate::worker::frame::{Frame, FrameSize};
use crate::worker::handshake::{Assigned, Start};
use rustix::fs::{Mode, OFlags};
use rustix::process::{Pid, Signal, WaitOptions, kill_process, kill_process_group, waitpid};
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

/// Serves as the template. Returns the worker in each fork, and `None` in the template itself at its end.
pub(in crate::worker) fn await_order(
    load: &mut dyn FnMut(&Frame) -> io::Result<bool>,
) -> io::Result<Option<Assigned<UnixStream>>> {
    let named = std::env::var_os(FOLDER.to_str().unwrap_or_default()).map(PathBuf::from);
    let folder = named.ok_or(ErrorKind::NotFound)?;
    std::env::set_current_dir(&folder)?;
    close_inherited()?;
    let control = UnixStream::from(rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3)?);
    let nothing: OwnedFd = rustix::fs::open("/dev/null", OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty())?;
    rustix::stdio::dup2_stdin(&nothing)?;
    #[cfg(target_os = "linux")]
    rustix::process::set_child_subreaper(Some(rustix::process::getpid()))?;
    let mut workers = Workers { folder, running: Vec::new(), has_loaded: false };
    loop {
        match take_order(&control, load, &mut workers) {
            Ok(None) => {}
            Ok(Some(worker)) => return worker.map(Some),
            // The other end is closed, or has sent an order that this version does not know.
            Err(_) => break,
        }
    }
    workers.end_all();
    remove(&workers.folder);
    Ok(None)
}

/// Executes the next order. Returns the worker, or its error, in a fork of this process.
fn take_order(
    control: &UnixStream,
    load: &mut dyn FnMut(&Frame) -> io::Result<bool>,
    workers: &mut Workers,
) -> io::Result<Option<io::Result<Assigned<UnixStream>>>> {
    let (mut requested, mut answer, mut buffer) = (Frame::default(), Frame::default(), Vec::new());
    let (order, descriptors) = receive(control)?;
    requested.read(&mut &*control, &mut buffer, FrameSize::ANY, &mut || Ok(()))?;
    if order == Order::Load as u8 {
        workers.has_loaded = load(&requested)?;
        return Ok(None);
    }
    if order == Order::Start as u8 {
        let (number, start): (u32, Start) = requested.head()?;
        match fork() {
            Ok(None) => {
                let folder = worker_folder(&workers.folder, number);
                return Ok(Some(become_worker(start, descriptors, folder, workers.has_loaded)));
            }
            Ok(Some(pid)) => workers.running.push((pid, number)),
            Err(error) => {
                let mut refusal = Frame::of(&error.to_string())?;
                refusal.is_error = true;
                if let Some(socket) = descriptors.into_iter().next() {
                    refusal.write(0, &mut UnixStream::from(socket), &mut buffer)?;
                }
            }
        }
        return Ok(None);
    }
    answer.set_head(&workers.end(requested.head()?))?;
    answer.write(0, &mut &*control, &mut buffer)?;
    Ok(None)
}

/// Workers forked from this process and not ended yet, with their numbers.
struct Workers {
    folder: PathBuf,
    running: Vec<(Pid, u32)>,
    /// True if the workers inherit the loaded problem from this process.
    has_loaded: bool,
}

impl Workers {
    /// Ends all workers.
    fn end_all(&mut self) {
        for (pid, _) in &self.running {
            let _ = kill_process_group(*pid, Signal::KILL);
        }
        while let Some((_, number)) = self.running.last() {
            self.end(*number);
        }
    }

    /// Ends a worker, with the processes and files that it has left behind. Returns its exit status.
    fn end(&mut self, number: u32) -> i32 {
        let place = self.running.iter().position(|(_, other)| *other == number);
        let Some((pid, _)) = place.map(|place| self.running.swap_remove(place)) else { return 0 };
        // The worker leads the process group, and keeps its process id until it is waited for.
        let _ = kill_process_group(pid, Signal::KILL);
        let status = kill(pid);
        let folder = worker_folder(&self.folder, number);
        self.end_orphans(&folder);
        remove(&folder);
        status
    }

    /// Ends processes that workers have started and left behind. They become children of this process when
    /// their parents end. Their environment identifies the worker that started them, by the worker's folder.
    /// All others are ended with the last worker.
    fn end_orphans(&self, folder: &Path) {
        let marker = [FOLDER.to_bytes(), b"=", folder.as_os_str().as_bytes()].concat();
        let is_marked = |pid: i32| {
            let environment = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
            environment.split(|byte| *byte == 0).any(|entry| entry == marker)
        };
        let is_worker =
            |pid: i32| self.running.iter().any(|(worker, _)| worker.as_raw_nonzero().get() == pid);
        // Repeated until there are none, because children of an orphan become orphans.
        loop {
            let children = std::fs::read_to_string("/proc/thread-self/children").unwrap_or_default();
            let pids = children.split_ascii_whitespace().filter_map(|pid| pid.parse().ok());
            let orphans = pids.filter(|pid| !is_worker(*pid) && (self.running.is_empty() || is_marked(*pid)));
            if orphans.filter_map(Pid::from_raw).map(kill).count() == 0 {
                break;
            }
        }
    }
}

/// Kills a child of this process. Returns its exit status.
fn kill(child: Pid) -> i32 {
    let _ = kill_process(child, Signal::KILL);
    let waited = rustix::io::retry_on_intr(|| waitpid(Some(child), WaitOptions::empty()));
    waited.ok().flatten().map_or(0, |(_, status)| status.as_raw())
}
