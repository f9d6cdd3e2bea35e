//! The wish to end work early, told from another thread: what opening, unpacking and compiling look at.

use crate::error::FmiError;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that ends work early once it is raised; by default there is none, and work runs to its end.
///
/// Two of them count as equal: when work is to end is no property of its result.
#[derive(Debug, Clone, Default)]
pub struct Cancel(Option<Arc<AtomicBool>>);

impl Cancel {
    /// Work ends, with [`FmiError::Cancelled`], soon after somebody has raised `flag`.
    pub fn when(flag: Arc<AtomicBool>) -> Self {
        Self(Some(flag))
    }

    /// Whether the flag is raised.
    pub fn is_asked(&self) -> bool {
        self.0.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// The error, if the flag is raised.
    pub(crate) fn check(&self) -> Result<(), FmiError> {
        if self.is_asked() { Err(FmiError::Cancelled) } else { Ok(()) }
    }
}

impl From<Option<Arc<AtomicBool>>> for Cancel {
    fn from(flag: Option<Arc<AtomicBool>>) -> Self {
        Self(flag)
    }
}

impl PartialEq for Cancel {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Cancel {}
