//! Data that a worker needs before its first request.

use super::frame::Frame;
use std::fmt;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// Data that a worker needs before its first request.
pub struct Load {
    pub(super) id: LoadId,
    frame: Box<dyn Fn() -> io::Result<Frame> + Send + Sync>,
}

/// Number of a load, and of the one in whose processes it is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LoadId {
    pub(super) number: u64,
    pub(super) owner: u64,
    /// One idle worker of it is not ended, however long nobody asks.
    pub(super) is_kept: bool,
}

/// Numbers of the [`Load`]s of this process.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Load {
    /// A load from the frame that a worker receives before its first request; it is made whenever it is
    /// needed, and not kept.
    pub fn new(frame: impl Fn() -> io::Result<Frame> + Send + Sync + 'static) -> Self {
        let number = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        Self { id: LoadId { number, owner: number, is_kept: false }, frame: Box::new(frame) }
    }

    /// The same, of the same model: where processes that have loaded `owner` are idle, they are asked.
    #[must_use]
    pub fn in_processes_of(mut self, owner: &Self) -> Self {
        self.id.owner = owner.id.owner;
        self
    }

    /// The same, with one worker that is kept until the load is [forgotten](super::Workers::forget): it holds
    /// the end of a simulation.
    #[must_use]
    pub fn kept(mut self) -> Self {
        self.id.is_kept = true;
        self
    }

    pub(super) fn frame(&self) -> io::Result<Frame> {
        (self.frame)()
    }
}

impl fmt::Debug for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Load").field("id", &self.id.number).finish_non_exhaustive()
    }
}
