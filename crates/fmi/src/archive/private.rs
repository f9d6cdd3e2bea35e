//! Private folders for unpacked archives. They are removed with their value, or by a later process if this
//! process is killed.
//!
//! The folder `fmufit-unpacked-XXXXXX/fmu/` is the folder that callers receive. The file
//! `fmufit-unpacked-XXXXXX/lock` contains text that marks the folder as ours, and is locked by the process
//! that owns the folder. Folders with any other layout are never removed.

use crate::error::{FmiError, Result};
use crate::platform::{self, LOCK, MARK, NEW_LOCK, is_left_behind, new_lock};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;
use tempfile::TempDir;

const PREFIX: &str = platform::PRIVATE_PREFIX;
const INSIDE: &str = "fmu";

/// A private folder of this process.
#[derive(Debug)]
pub(crate) struct PrivateFolder {
    folder: Option<TempDir>,
    inside: PathBuf,
    /// Locked until the folder is removed. `None` if the file system has no locks; the folder is then never
    /// swept.
    lock: Option<Arc<File>>,
    /// Process id of the creator. A forked child has a copy of the value, but must not remove the folder.
    owner: u32,
}

impl PrivateFolder {
    /// Creates an empty folder. The first call in a process removes folders that killed processes have left
    /// behind.
    pub(crate) fn create() -> Result<Self> {
        static SWEPT: Once = Once::new();
        let base = platform::unpack_base();
        SWEPT.call_once(|| sweep(&base));
        PrivateFolder::create_in(&base)
    }

    fn create_in(base: &Path) -> Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix(PREFIX)
            .tempdir_in(base)
            .map_err(FmiError::io("create a folder in", base))?;
        let lock = take_lock(&folder.path().join(LOCK));
        let inside = folder.path().join(INSIDE);
        fs::create_dir(&inside).map_err(FmiError::io("create", &inside))?;
        Ok(PrivateFolder { folder: Some(folder), inside, lock, owner: std::process::id() })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.inside
    }

    /// Recreates the folder at its path if it, or parts of it, have been removed.
    pub(crate) fn restore(&mut self) -> Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        let outer = folder.path();
        // In a folder open to all users, another folder may have been created with this name. It is rejected.
        platform::create_private_folder(outer).map_err(FmiError::io("create", outer))?;
        if !self.inside.is_dir() {
            fs::create_dir(&self.inside).map_err(FmiError::io("create", &self.inside))?;
            // The process that recreates the folder also removes it.
            self.owner = std::process::id();
        }
        let lock = outer.join(LOCK);
        if !lock.exists() {
            self.lock = take_lock(&lock);
        }
        Ok(())
    }
}

impl Drop for PrivateFolder {
    fn drop(&mut self) {
        let folder = self.folder.take();
        if let (Some(folder), Some(lock)) = (&folder, self.lock.take()) {
            // Closed before the folder is removed, because some systems do not remove open files.
            locks().retain(|(_, path, _)| path.parent() != Some(folder.path()));
            drop(lock);
        }
        if self.owner != std::process::id() {
            let _ = folder.map(TempDir::keep);
        }
    }
}

/// Locks in use, with the process that created them and one of their paths. If the file system has hard
/// links, all locks of a process are a single file with many names. The folders of the process then require
/// only one file handle.
static LOCKS: Mutex<Vec<(u32, PathBuf, Arc<File>)>> = Mutex::new(Vec::new());

fn locks() -> MutexGuard<'static, Vec<(u32, PathBuf, Arc<File>)>> {
    LOCKS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Creates a hard link to a locked file at this path, or a new file. A new file is locked before it has this
/// name. No file remains if it cannot be locked.
fn take_lock(path: &Path) -> Option<Arc<File>> {
    let mut locks = locks();
    let process = std::process::id();
    let of_process = locks.iter().rev().find(|(owner, ..)| *owner == process);
    let named = of_process.filter(|(_, name, _)| cfg!(unix) && fs::hard_link(name, path).is_ok());
    let lock = match named {
        Some((.., lock)) => Arc::clone(lock),
        None => Arc::new(new_lock(path)?),
    };
    locks.push((process, path.to_owned(), Arc::clone(&lock)));
    Some(lock)
}

