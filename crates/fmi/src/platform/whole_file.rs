//! Files that are written in one step: there is the whole of the new one, or the old one.

use super::system::with_usual_permissions;
use crate::error::FmiError;
use std::fs::File;
use std::path::Path;

/// Writes a file in one step. `fill` writes to a temporary file beside it, of which it gets the path as well; where it
/// succeeds, that file is flushed to the disk and takes the name `out`. Else nothing stays, and a file that was there before
/// is left as it was.
///
/// # Errors
/// Those of `fill`; [`FmiError::Io`] for what the system refuses: the folder is not there or not writable, `out` is a folder.
pub fn write_whole<E: From<FmiError>>(
    out: &Path,
    fill: impl FnOnce(&File, &Path) -> Result<(), E>,
) -> Result<(), E> {
    let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let suffix = out.extension().map(|extension| format!(".{}", extension.to_string_lossy()));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".fmufit-").suffix(suffix.as_deref().unwrap_or_default());
    let create = |source| FmiError::io("create a file in", parent)(source);
    let unfinished = with_usual_permissions(&mut builder).tempfile_in(parent).map_err(create)?;
    fill(unfinished.as_file(), unfinished.path())?;
    unfinished.as_file().sync_all().map_err(FmiError::io("write", out))?;
    unfinished.persist(out).map_err(|error| FmiError::io("write", out)(error.error))?;
    Ok(())
}
