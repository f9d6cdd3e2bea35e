//! The order to a separate process, on its standard input.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Order to become a worker. `S` is [`Start`](crate::worker::handshake::Start) or a reference to it.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Order<S> {
    pub(super) shared: Shared,
    pub(super) folder: PathBuf,
    pub(super) start: S,
}

/// What a worker shares with its caller.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Shared {
    /// The caller is a process of Windows.
    Handles {
        /// Description of the worker's end of the channel.
        socket: Vec<u8>,
        /// Number of the worker's handle of the shared page.
        page: u64,
    },
    /// The caller is a process of the system on which Wine runs.
    Names {
        /// Port at which the caller waits for the worker.
        port: u16,
        /// First bytes that the worker sends, so that no other process is taken for it.
        key: Key,
        /// Path of the file with the shared page.
        page: PathBuf,
    },
}

pub(super) type Key = [u8; 16];
