//! Worker processes on Windows: each one is a new process in its own job object.

mod channel;
mod process;
mod this_worker;

pub(super) use crate::sys::windows::memory_of;
pub(in crate::worker) use channel::{Channel, Connection};
pub(super) use process::{Group, begin};
pub(in crate::worker) use this_worker::{await_order, limit_self, wait_until_closed};

/// True: processes can be started.
pub(in crate::worker) const HAS_WORKERS: bool = true;

/// Describes how a process ended.
pub(super) fn ended_in_words(status: std::process::ExitStatus) -> String {
    let code = status.code().map(i32::cast_unsigned);
    code.map_or_else(|| "the process ended".to_owned(), crate::worker::exceptions::in_words)
}
