//! Worker processes on Unix: a template is started once, and forks itself whenever a worker is needed.

mod end;
mod fork_server;
mod fork_server_main;
mod orders;
mod process;
mod this_worker;

#[cfg(target_os = "linux")]
pub(super) use end::in_words;
pub(in crate::worker) use fork_server::Starter;
pub(in crate::worker) use fork_server_main::await_order;
pub(in crate::worker) use process::ProcessHandle;
#[cfg(target_os = "linux")]
pub(super) use process::memory_of_process;
pub(in crate::worker) use this_worker::{limit_self, wait_until_closed};

/// Connection of a worker with its caller: a socket pair.
pub(in crate::worker) type Channel = std::os::unix::net::UnixStream;
#[cfg(not(target_os = "linux"))]
pub(in crate::worker) type Connection = Channel;

/// True: a program that serves can be started as a template.
pub(in crate::worker) const HAS_WORKERS: bool = true;
