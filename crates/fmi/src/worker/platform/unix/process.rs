//! A worker process forked from a template, as seen by the process that started it.

use super::end::{ProcessEnd, in_words};
use super::fork_server::Starter;
use crate::error::FmiError;
use crate::sys::Page;
use crate::worker::handshake::{Start, no_worker};
use rustix::process::{Pid, Signal, kill_process};
use std::io::PipeWriter;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::time::Duration;

/// Handle of a worker process.
#[derive(Debug)]
pub(in crate::worker) struct ProcessHandle {
    starter: Arc<Starter>,
    /// Number of the worker among the workers of its template.
    number: u32,
    /// Process id; `None` before the worker has arrived.
    pub(in crate::worker) pid: Option<Pid>,
    end: ProcessEnd,
}

impl Starter {
    pub(in crate::worker) fn start_worker(
        self: &Arc<Self>,
        start: &Start,
        printed: PipeWriter,
    ) -> Result<(ProcessHandle, UnixStream, Page), FmiError> {
        let (socket, theirs) = UnixStream::pair().map_err(no_worker)?;
        let (page, file) = Page::new().map_err(no_worker)?;
        let descriptors = [theirs.as_fd(), file.as_fd(), printed.as_fd()];
        let number = self.begin_worker(start, descriptors)?;
        // The child has the other ends.
        let (starter, end) = (Arc::clone(self), ProcessEnd::default());
        Ok((ProcessHandle { starter, number, pid: None, end }, socket, page))
    }
}

impl ProcessHandle {
    pub(in crate::worker) fn arrived(&mut self, id: u32) -> bool {
        // A number below 1 would refer to several processes (kill(2)).
        let pid = i32::try_from(id).ok().filter(|pid| *pid > 0).and_then(Pid::from_raw);
        self.pid = pid.filter(|pid| self.starter.is_parent_of(*pid));
        self.end = self.pid.map(ProcessEnd::of).unwrap_or_default();
        self.pid.is_some()
    }

    pub(in crate::worker) fn has_ended_within(&self, longest: Duration) -> bool {
        self.end.is_over_within(longest)
    }

    pub(in crate::worker) fn memory(&self) -> Option<u64> {
        memory_of_process(self.pid?.as_raw_nonzero().get().cast_unsigned())
    }

    pub(in crate::worker) fn kill(&self) -> Option<String> {
        if self.starter.is_over() {
            return None;
        }
        let status = self.starter.end_worker(self.number);
        if status.is_none() {
            // The template has ended.
            if let Some(pid) = self.pid.filter(|_| !self.end.is_over_within(Duration::ZERO)) {
                let _ = kill_process(pid, Signal::KILL);
                self.end.is_over_within(Duration::from_secs(1));
            }
            self.starter.remove_folder(self.number);
        }
        status.map(in_words)
    }

    pub(in crate::worker) fn unknown_end(&self) -> String {
        // The template received the exit status.
        let end = self.starter.end_in_words().unwrap_or_else(|| "no answer".to_owned());
        format!(
            "the process ended with an unknown status, because its parent process had ended before: {end}"
        )
    }

    pub(in crate::worker) fn not_started(&self, error: &str) -> FmiError {
        self.starter.without_worker(error)
    }
}

/// Returns the memory of a process in bytes.
pub(in crate::worker) fn memory_of_process(pid: u32) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/statm")).ok()?;
    let pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}
