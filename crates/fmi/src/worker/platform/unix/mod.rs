//! Worker processes on Unix: a template is started once, and forks itself whenever a worker is needed.

mod end;
mod fork_server;
mod fork_server_main;
mod orders;
mod own_process;
mod process;

pub(in crate::worker) use fork_server::Starter;
pub(in crate::worker) use fork_server_main::await_order;
pub(in crate::worker) use own_process::{limit_self, wait_until_closed};
pub(in crate::worker) use process::ProcessHandle;

/// Connection of a worker with its caller: a socket pair.
pub(in crate::worker) type Channel = std::os::unix::net::UnixStream;

/// True: a program that serves can be started as a template.
pub(in crate::worker) const HAS_WORKERS: bool = true;
