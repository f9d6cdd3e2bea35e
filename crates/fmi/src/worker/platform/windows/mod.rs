//! Worker processes on Windows: each one is a new process in its own job object.

mod order;
mod process;
mod this_worker;

pub(in crate::worker) use order::Channel;
pub(in crate::worker) use process::{ProcessHandle, Starter};
pub(in crate::worker) use this_worker::{await_order, limit_self, wait_until_closed};

/// True: processes can be started.
pub(in crate::worker) const HAS_WORKERS: bool = true;
