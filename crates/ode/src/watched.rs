//! A system that answers no more once the run was cancelled or its time is up, so that a long step ends as well.

use crate::error::ErrorKind;
use crate::jacobian::JacobianPattern;
use crate::options::Options;
use crate::system::{
    CallError, CallResult, EventOutcome, EventVisit, HybridSystem, InputStop, StepAction, evaluations,
    hand_on,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Why a [`Watched`] system does not answer.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(crate) enum Stopped {
    #[error("cancelled")]
    Cancelled,
    #[error("the time limit was reached")]
    TimedOut(Duration),
}

impl From<Stopped> for ErrorKind {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Cancelled => Self::Cancelled,
            Stopped::TimedOut(limit) => Self::TimedOut(limit),
        }
    }
}

/// What ends a run from outside of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Watch<'a> {
    cancel: Option<&'a AtomicBool>,
    /// The limit, and when the run began.
    timeout: Option<(Duration, Instant)>,
}

impl<'a> Watch<'a> {
    /// For a run that begins now.
    pub(crate) fn new(options: &'a Options) -> Self {
        Self {
            cancel: options.cancel.as_deref(),
            timeout: options.limits.timeout.map(|limit| (limit, Instant::now())),
        }
    }

    pub(crate) fn check(&self) -> Result<(), Stopped> {
        if self.cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed)) {
            return Err(Stopped::Cancelled);
        }
        match self.timeout {
            Some((limit, began)) if began.elapsed() >= limit => Err(Stopped::TimedOut(limit)),
            _ => Ok(()),
        }
    }
}

/// A system under watch.
pub(crate) struct Watched<'a, S: ?Sized> {
    pub(crate) system: &'a mut S,
    pub(crate) watch: Watch<'a>,
}

impl<S: HybridSystem + ?Sized> HybridSystem for Watched<'_, S> {
    hand_on!(self, self.system);
    evaluations!(self, self.system, self.watch.check().map_err(CallError::failed)?);
}

/// The error behind a call that failed.
pub(crate) fn kind_of(error: Box<dyn std::error::Error + Send + Sync>) -> ErrorKind {
    match error.downcast::<Stopped>() {
        Ok(stopped) => (*stopped).into(),
        Err(error) => ErrorKind::Model(error),
    }
}
