//! Check that memory for a large object is available, before it is allocated: systems promise more than they
//! have, and end the process that uses it.

use crate::error::{FmiError, Result};
use std::fs;

/// Bytes that are allocated without a check.
const SMALL: u64 = 64 << 20;

/// Refuses to go on if `bytes` for `what` are more than is available.
///
/// # Errors
/// [`FmiError::Memory`].
pub(crate) fn check(what: impl FnOnce() -> String, bytes: u64) -> Result<()> {
    if bytes <= SMALL {
        return Ok(());
    }
    let available = available_memory().unwrap_or(u64::MAX);
    // Limits of the process itself show when it asks for as much.
    let is_given = || usize::try_from(bytes).is_ok_and(|n| Vec::<u8>::new().try_reserve_exact(n).is_ok());
    if bytes < available && is_given() {
        return Ok(());
    }
    Err(FmiError::Memory { what: what(), bytes })
}

/// Room for `n` items in an empty list.
///
/// # Errors
/// [`FmiError::Memory`].
pub(crate) fn list_of<T>(what: &str, n: usize) -> Result<Vec<T>> {
    let bytes = (n as u64).saturating_mul(size_of::<T>() as u64);
    check(|| what.to_owned(), bytes)?;
    let mut list = Vec::new();
    list.try_reserve_exact(n).map_err(|_| FmiError::Memory { what: what.to_owned(), bytes })?;
    Ok(list)
}

/// Bytes of memory that can be had without pushing others out; `None` where the system does not say.
fn available_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
}
