//! Checks of the files that a command writes.

use crate::error::Error;
use std::path::{Path, PathBuf};

/// Rejects output files that the command also reads, one file for two results, and paths that cannot be
/// written.
pub(crate) fn check_written<'p>(
    written: impl IntoIterator<Item = &'p PathBuf>,
    read: &[PathBuf],
) -> Result<(), Error> {
    let place = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let read: Vec<PathBuf> = read.iter().map(|path| place(path)).collect();
    let mut earlier = Vec::new();
    for path in written {
        let (target, shown) = (place(path), path.display());
        if is_stream(path) {
            return Err(Error::input("'-' is not a file; specify a file name for this result"));
        } else if read.contains(&target) {
            return Err(Error::input(format!(
                "{shown} is an input of this command; specify another file to write"
            )));
        } else if earlier.contains(&target) {
            return Err(Error::input(format!(
                "{shown} would be written twice; specify a separate file for each result"
            )));
        }
        // Reported now, not after hours of work. A pipe can be opened only once, so it is not tested.
        if !std::fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir()) {
            drop(base::files::AtomicFile::new(path).map_err(Error::write(path))?);
        }
        earlier.push(target);
    }
    Ok(())
}

/// True for `-`: a standard stream.
pub(crate) fn is_stream(path: &Path) -> bool {
    path == Path::new("-")
}
