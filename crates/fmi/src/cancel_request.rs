//! A request to cancel work. Opening, unpacking and compiling check it regularly.

use crate::error::{FmiError, Result};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A function that cancels work. The default has no function, so work is never cancelled.
///
/// Two requests always compare equal, because cancellation does not affect the result of the work.
#[derive(Clone, Default)]
pub struct CancelRequest(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl CancelRequest {
    /// Creates a request from a function. The working thread calls it from time to time. If it returns true,
    /// the work ends with [`FmiError::Cancelled`].
    pub fn polling(ask: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(ask)))
    }

    /// Creates a request that cancels the work soon after `flag` is set.
    pub fn when(flag: Arc<AtomicBool>) -> Self {
        Self::polling(move || flag.load(Ordering::Relaxed))
    }

    /// True if cancellation is requested.
    pub fn is_requested(&self) -> bool {
        self.0.as_ref().is_some_and(|ask| ask())
    }

    /// Returns [`FmiError::Cancelled`] if cancellation is requested.
    pub(crate) fn check(&self) -> Result<()> {
        if self.is_requested() { Err(FmiError::Cancelled) } else { Ok(()) }
    }
}

impl fmt::Debug for CancelRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("CancelRequest")
    }
}

impl From<Option<Arc<AtomicBool>>> for CancelRequest {
    fn from(flag: Option<Arc<AtomicBool>>) -> Self {
        flag.map_or_else(Self::default, Self::when)
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
    fn cancel_request_is_set_by_flag_or_function() {
        let flag = Arc::new(AtomicBool::new(false));
        let cancel = CancelRequest::when(Arc::clone(&flag));
        assert!(!cancel.is_requested() && !CancelRequest::default().is_requested());
        flag.store(true, Ordering::Relaxed);
        assert!(matches!(cancel.check(), Err(FmiError::Cancelled)));
        assert!(CancelRequest::polling(|| true).is_requested() && !CancelRequest::from(None).is_requested());
    }
}
