//! Files that are written in one step: there is the whole of the new one, or the old one.

use crate::error::FmiError;
use base::files::AtomicFile;
use std::fs::File;
use std::path::Path;

/// Writes a file in one step, as [`AtomicFile`] says. `fill` writes to a temporary file, of which it gets the
/// path as well; where it succeeds, that file takes the place `out`. Else nothing stays, and a file that was
/// there before is left as it was.
///
/// # Errors
/// Those of `fill`; [`FmiError::Io`] for what the system refuses: the folder is not there or not writable,
/// `out` is a folder or read-only.
pub fn fill_atomically<E: From<FmiError>>(
    out: &Path,
    fill: impl FnOnce(&File, &Path) -> Result<(), E>,
) -> Result<(), E> {
    let unfinished = AtomicFile::new(out).map_err(FmiError::io("write", out))?;
    fill(unfinished.file(), unfinished.path())?;
    Ok(unfinished.finish().map_err(FmiError::io("write", out))?)
}