/// Age after which a folder without a lock counts as left behind by a process killed while creating it.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);

/// Removes the folders in `base` with one of our lock files that is not locked, because their processes have
/// ended. Folders of other users, recent folders that do not have a lock file yet, and folders with another
/// layout are not changed.
fn sweep(base: &Path) {
    let Ok(user_file) = platform::file_of_user() else { return };
    for entry in fs::read_dir(base).into_iter().flatten().flatten() {
        let folder = entry.path();
        let is_named = entry.file_name().to_string_lossy().starts_with(PREFIX);
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if !(is_named && is_folder && platform::keep_others_out(&folder, &user_file).is_ok()) {
            continue;
        }
        remove_unlocked(&folder);
        if is_old(&folder) {
            remove_begun(&folder);
        }
    }
}

/// Removes a folder with our layout whose lock file is not locked.
fn remove_unlocked(folder: &Path) {
    if !(is_left_behind(&folder.join(LOCK)) && has_our_layout(folder)) {
        return;
    }
    if let Err(error) = fs::remove_dir_all(folder) {
        log::debug!("{} was not deleted: {error}", folder.display());
    }
}

/// True if a folder contains only the lock file and the unpacked FMU.
fn has_our_layout(folder: &Path) -> bool {
    let is_ours = |entry: io::Result<fs::DirEntry>| {
        entry.is_ok_and(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => entry.file_name() == INSIDE,
            Ok(kind) => kind.is_file() && entry.file_name() == LOCK,
            Err(_) => false,
        })
    };
    fs::read_dir(folder).is_ok_and(|mut entries| entries.all(is_ours))
}

/// Removes the remains of a process killed while creating a folder: empty folders, and a lock file
/// with its temporary name. On a file system without locks, a folder in use is not empty.
fn remove_begun(folder: &Path) {
    let unnamed = folder.join(NEW_LOCK);
    let length =
        |path: &Path| fs::symlink_metadata(path).ok().filter(fs::Metadata::is_file).map(|found| found.len());
    if length(&unnamed).is_some_and(|length| length <= MARK.len() as u64) {
        let begun = base::files::read_regular(&unnamed);
        if begun.is_ok_and(|content| MARK.starts_with(&content)) {
            let _ = fs::remove_file(&unnamed);
        }
    }
    // The system does not remove folders that are not empty.
    let _ = fs::remove_dir(folder.join(INSIDE));
    let _ = fs::remove_dir(folder);
}

