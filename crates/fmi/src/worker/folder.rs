//! The folders of worker processes.

use crate::platform::private_folder_builder;
#[cfg(any(windows, target_os = "linux"))]
use crate::platform::{LOCK, file_of_user, is_left_behind, keep_others_out, new_lock};
#[cfg(any(windows, target_os = "linux"))]
use std::fs::{DirEntry, File};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

/// The folder of a template or of a starter. It is removed when this value is dropped in the process that
/// created it.
#[derive(Debug)]
pub(super) struct Folder {
    path: PathBuf,
    owner: u32,
    /// Locked until the folder is removed. `None` for a template, or if the file system has no locks.
    #[cfg(any(windows, target_os = "linux"))]
    lock: Option<File>,
}

/// Beginning of the names of all folders.
const PREFIX: &str = "fmufit-worker-";

/// Number of folders that this process has created.
static N_MADE: AtomicU32 = AtomicU32::new(0);

impl Folder {
    /// Creates a folder in the folder for temporary files.
    pub(super) fn new() -> std::io::Result<Self> {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let (owner, n) = (std::process::id(), N_MADE.fetch_add(1, Ordering::Relaxed));
        let name = format!("{PREFIX}{owner}-{n}-{:x}", since.as_nanos());
        let path = std::env::temp_dir().join(name);
        let path = worker_folder(&std::path::absolute(&path).unwrap_or(path), 0);
        make(&path)?;
        Ok(Self {
            path,
            owner,
            #[cfg(any(windows, target_os = "linux"))]
            lock: None,
        })
    }

    /// Creates a folder, and removes those of starters whose process was killed, with the folders of their
    /// workers. No other process removes them.
    #[cfg(any(windows, target_os = "linux"))]
    pub(super) fn of_starter() -> std::io::Result<Self> {
        remove_abandoned(&std::env::temp_dir());
        let mut folder = Self::new()?;
        folder.lock = new_lock(&folder.path.join(LOCK));
        Ok(folder)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if self.owner == std::process::id() {
            // Windows does not remove open files.
            #[cfg(any(windows, target_os = "linux"))]
            drop(self.lock.take());
            remove(&self.path);
        }
    }
}

/// Returns the folder of a worker, from the folder of its template or of another worker. The name has the
/// same length.
pub(super) fn worker_folder(template: &Path, number: u32) -> PathBuf {
    template.with_extension(format!("{number:010}"))
}

/// Removes the folders of starters whose process has ended, and the folders of their workers. Folders of
/// other users are not changed. The lock of a file ends with the process that has it, also if that process
/// cannot be seen from here.
#[cfg(any(windows, target_os = "linux"))]
fn remove_abandoned(temporary: &Path) {
    let Ok(user_file) = file_of_user() else { return };
    let listed = std::fs::read_dir(temporary).into_iter().flatten().flatten();
    let is_folder = |entry: &DirEntry| entry.file_type().is_ok_and(|kind| kind.is_dir());
    let is_named = |entry: &DirEntry| entry.file_name().as_encoded_bytes().starts_with(PREFIX.as_bytes());
    let named = listed.filter(is_named).filter(is_folder).map(|entry| entry.path());
    let folders: Vec<PathBuf> = named.filter(|path| keep_others_out(path, &user_file).is_ok()).collect();
    for starter in folders.iter().filter(|path| **path == worker_folder(path, 0)) {
        // An incomplete folder of another process has no such file yet.
        if is_left_behind(&starter.join(LOCK)) {
            let is_of_starter = |path: &&PathBuf| path.file_stem() == starter.file_stem();
            folders.iter().filter(is_of_starter).for_each(|path| remove(path));
        }
    }
}

/// Creates a folder that only this user can access. The error contains its path.
pub(super) fn make(folder: &Path) -> std::io::Result<()> {
    let named = |error: std::io::Error| {
        let problem = format!("TMPDIR: cannot create the folder {}: {error}", folder.display());
        std::io::Error::new(error.kind(), problem)
    };
    private_folder_builder().create(folder).map_err(named)
}

/// Removes a folder in which other processes may still create files. A confined worker can only empty the
/// folder; its parent process removes it.
pub(super) fn remove(folder: &Path) {
    for _ in 0..100 {
        match std::fs::remove_dir_all(folder) {
            Err(error) if error.kind() != ErrorKind::PermissionDenied && folder.exists() => {}
            _ => return,
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

#[cfg(test)]
#[cfg(any(windows, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn folders_of_ended_starters_are_removed() {
        let temporary = tempfile::tempdir().unwrap();
        let starter = |name: &str| worker_folder(&temporary.path().join(format!("{PREFIX}{name}")), 0);
        let (ended, running, incomplete) = (starter("1-0-a"), starter("2-0-b"), starter("3-0-c"));
        let (unmarked, other) = (starter("4-0-d"), temporary.path().join("other.0000000000"));
        let (of_ended, of_running) = (worker_folder(&ended, 1), worker_folder(&running, 1));
        let kept = [&running, &of_running, &incomplete, &unmarked, &other];
        for folder in [&ended, &of_ended].into_iter().chain(kept) {
            make(folder).unwrap();
        }
        let lock = new_lock(&running.join(LOCK));
        assert!(lock.is_some());
        drop([&ended, &other].map(|folder| new_lock(&folder.join(LOCK)).unwrap()));
        std::fs::write(unmarked.join(LOCK), "of another program").unwrap();
        remove_abandoned(temporary.path());
        assert!(!ended.exists() && !of_ended.exists());
        assert!(kept.iter().all(|folder| folder.exists()));
    }
}
