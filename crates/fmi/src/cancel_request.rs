//! A request to end work early: opening, unpacking and compiling look at it.

use crate::error::{FmiError, Result};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A function that ends work early; by default there is none, and work runs to its end.
///
/// Two of them count as equal: when work is to end is no property of its result.
#[derive(Clone, Default)]
pub struct CancelRequest(Option<Arc<dyn Fn() -> bool + Send + Sync>>);

impl CancelRequest {
    /// Work ends, with [`FmiError::Cancelled`], when this function, which the thread that works calls now and
    /// then, returns true.
    pub fn asking(ask: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(ask)))
    }

    /// The same, soon after `flag` was raised.
    pub fn when(flag: Arc<AtomicBool>) -> Self {
        Self::asking(move || flag.load(Ordering::Relaxed))
    }

    /// True if the work is to end.
    pub fn is_asked(&self) -> bool {
        self.0.as_ref().is_some_and(|ask| ask())
    }

    /// The error, if work is to end.
    pub(crate) fn check(&self) -> Result<()> {
        if self.is_asked() { Err(FmiError::Cancelled) } else { Ok(()) }
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
    fn work_ends_by_a_flag_or_a_function() {
        let flag = Arc::new(AtomicBool::new(false));
        let cancel = CancelRequest::when(Arc::clone(&flag));
        assert!(!cancel.is_asked() && !CancelRequest::default().is_asked());
        flag.store(true, Ordering::Relaxed);
        assert!(matches!(cancel.check(), Err(FmiError::Cancelled)));
        assert!(CancelRequest::asking(|| true).is_asked() && !CancelRequest::from(None).is_asked());
    }
}
