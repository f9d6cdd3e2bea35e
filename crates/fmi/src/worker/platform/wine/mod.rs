//! Worker processes for models of Windows: a Windows program under Wine, for each worker.
//!
//! The worker maps the shared page by its name below `/proc`, connects to a port of the loopback interface,
//! and has the paths of this system on a drive of Wine. It ends the processes that it has started by itself.

mod connection;
mod process;

pub(in crate::worker) use connection::Connection;
pub(super) use process::{Group, begin, ended_in_words, memory_of};
