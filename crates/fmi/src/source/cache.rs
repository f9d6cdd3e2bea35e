//! A cache folder for files kept between runs. Entries are added by renaming, so that processes never find
//! incomplete files. The size is limited, and the folder can be removed.

use crate::error::{FmiError, Result};
use crate::platform;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use std::{fs, io};

/// Folder of built libraries, with one subfolder for each key.
pub(super) const LIBRARIES: &str = "libraries";
/// Folder of packed FMUs, with one subfolder for each key.
pub(super) const PACKED: &str = "packed";
/// Subfolders of the caches. No other subfolder of the cache folder belongs to them.
const SUBFOLDERS: &[&str] = &[LIBRARIES, PACKED];
/// File whose modification time is the time of the last use.
const USED: &str = "used";
/// Prefix of unfinished entries.
const UNFINISHED: &str = ".unfinished-";

/// Maximum number and total size in bytes of the entries.
const MOST_ENTRIES: usize = 256;
const MOST_BYTES: u64 = 512 << 20;
/// Age after which an unfinished entry counts as left behind by a process that died.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);

/// Returns a subfolder of the cache folder, and creates it if necessary. If that fails, a folder among the
/// temporary files is used.
fn folder(name: &str) -> Result<PathBuf> {
    if let Some(usual) = platform::cache_folder().map(|folder| folder.join(name)) {
        let Err(error) = prepare(&usual) else { return Ok(usual) };
        log::warn!("cannot use {} as a cache: {error}", usual.display());
    }
    let fallback = platform::fallback_cache_folder();
    platform::create_private_folder(&fallback).map_err(FmiError::io("create", &fallback))?;
    let inside = fallback.join(name);
    prepare(&inside).map_err(FmiError::io("create", &inside))?;
    Ok(inside)
}

/// Creates a folder and checks that it is writable. Ensures that no other user can write to it, because
/// libraries are loaded from it.
fn prepare(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let user_file = tempfile::Builder::new().prefix(UNFINISHED).tempfile_in(folder)?;
    platform::keep_others_out(folder, user_file.as_file())
}

/// Returns the file `file_name` with this `key` in a subfolder. If it does not exist, `make` creates it at
/// the path that it receives. If two processes create the same file at the same time, both succeed, and one
/// result is kept.
pub(super) fn get_or_make(
    subfolder: &str,
    key: &str,
    file_name: &str,
    make: impl FnOnce(&Path) -> Result<()>,
) -> Result<PathBuf> {
    let folder = folder(subfolder)?;
    let kept = folder.join(key);
    let file = kept.join(file_name);
    if file.is_file() {
        touch(&file);
        return Ok(file);
    }
    let unfinished = tempfile::Builder::new()
        .prefix(UNFINISHED)
        .tempdir_in(&folder)
        .map_err(FmiError::io("create a folder in", &folder))?;
    make(&unfinished.path().join(file_name))?;
    match fs::rename(unfinished.path(), &kept) {
        Ok(()) => {
            let _ = unfinished.keep(); // moved away: nothing to remove
        }
        Err(_) if file.is_file() => {} // another process was faster
        Err(error) => return Err(FmiError::io("create", kept)(error)),
    }
    evict(&folder, &kept, MOST_ENTRIES, MOST_BYTES);
    Ok(file)
}

/// Records a use of a file in a separate file next to it, because a library whose modification time changes
/// would appear modified. An error (for example, in a read-only cache) is harmless.
fn touch(kept: &Path) {
    let mark = kept.with_file_name(USED);
    let file = fs::File::options().create(true).append(true).open(mark);
    let touched = file.and_then(|file| file.set_modified(SystemTime::now()));
    if let Err(error) = touched {
        log::debug!("cannot mark {} as used: {error}", kept.display());
    }
}

struct Kept {
    path: PathBuf,
    used: SystemTime,
    bytes: u64,
}

/// Removes the least recently used entries until the limits are met, except `spared`. Also removes abandoned
/// unfinished entries.
fn evict(libraries: &Path, spared: &Path, most_entries: usize, most_bytes: u64) {
    let mut entries = Vec::new();
    for path in fs::read_dir(libraries).into_iter().flatten().flatten().map(|entry| entry.path()) {
        if is_unfinished(&path) {
            if is_abandoned(&path) {
                remove(&path);
            }
        } else if let Some(kept) = Kept::inspect(&path) {
            entries.push(kept);
        }
    }
    entries.sort_by_key(|kept| (kept.path == spared, kept.used));
    let mut bytes: u64 = entries.iter().map(|kept| kept.bytes).sum();
    let mut left = entries.len();
    for kept in &entries {
        if (left <= most_entries && bytes <= most_bytes) || kept.path == spared {
            return;
        }
        remove(&kept.path);
        left -= 1;
        bytes -= kept.bytes;
    }
}

