//! Locks of temporary folders. A file in a folder is locked by the process that owns the folder, so that a
//! later process recognizes and removes the folders that killed processes have left behind.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;

/// Name of the lock file in a folder.
pub(crate) const LOCK: &str = "lock";
/// Temporary name of a lock file before it is complete.
pub(crate) const NEW_LOCK: &str = "lock.new";
/// Content of a lock file. Files with other contents are not ours.
pub(crate) const MARK: &[u8] = b"fmufit: this folder goes with the process that locks this file\n";

/// Creates a lock file. It is locked before it has this name. Returns `None`, and leaves no file, if it
/// cannot be created or locked.
pub(crate) fn new_lock(path: &Path) -> Option<File> {
    let unnamed = path.with_file_name(NEW_LOCK);
    let file = File::create_new(&unnamed).ok()?;
    let is_made = (&file).write_all(MARK).is_ok() && file.try_lock().is_ok();
    if is_made && fs::rename(&unnamed, path).is_ok() {
        return Some(file);
    }
    drop(file);
    let _ = fs::remove_file(&unnamed);
    None
}

/// True if this is a lock file of ours, and the process that locked it has ended.
pub(crate) fn is_left_behind(lock: &Path) -> bool {
    let Ok(mut file) = base::files::open_of_user(lock) else { return false };
    let mut content = Vec::new();
    let is_read = (&mut file).take(MARK.len() as u64 + 1).read_to_end(&mut content).is_ok();
    is_read && content == MARK && file.try_lock().is_ok()
}
