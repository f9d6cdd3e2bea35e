//! The ends of processes.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::Pid;
use std::os::fd::OwnedFd;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::time::Duration;

/// Time between two checks of a process whose end no system call reports.
const LOOK: Duration = Duration::from_millis(10);

/// Handle for the end of a process. A process keeps its process id until it is waited for. If the system has
/// no such handle (`None`), only the socket reports the end, shortly before the process ends.
#[derive(Debug, Default)]
pub(super) struct ProcessEnd(Option<OwnedFd>);

impl ProcessEnd {
    /// Returns the handle for a child of this process, or for a child of a child.
    #[cfg(target_os = "linux")]
    pub(super) fn of(pid: Pid) -> Self {
        Self(rustix::process::pidfd_open(pid, rustix::process::PidfdFlags::empty()).ok())
    }

    #[cfg(not(target_os = "linux"))]
    pub(super) fn of(_: Pid) -> Self {
        Self(None)
    }

    /// True if the process ends within this time.
    pub(super) fn is_over_within(&self, longest: Duration) -> bool {
        let Some(end) = &self.0 else {
            std::thread::sleep(longest.min(LOOK));
            return !longest.is_zero();
        };
        let longest = Timespec { tv_sec: longest.as_secs() as i64, tv_nsec: longest.subsec_nanos().into() };
        matches!(poll(&mut [PollFd::new(end, PollFlags::IN)], Some(&longest)), Ok(n) if n > 0)
    }
}

/// Describes how a process ended.
pub(in crate::worker) fn in_words(status: ExitStatus) -> String {
    let signal = status.signal();
    match (signal, status.code()) {
        (Some(libc::SIGSEGV), _) => "segmentation fault".to_owned(),
        (Some(libc::SIGABRT), _) => "abort".to_owned(),
        (Some(libc::SIGBUS), _) => "bus error".to_owned(),
        (Some(libc::SIGFPE), _) => "arithmetic exception".to_owned(),
        (Some(libc::SIGILL), _) => "illegal instruction".to_owned(),
        (Some(libc::SIGKILL), _) => "killed by another process, or out of memory".to_owned(),
        (Some(libc::SIGXCPU | libc::SIGXFSZ), _) => "a resource limit was reached".to_owned(),
        (Some(signal), _) => format!("signal {signal}"),
        (None, Some(code)) => format!("the process called exit({code})"),
        (None, None) => "the process ended".to_owned(),
    }
}
