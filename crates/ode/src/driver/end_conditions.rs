//! What ends a run from outside of it: a flag, and a limit of wall-clock time.

use crate::options::Options;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Why a run was ended from outside of it. A system whose call takes long may look at a [`EndConditions`]
/// meanwhile, and at whatever else, and end the run: `Err(CallError::failed(stopped))`.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Stopped {
    /// The flag of [`Options::cancel`] was set: the run ends with [`ErrorKind::Cancelled`](crate::ErrorKind).
    #[error("cancelled")]
    Cancelled,
    /// This limit of wall-clock time was reached: [`ErrorKind::TimedOut`](crate::ErrorKind).
    #[error("the time limit of {} s was reached", .0.as_secs_f64())]
    TimedOut(Duration),
    /// The observer wishes it: a normal end, [`Termination::StoppedByObserver`](crate::Termination).
    #[error("stopped by the observer")]
    ByObserver,
}

/// Limit of wall-clock time and flag that end a run from outside of it.
#[derive(Debug, Clone, Copy)]
pub struct EndConditions<'a> {
    cancel: Option<&'a AtomicBool>,
    /// The limit, and when the run began.
    timeout: Option<(Duration, Instant)>,
}

impl<'a> EndConditions<'a> {
    /// For a run with these options that begins now.
    pub fn new(options: &'a Options) -> Self {
        Self {
            cancel: options.cancel.as_deref(),
            timeout: options.limits.timeout.map(|limit| (limit, Instant::now())),
        }
    }

    /// # Errors
    /// The run is to end, and why.
    #[inline]
    pub fn check(&self) -> Result<(), Stopped> {
        if self.cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed)) {
            return Err(Stopped::Cancelled);
        }
        match self.timeout {
            Some((limit, began)) if began.elapsed() >= limit => Err(Stopped::TimedOut(limit)),
            _ => Ok(()),
        }
    }
}
