//! A request to end work early, made by another thread: opening, unpacking and compiling look at it.

use crate::error::{FmiError, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A flag or a time that ends work early; by default there is none, and work runs to its end.
///
/// Two of them count as equal: when work is to end is no property of its result.
#[derive(Debug, Clone, Default)]
pub struct CancelRequest {
    flag: Option<Arc<AtomicBool>>,
    at: Option<Instant>,
}

impl CancelRequest {
    /// Work ends, with [`FmiError::Cancelled`], soon after `flag` was raised.
    pub fn when(flag: Arc<AtomicBool>) -> Self {
        Self { flag: Some(flag), at: None }
    }

    /// Work ends in the same way soon after that time, as measured from now.
    pub fn after(time: Duration) -> Self {
        Self { flag: None, at: Instant::now().checked_add(time) }
    }

    /// True if the flag is set, or the time limit has passed.
    pub fn is_asked(&self) -> bool {
        self.flag.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed))
            || self.at.is_some_and(|at| Instant::now() >= at)
    }

    /// The error, if work is to end.
    pub(crate) fn check(&self) -> Result<()> {
        if self.is_asked() { Err(FmiError::Cancelled) } else { Ok(()) }
    }
}

impl From<Option<Arc<AtomicBool>>> for CancelRequest {
    fn from(flag: Option<Arc<AtomicBool>>) -> Self {
        Self { flag, at: None }
    }
}

impl PartialEq for CancelRequest {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for CancelRequest {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_ends_by_a_flag_or_at_a_time() {
        let flag = Arc::new(AtomicBool::new(false));
        let cancel = CancelRequest::when(Arc::clone(&flag));
        assert!(!cancel.is_asked() && !CancelRequest::default().is_asked());
        flag.store(true, Ordering::Relaxed);
        assert!(matches!(cancel.check(), Err(FmiError::Cancelled)));
        assert!(
            !CancelRequest::after(Duration::from_secs(3600)).is_asked()
                && !CancelRequest::after(Duration::MAX).is_asked()
        );
        assert!(CancelRequest::after(Duration::ZERO).is_asked());
    }
}