fn is_unfinished(path: &Path) -> bool {
    path.file_name().unwrap_or_default().to_string_lossy().starts_with(UNFINISHED)
}

fn is_abandoned(path: &Path) -> bool {
    let modified = path.metadata().and_then(|found| found.modified());
    modified.ok().and_then(|time| time.elapsed().ok()).is_some_and(|age| age > ABANDONED)
}

impl Kept {
    fn inspect(path: &Path) -> Option<Kept> {
        let mut kept = Kept { path: path.to_owned(), used: SystemTime::UNIX_EPOCH, bytes: 0 };
        for entry in fs::read_dir(path).ok()?.flatten() {
            let found = entry.metadata().ok()?;
            kept.used = kept.used.max(found.modified().ok()?);
            kept.bytes += found.len();
        }
        Some(kept)
    }
}

/// Removes a folder. Another process may remove it at the same time.
fn remove(path: &Path) {
    if let Err(error) = fs::remove_dir_all(path)
        && error.kind() != io::ErrorKind::NotFound
    {
        log::debug!("{} was not removed from the cache: {error}", path.display());
    }
}

/// Removes all files that this library keeps between runs: built libraries and packed FMUs. Files that
/// another thread or process is currently creating are kept.
///
/// # Errors
/// Returns an error if a file cannot be removed.
pub fn clear_caches() -> Result<()> {
    for folder in platform::cache_folder().into_iter().chain([platform::fallback_cache_folder()]) {
        for name in SUBFOLDERS {
            for entry in fs::read_dir(folder.join(name)).into_iter().flatten().flatten() {
                let path = entry.path();
                if is_unfinished(&path) && !is_abandoned(&path) {
                    continue;
                }
                let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
                let removed = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
                match removed {
                    Err(error) if error.kind() != io::ErrorKind::NotFound => {
                        return Err(FmiError::io("remove", path)(error));
                    }
                    _ => {}
                }
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keep(libraries: &Path, name: &str, bytes: usize, age: u64) -> PathBuf {
        let folder = libraries.join(name);
        fs::create_dir(&folder).unwrap();
        let file = folder.join("m.so");
        fs::write(&file, vec![0; bytes]).unwrap();
        let time = SystemTime::now() - Duration::from_secs(age);
        fs::File::options().append(true).open(&file).unwrap().set_modified(time).unwrap();
        folder
    }

    fn names(libraries: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(libraries)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn cache_evicts_least_recently_used_entries() {
        let root = tempfile::tempdir().unwrap();
        let spared = keep(root.path(), "new", 10, 1000);
        for (name, age) in [("a", 30), ("b", 10), ("c", 20)] {
            keep(root.path(), name, 10, age);
        }
        evict(root.path(), &spared, 3, 1000);
        assert_eq!(names(root.path()), ["b", "c", "new"]);
        evict(root.path(), &spared, 3, 25);
        assert_eq!(names(root.path()), ["b", "new"]);
        evict(root.path(), &spared, 0, 0);
        assert_eq!(names(root.path()), ["new"]);
    }

    #[test]
    fn touch_marks_library_as_recently_used() {
        let root = tempfile::tempdir().unwrap();
        let folder = keep(root.path(), "a", 1, 1000);
        touch(&folder.join("m.so"));
        let kept = Kept::inspect(&folder).unwrap();
        assert!(kept.used.elapsed().unwrap() < Duration::from_secs(100));
    }

    #[test]
    #[cfg(unix)]
    fn cache_rejects_folder_writable_by_others() {
        use std::os::unix::fs::PermissionsExt;
        let root = tempfile::tempdir().unwrap();
        let private = root.path().join("mine");
        platform::create_private_folder(&private).unwrap();
        platform::create_private_folder(&private).unwrap();
        fs::set_permissions(&private, fs::Permissions::from_mode(0o777)).unwrap();
        assert!(platform::create_private_folder(&private).is_err());
        let link = root.path().join("link");
        std::os::unix::fs::symlink(root.path(), &link).unwrap();
        assert!(platform::create_private_folder(&link).is_err());

        let open = root.path().join("open");
        prepare(&open).unwrap();
        fs::set_permissions(&open, fs::Permissions::from_mode(0o775)).unwrap();
        prepare(&open).unwrap();
        assert_eq!(fs::metadata(&open).unwrap().permissions().mode() & 0o777, 0o755);
        fs::set_permissions(&open, fs::Permissions::from_mode(0o777)).unwrap();
        assert!(prepare(&open).is_err());
    }
}
