//! The order to a new process, on its standard input.

use crate::worker::handshake::Start;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Connection of a worker with its caller: a pair of sockets, because pipes have no time limits.
pub(in crate::worker) type Channel = std::net::TcpStream;

/// Order to become a worker. `S` is [`Start`] or a reference to it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Order<S> {
    /// Description of the worker's end of the channel.
    pub(super) socket: Vec<u8>,
    /// Number of the worker's handle of the shared page.
    pub(super) page: u64,
    pub(super) folder: PathBuf,
    pub(super) start: S,
}

/// The order as the worker receives it.
pub(super) type Received = Order<Start>;
