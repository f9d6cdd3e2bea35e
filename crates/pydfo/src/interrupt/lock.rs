//! Locks that ignore poisoning.

use std::sync::{Mutex, MutexGuard};

/// Locks a mutex. A poisoned lock is not an error, because the data under our locks are consistent at every
/// instant.
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}
