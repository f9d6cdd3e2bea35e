//! Atomic writing of files: either the complete new file exists, or the old one.

use crate::error::FmiError;
use base::files::AtomicFile;
use std::fs::File;
use std::path::Path;

/// Writes a file atomically, with [`AtomicFile`]. `fill` receives a temporary file and its path. If `fill`
/// succeeds, the temporary file replaces `out`. Otherwise it is removed, and an existing file is unchanged.
///
/// # Errors
/// Returns the errors of `fill`, and [`FmiError::Io`] for errors of the operating system. For example, the
/// folder may not exist or may not be writable, or `out` may be a folder or read-only.
pub fn fill_atomically<E: From<FmiError>>(
    out: &Path,
    fill: impl FnOnce(&File, &Path) -> Result<(), E>,
) -> Result<(), E> {
    let unfinished = AtomicFile::new(out).map_err(FmiError::io("write", out))?;
    fill(unfinished.file(), unfinished.path())?;
    Ok(unfinished.finish().map_err(FmiError::io("write", out))?)
}