/// True if a folder was last modified a long time ago.
fn is_old(folder: &Path) -> bool {
    let modified = folder.symlink_metadata().and_then(|found| found.modified());
    modified.ok().and_then(|time| time.elapsed().ok()).is_some_and(|age| age > ABANDONED)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn private_folder_is_removed_with_its_value() {
        let base = tempfile::tempdir().unwrap();
        let folder = PrivateFolder::create_in(base.path()).unwrap();
        assert!(folder.path().is_dir() && folder.lock.is_some());
        drop(folder);
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 0);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn private_folders_share_one_file_handle() {
        let base = tempfile::tempdir().unwrap();
        let of_base = || {
            let handles = fs::read_dir("/proc/self/fd").unwrap().flatten();
            handles.filter(|fd| fs::read_link(fd.path()).is_ok_and(|to| to.starts_with(base.path()))).count()
        };
        let mut folders: Vec<_> = (0..20).map(|_| PrivateFolder::create_in(base.path()).unwrap()).collect();
        assert!(of_base() <= 1, "{}", of_base());
        // The other folders remain locked, also for other processes, after the first has been removed.
        folders.remove(0);
        for folder in &folders {
            let lock = folder.path().parent().unwrap().join(LOCK);
            assert!(File::options().write(true).open(lock).unwrap().try_lock().is_err());
        }
        drop(folders);
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 0);
    }

    #[test]
    fn private_folder_survives_drop_in_forked_child() {
        let base = tempfile::tempdir().unwrap();
        let mut folder = PrivateFolder::create_in(base.path()).unwrap();
        folder.owner ^= 1;
        let path = folder.path().to_owned();
        drop(folder);
        assert!(path.is_dir());
    }

    #[test]
    fn sweep_removes_only_abandoned_folders() {
        let base = tempfile::tempdir().unwrap();
        let live = PrivateFolder::create_in(base.path()).unwrap();
        let mut dead = PrivateFolder::create_in(base.path()).unwrap();
        dead.owner ^= 1; // dropped without being removed, as if the process had been killed
        let dead_path = dead.path().to_owned();
        let lock = dead_path.parent().unwrap().join(LOCK);
        drop(dead);
        // The process has released the lock.
        fs::remove_file(&lock).unwrap();
        fs::write(&lock, MARK).unwrap();
        let (unlocked, foreign) = (named(&base, "new"), base.path().join("other"));
        fs::create_dir(&unlocked).unwrap();
        fs::create_dir(&foreign).unwrap();
        fs::write(foreign.join(LOCK), MARK).unwrap();
        let old = named(&base, "old");
        fs::create_dir(&old).unwrap();
        fs::write(old.join(NEW_LOCK), "").unwrap();
        make_old(&old);
        sweep(base.path());
        assert!(!dead_path.exists() && !old.exists());
        assert!(live.path().exists() && unlocked.exists() && foreign.exists());
    }

    fn named(base: &TempDir, end: &str) -> PathBuf {
        base.path().join(format!("{PREFIX}{end}"))
    }

    fn make_old(folder: &Path) {
        let long_ago = std::time::SystemTime::now() - 2 * ABANDONED;
        #[cfg(unix)]
        File::open(folder).unwrap().set_modified(long_ago).unwrap();
        #[cfg(windows)]
        {
            // FILE_WRITE_ATTRIBUTES and FILE_FLAG_BACKUP_SEMANTICS, which a folder needs.
            use std::os::windows::fs::OpenOptionsExt;
            let mut options = File::options();
            let folder = options.access_mode(0x100).custom_flags(0x0200_0000).open(folder).unwrap();
            folder.set_modified(long_ago).unwrap();
        }
    }

    /// Old folders with such a name that belong to the user. Each differs from our layout in one detail.
    #[test]
    fn sweep_keeps_folders_of_user() {
        type Fill = fn(&Path) -> io::Result<()>;
        let others: [(&str, Fill); 7] = [
            ("results", |f| fs::write(f.join("results.csv"), "1")),
            ("lock", |f| fs::write(f.join(LOCK), "")),
            ("lock and results", |f| {
                fs::write(f.join(LOCK), MARK)?;
                fs::write(f.join("results.csv"), "1")
            }),
            ("nested", |f| fs::create_dir_all(f.join(INSIDE).join("mine"))),
            ("new lock", |f| fs::write(f.join(NEW_LOCK), "mine")),
            ("folder as lock", |f| fs::create_dir_all(f.join(LOCK).join("mine"))),
            ("other folder", |f| {
                fs::write(f.join(LOCK), MARK)?;
                fs::create_dir_all(f.join("runs"))
            }),
        ];
        for (what, fill) in others {
            for name in [format!("{PREFIX}x"), "fmufit-x".to_owned(), "fmufit-cache".to_owned()] {
                let base = tempfile::tempdir().unwrap();
                let folder = base.path().join(name);
                fs::create_dir(&folder).unwrap();
                fill(&folder).unwrap();
                make_old(&folder);
                let count = |path: &Path| fs::read_dir(path).unwrap().count();
                let before = count(&folder);
                sweep(base.path());
                assert_eq!(count(&folder), before, "{what}");
            }
        }
    }

    #[cfg(unix)]
    #[test]
    fn sweep_does_not_block_on_pipe_as_lock() {
        let base = tempfile::tempdir().unwrap();
        let folder = named(&base, "x");
        fs::create_dir(&folder).unwrap();
        let made = std::process::Command::new("mkfifo").arg(folder.join(LOCK)).status().unwrap();
        assert!(made.success());
        make_old(&folder);
        sweep(base.path());
        assert!(folder.join(LOCK).exists());
    }
}
