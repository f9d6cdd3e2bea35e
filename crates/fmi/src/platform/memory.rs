//! Checks that memory for a large object is available before it is allocated. Systems may grant more memory
//! than they have, and then kill the process that uses it.

use crate::error::{FmiError, Result};
use std::fs;

/// Number of bytes that are allocated without a check.
const SMALL: u64 = 64 << 20;

/// Returns an error if `bytes` for `what` exceed the available memory.
///
/// # Errors
/// Returns [`FmiError::Memory`].
pub(crate) fn check(what: impl FnOnce() -> String, bytes: u64) -> Result<()> {
    if bytes <= SMALL {
        return Ok(());
    }
    let available = available_memory().unwrap_or(u64::MAX);
    // Limits of the process appear only when it requests the memory.
    let is_given = || usize::try_from(bytes).is_ok_and(|n| Vec::<u8>::new().try_reserve_exact(n).is_ok());
    if bytes < available && is_given() {
        return Ok(());
    }
    Err(FmiError::Memory { what: what(), bytes })
}

/// Returns an empty list with capacity for `n` items.
///
/// # Errors
/// Returns [`FmiError::Memory`].
pub(crate) fn list_of<T>(what: &str, n: usize) -> Result<Vec<T>> {
    let bytes = (n as u64).saturating_mul(size_of::<T>() as u64);
    check(|| what.to_owned(), bytes)?;
    let mut list = Vec::new();
    list.try_reserve_exact(n).map_err(|_| FmiError::Memory { what: what.to_owned(), bytes })?;
    Ok(list)
}

/// Returns the memory in bytes that is available without swapping; `None` if the system does not report it.
fn available_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
