//! Private folders for unpacked archives: gone when the value goes, swept up later if the process was killed.
//!
//! Layout: `fmufit-XXXXXX/fmu/` is what is handed out, `fmufit-XXXXXX/lock` is locked by the process that owns it.

use crate::error::FmiError;
use crate::platform;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, Once, PoisonError};
use std::time::Duration;
use tempfile::TempDir;

const PREFIX: &str = platform::PRIVATE_PREFIX;
const INSIDE: &str = "fmu";
const LOCK: &str = "lock";

/// A folder of this process.
#[derive(Debug)]
pub(crate) struct PrivateFolder {
    folder: Option<TempDir>,
    inside: PathBuf,
    /// Held until the folder goes; absent where the file system has no locks, then nobody sweeps.
    lock: Option<Arc<File>>,
    /// The process that made it. A forked child has the value too, but not the right to remove the folder.
    owner: u32,
}

impl PrivateFolder {
    /// Makes an empty folder. The first call in a process removes what killed processes left behind.
    pub(crate) fn create() -> Result<Self, FmiError> {
        static SWEPT: Once = Once::new();
        let base = platform::unpack_base();
        SWEPT.call_once(|| sweep(&base));
        PrivateFolder::create_in(&base)
    }

    /// Makes the folder again whose [`path`](Self::path) was this one, which nothing may have taken since.
    pub(crate) fn create_again(path: &Path) -> Result<Self, FmiError> {
        let (base, name) = match path.parent().and_then(|outer| Some((outer.parent()?, outer.file_name()?))) {
            Some((base, name)) if path.ends_with(INSIDE) => (base, name),
            _ => return Err(FmiError::io("create", path)(std::io::ErrorKind::InvalidInput.into())),
        };
        Self::create_with(tempfile::Builder::new().prefix(name).rand_bytes(0), base)
    }

    fn create_in(base: &Path) -> Result<Self, FmiError> {
        Self::create_with(tempfile::Builder::new().prefix(PREFIX), base)
    }

    fn create_with(builder: &mut tempfile::Builder<'_, '_>, base: &Path) -> Result<Self, FmiError> {
        let folder = builder.tempdir_in(base).map_err(FmiError::io("create a folder in", base))?;
        let lock = take_lock(&folder.path().join(LOCK));
        let inside = folder.path().join(INSIDE);
        fs::create_dir(&inside).map_err(FmiError::io("create", &inside))?;
        Ok(PrivateFolder { folder: Some(folder), inside, lock, owner: std::process::id() })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.inside
    }

    /// Makes the folder again at the same place where somebody has removed it, or parts of it.
    pub(crate) fn restore(&mut self) -> Result<(), FmiError> {
        let Some(folder) = &self.folder else { return Ok(()) };
        let outer = folder.path();
        // In a place that is open to everybody, another folder may have taken the name: that is refused.
        platform::create_private_folder(outer).map_err(FmiError::io("create", outer))?;
        if !self.inside.is_dir() {
            fs::create_dir(&self.inside).map_err(FmiError::io("create", &self.inside))?;
            // Whoever makes it anew removes it.
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
            // Closed before the folder goes, if it is the last: some systems do not remove open files.
            locks().retain(|(_, path, _)| path.parent() != Some(folder.path()));
            drop(lock);
        }
        if self.owner != std::process::id() {
            let _ = folder.map(TempDir::keep);
        }
    }
}

/// Locks that are held, with the process that made them and one of their names. Those of a process are one file with many
/// names where the file system has such: its folders take one file handle, however many there are.
static LOCKS: Mutex<Vec<(u32, PathBuf, Arc<File>)>> = Mutex::new(Vec::new());

fn locks() -> MutexGuard<'static, Vec<(u32, PathBuf, Arc<File>)>> {
    LOCKS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Gives a locked file this name, or creates one that is locked from the moment it has its name; nothing stays if it cannot
/// be locked.
fn take_lock(path: &Path) -> Option<Arc<File>> {
    let mut locks = locks();
    let process = std::process::id();
    let known = locks.iter().rev().find(|(owner, ..)| *owner == process);
    let named = known.filter(|(_, name, _)| cfg!(unix) && fs::hard_link(name, path).is_ok());
    let lock = match named {
        Some((.., lock)) => Arc::clone(lock),
        None => Arc::new(new_lock(path)?),
    };
    locks.push((process, path.to_owned(), Arc::clone(&lock)));
    Some(lock)
}

fn new_lock(path: &Path) -> Option<File> {
    let unnamed = path.with_extension("new");
    let file = File::create_new(&unnamed).ok()?;
    if file.try_lock().is_ok() && fs::rename(&unnamed, path).is_ok() {
        return Some(file);
    }
    drop(file);
    let _ = fs::remove_file(&unnamed);
    None
}

