//! The folders of worker processes.

use crate::platform::private_folder_builder;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

/// The folder of a template. It is removed when this value is dropped in the process that created it.
#[derive(Debug)]
pub(super) struct Folder {
    path: PathBuf,
    owner: u32,
}

/// Number of folders that this process has created.
static N_MADE: AtomicU32 = AtomicU32::new(0);

impl Folder {
    /// Creates a folder in the folder for temporary files.
    pub(super) fn new() -> std::io::Result<Self> {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let (owner, n) = (std::process::id(), N_MADE.fetch_add(1, Ordering::Relaxed));
        let name = format!("fmufit-worker-{owner}-{n}-{:x}", since.as_nanos());
        let path = std::env::temp_dir().join(name);
        let path = worker_folder(&std::path::absolute(&path).unwrap_or(path), 0);
        make(&path)?;
        Ok(Self { path, owner })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if self.owner == std::process::id() {
            remove(&self.path);
        }
    }
}

/// Returns the folder of a worker, from the folder of its template or of another worker. The name has the
/// same length.
pub(super) fn worker_folder(template: &Path, number: u32) -> PathBuf {
    template.with_extension(format!("{number:010}"))
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
