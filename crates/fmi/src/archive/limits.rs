//! Limits on the contents of an archive, and the name of the file that it must hold.

use serde::{Deserialize, Serialize};

/// Name of the file every FMU has at its root.
pub(crate) const MODEL_DESCRIPTION: &str = "modelDescription.xml";

/// Limits on the contents of an archive. The defaults are far above any real FMU, and stop archives made to
/// fill a disk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArchiveLimits {
    /// Files and folders (default 100 000).
    pub entries: u64,
    /// Folders, those included that have no entry of their own (default 10 000).
    pub folders: u64,
    /// Unpacked bytes of one file (default 2 GiB).
    pub file_bytes: u64,
    /// Unpacked bytes of all files (default 4 GiB).
    pub total_bytes: u64,
    /// Unpacked bytes per packed byte, for one file and for all (default 200). Text tables pack well:
    /// what unpacks to less than [`ratio_free_bytes`](Self::ratio_free_bytes) is not asked.
    pub ratio: u64,
    /// Unpacked bytes up to which the ratio does not matter (default 256 MiB).
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
