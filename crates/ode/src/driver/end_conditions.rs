//! Conditions that end a run from outside: a flag and a limit on the wall-clock time.

use crate::options::Options;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Reason why a run was ended from outside. A system with long calls may check [`EndConditions`] or other
/// conditions during a call. It ends the run by returning `Err(CallError::failed(stopped))`.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Stopped {
    /// The flag [`Options::cancel`] was set. The run ends with [`ErrorKind::Cancelled`](crate::ErrorKind).
    #[error("cancelled")]
    Cancelled,
    /// This limit on the wall-clock time was reached. The run ends with
    /// [`ErrorKind::TimedOut`](crate::ErrorKind).
    #[error("the time limit of {} s was reached", .0.as_secs_f64())]
    TimedOut(Duration),
    /// The observer requested the end. This is a normal end,
    /// [`Termination::StoppedByObserver`](crate::Termination).
    #[error("stopped by the observer")]
    ByObserver,
}

/// Limit on the wall-clock time and flag that end a run from outside.
#[derive(Debug, Clone, Copy)]
pub struct EndConditions<'a> {
    cancel: Option<&'a AtomicBool>,
    /// The limit and the start time of the run.
    timeout: Option<(Duration, Instant)>,
}

impl<'a> EndConditions<'a> {
    /// Creates the conditions for a run with these options that starts now.
    pub fn new(options: &'a Options) -> Self {
        Self {
            cancel: options.cancel.as_deref(),
            timeout: options.limits.timeout.map(|limit| (limit, Instant::now())),
        }
    }

    /// # Errors
    /// Returns the reason if the run must end.
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
