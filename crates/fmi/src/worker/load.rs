//! Data that a worker needs before its first request.

use super::frame::Frame;
use std::sync::atomic::{AtomicU64, Ordering};

/// Data that a worker needs before its first request.
#[derive(Debug)]
pub struct Load {
    pub(super) id: u64,
    pub(super) frame: Frame,
}

/// Numbers of the [`Load`]s of this process.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Load {
    /// A load from the frame that a worker receives before its first request.
    pub fn new(frame: Frame) -> Self {
        Self { id: NEXT_ID.fetch_add(1, Ordering::Relaxed), frame }
    }
}
