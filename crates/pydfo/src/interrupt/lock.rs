//! Locks whose poison says nothing.

use std::sync::{Mutex, MutexGuard};

/// Locks a mutex. A poisoned lock is no reason to fail: what we keep under locks is whole at every instant.
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}