/// Age at which a folder without a lock was left behind by a process that was killed while making it.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);

/// Removes the folders in `base` that have a lock which nobody holds: their processes are gone. Folders of other
/// users, and those in the making, which have no lock yet and are young, are left alone.
fn sweep(base: &Path) {
    for entry in fs::read_dir(base).into_iter().flatten().flatten() {
        if !entry.file_name().to_string_lossy().starts_with(PREFIX) {
            continue;
        }
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && is_abandoned(&entry.path()) {
            // Others' folders stay: the system refuses.
            let _ = fs::remove_dir_all(entry.path());
            continue;
        }
        let lock = File::options().write(true).open(entry.path().join(LOCK));
        if let (true, Ok(lock)) = (is_folder, lock)
            && lock.try_lock().is_ok()
        {
            drop(lock);
            if let Err(error) = fs::remove_dir_all(entry.path()) {
                log::debug!("{} stays: {error}", entry.path().display());
            }
        }
    }
}

/// Whether a folder has never got a lock, and nothing was done in it for a long time.
fn is_abandoned(folder: &Path) -> bool {
    let age = |path: &Path| path.symlink_metadata().and_then(|found| found.modified()).ok()?.elapsed().ok();
    let is_old = |path: PathBuf| age(&path).is_none_or(|age| age > ABANDONED);
    let inside = folder.join(INSIDE);
    // With anything in it, it is in use on a file system without locks, or not ours.
    let is_empty = fs::read_dir(&inside).map_or(true, |mut entries| entries.next().is_none());
    fs::symlink_metadata(folder.join(LOCK)).is_err() && is_empty && is_old(folder.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_goes_with_its_value() {
        let base = tempfile::tempdir().unwrap();
        let folder = PrivateFolder::create_in(base.path()).unwrap();
        assert!(folder.path().is_dir() && folder.lock.is_some());
        drop(folder);
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 0);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn many_folders_take_one_file_handle() {
        let base = tempfile::tempdir().unwrap();
        let of_base = || {
            let handles = fs::read_dir("/proc/self/fd").unwrap().flatten();
            handles.filter(|fd| fs::read_link(fd.path()).is_ok_and(|to| to.starts_with(base.path()))).count()
        };
        let mut folders: Vec<_> = (0..20).map(|_| PrivateFolder::create_in(base.path()).unwrap()).collect();
        assert!(of_base() <= 1, "{}", of_base());
        // The others are locked when the first has gone, for others as well.
        folders.remove(0);
        for folder in &folders {
            let lock = folder.path().parent().unwrap().join(LOCK);
            assert!(File::options().write(true).open(lock).unwrap().try_lock().is_err());
        }
        drop(folders);
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_is_made_again_unless_something_has_its_place() {
        let base = tempfile::tempdir().unwrap();
        let folder = PrivateFolder::create_in(base.path()).unwrap();
        let path = folder.path().to_owned();
        assert!(PrivateFolder::create_again(&path).is_err());
        drop(folder);
        let again = PrivateFolder::create_again(&path).unwrap();
        assert_eq!(again.path(), path);
        assert!(PrivateFolder::create_again(base.path()).is_err());
    }

    #[test]
    fn a_value_inherited_from_another_process_leaves_the_folder() {
        let base = tempfile::tempdir().unwrap();
        let mut folder = PrivateFolder::create_in(base.path()).unwrap();
        folder.owner ^= 1;
        let path = folder.path().to_owned();
        drop(folder);
        assert!(path.is_dir());
    }

    #[test]
    fn only_what_was_left_behind_is_swept() {
        let base = tempfile::tempdir().unwrap();
        let live = PrivateFolder::create_in(base.path()).unwrap();
        let mut dead = PrivateFolder::create_in(base.path()).unwrap();
        dead.owner ^= 1; // dropped without being removed, as if the process had been killed
        let dead_path = dead.path().to_owned();
        let lock = dead_path.parent().unwrap().join(LOCK);
        drop(dead);
        // Its process has let go of the lock.
        fs::remove_file(&lock).unwrap();
        fs::write(&lock, "").unwrap();
        let (unlocked, foreign) = (base.path().join("fmufit-new"), base.path().join("other"));
        fs::create_dir(&unlocked).unwrap();
        fs::create_dir(&foreign).unwrap();
        fs::write(foreign.join(LOCK), "").unwrap();
        let old = base.path().join("fmufit-old");
        fs::create_dir(&old).unwrap();
        fs::write(old.join("lock.new"), "").unwrap();
        let long_ago = std::time::SystemTime::now() - 2 * ABANDONED;
        File::open(&old).unwrap().set_modified(long_ago).unwrap();
        sweep(base.path());
        assert!(!dead_path.exists() && !old.exists());
        assert!(live.path().exists() && unlocked.exists() && foreign.exists());
    }
}
