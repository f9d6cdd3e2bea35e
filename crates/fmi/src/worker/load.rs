//! Data that a worker needs before its first request.

use super::frame::Frame;
use std::fmt;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};

/// Data that a worker needs before its first request.
pub struct Load {
    pub(super) id: u64,
    frame: Box<dyn Fn() -> io::Result<Frame> + Send + Sync>,
}

/// Numbers of the [`Load`]s of this process.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Load {
    /// A load from the frame that a worker receives before its first request; it is made whenever it is
    /// needed, and not kept.
    pub fn new(frame: impl Fn() -> io::Result<Frame> + Send + Sync + 'static) -> Self {
        Self { id: NEXT_ID.fetch_add(1, Ordering::Relaxed), frame: Box::new(frame) }
    }

    pub(super) fn frame(&self) -> io::Result<Frame> {
        (self.frame)()
    }
}

impl fmt::Debug for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Load").field("id", &self.id).finish_non_exhaustive()
    }
}
