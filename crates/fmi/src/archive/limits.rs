//! Limits on the contents of an archive.

use crate::error::{FmiError, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Limits on the contents of an archive. The defaults are far above the size of any real FMU, and reject
/// archives made to fill a disk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArchiveLimits {
    /// Maximum number of files and folders (default 100 000).
    pub entries: u64,
    /// Maximum number of folders, including folders without a separate entry (default 10 000).
    pub folders: u64,
    /// Maximum unpacked size of one file in bytes (default 2 GiB).
    pub file_bytes: u64,
    /// Maximum unpacked size of all files in bytes (default 4 GiB).
    pub total_bytes: u64,
    /// Maximum ratio of unpacked to packed size, for each file and for all files (default 200). The ratio is
    /// not checked up to [`ratio_free_bytes`](Self::ratio_free_bytes), because text tables compress well.
    pub ratio: u64,
    /// Unpacked size in bytes up to which the ratio is not checked (default 256 MiB).
    pub ratio_free_bytes: u64,
}

impl Default for ArchiveLimits {
    fn default() -> Self {
        ArchiveLimits {
            entries: 100_000,
            folders: 10_000,
            file_bytes: 2 << 30,
            total_bytes: 4 << 30,
            ratio: 200,
            ratio_free_bytes: 256 << 20,
        }
    }
}

impl ArchiveLimits {
    /// Rejects entries with these compressed and unpacked sizes if their totals are too large.
    pub(super) fn check_totals(&self, path: &Path, sizes: impl Iterator<Item = (u64, u64)>) -> Result<()> {
        let add = |sum: (u64, u64), entry: (u64, u64)| {
            (sum.0.saturating_add(entry.0), sum.1.saturating_add(entry.1))
        };
        let (compressed, size) = sizes.fold((0, 0), add);
        check_limit(path, "unpacked bytes", size, self.total_bytes)?;
        if self.inflates_too_much(compressed, size) {
            let ratio = size.div_ceil(compressed.max(1));
            check_limit(path, "unpacked bytes per packed byte", ratio, self.ratio)?;
        }
        Ok(())
    }

    pub(super) fn inflates_too_much(&self, compressed: u64, size: u64) -> bool {
        size > self.ratio_free_bytes && size / self.ratio.max(1) > compressed
    }
}

pub(super) fn check_limit(path: &Path, what: &'static str, found: u64, limit: u64) -> Result<()> {
    if found <= limit {
        return Ok(());
    }
    Err(FmiError::ArchiveLimit { path: path.to_owned(), what, found, limit })
}
