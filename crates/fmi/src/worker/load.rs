//! What a worker has to know before it can be asked for anything.

use super::frame::Frame;
use std::sync::atomic::{AtomicU64, Ordering};

/// What a worker has to know before it can be asked.
#[derive(Debug)]
pub struct Load {
    pub(super) id: u64,
    pub(super) frame: Frame,
}

/// Numbers of the [`Load`]s of this process.
static NEXT_ID: AtomicU64 = AtomicU64::new(1);

impl Load {
    /// What a worker is to load before it is asked.
    pub fn new(frame: Frame) -> Self {
        Self { id: NEXT_ID.fetch_add(1, Ordering::Relaxed), frame }
    }
}
