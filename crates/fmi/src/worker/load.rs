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

/// Number of a load, and of the load whose processes may serve it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct LoadId {
    pub(super) number: u64,
    pub(super) owner: u64,
    /// True if one worker with this load is kept, however long it is idle.
    pub(super) is_kept: bool,
}

/// Numbers of the [`Load`]s of this process.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Load {
    /// Creates a load from a function that returns the first frame for a worker. The frame is created
    /// whenever it is needed, and not stored.
    pub fn new(frame: impl Fn() -> io::Result<Frame> + Send + Sync + 'static) -> Self {
        let number = NEXT_ID.fetch_add(1, Ordering::Relaxed);
        Self { id: LoadId { number, owner: number, is_kept: false }, frame: Box::new(frame) }
    }

    /// Marks the load as belonging to the model of `owner`. Idle processes with the load `owner` then also
    /// serve it.
    #[must_use]
    pub fn in_processes_of(mut self, owner: &Self) -> Self {
        self.id.owner = owner.id.owner;
        self
    }

    /// Keeps one worker until the load is [forgotten](super::Workers::forget), because the worker has the
    /// final state of a simulation.
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
