//! User files: only regular files are read, and files are written completely or not at all.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tempfile::{NamedTempFile, TempPath};

/// Part of the name of a temporary file, between the name of the target file and the process id.
const WRITING: &str = ".writing-";

/// Maximum number of bytes of a file name to repeat in the name of its temporary file. File names have at
/// most 255 bytes.
const LONGEST: usize = 180;

/// Opens a regular file for reading, without blocking. A file that is not regular (a named pipe, a device, a
/// socket) is rejected before anything is read from it.
///
/// # Errors
/// Returns the errors of the system, [`io::ErrorKind::InvalidInput`] if the file is not regular, and
/// [`io::ErrorKind::IsADirectory`] for a folder.
pub fn open_regular(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true);
    require_regular(without_waiting(&mut options, 0).open(path)?)
}

/// Returns the content of a regular file.
///
/// # Errors
/// Returns the errors of [`open_regular`].
pub fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = open_regular(path)?;
    let length = file.metadata()?.len();
    let mut content = Vec::new();
    content
        .try_reserve_exact(usize::try_from(length).unwrap_or(usize::MAX))
        .map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
    file.read_to_end(&mut content)?;
    Ok(content)
}

/// Opens a regular file of this user for reading and writing, in a folder that other users can access. Links
/// are not followed.
///
/// # Errors
/// Returns the errors of [`open_regular`], and [`io::ErrorKind::PermissionDenied`] if another user owns the
/// file.
pub fn open_of_user(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true);
    #[cfg(unix)]
    let file = without_waiting(&mut options, libc::O_NOFOLLOW).open(path)?;
    #[cfg(not(unix))]
    let file = without_waiting(&mut options, 0).open(path)?;
    let file = require_regular(file)?;
    #[cfg(unix)]
    if !belongs_to_folder_owner(path.parent().unwrap_or(Path::new(".")), &file)? {
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, "the file belongs to another user"));
    }
    Ok(file)
}

/// True if the owner of a file owns its folder. The caller must know that this user owns the folder, which
/// only its owner can remove.
#[cfg(unix)]
fn belongs_to_folder_owner(folder: &Path, file: &File) -> io::Result<bool> {
    use std::os::unix::fs::MetadataExt;
    Ok(fs::symlink_metadata(folder)?.uid() == file.metadata()?.uid())
}

#[cfg(unix)]
fn without_waiting(options: &mut OpenOptions, flags: i32) -> &mut OpenOptions {
    use std::os::unix::fs::OpenOptionsExt;
    options.custom_flags(libc::O_NONBLOCK | flags)
}

#[cfg(not(unix))]
fn without_waiting(options: &mut OpenOptions, _: i32) -> &mut OpenOptions {
    options
}

fn require_regular(file: File) -> io::Result<File> {
    let kind = file.metadata()?.file_type();
    match () {
        () if kind.is_file() => Ok(file),
        // Includes the error number of the system, for callers that use it.
        #[cfg(unix)]
        () if kind.is_dir() => Err(io::Error::from_raw_os_error(libc::EISDIR)),
        #[cfg(not(unix))]
        () if kind.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        () => Err(io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file")),
    }
}

/// Resolves links to the file itself, even if the file does not exist.
fn followed(path: &Path) -> PathBuf {
    let mut target = path.to_path_buf();
    // Follows as many links as the system does.
    for _ in 0..40 {
        let Ok(next) = fs::read_link(&target) else { break };
        target = target.parent().unwrap_or(Path::new("")).join(next);
    }
    target
}

/// Returns the folder that contains a file.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// Lock files claimed by this process: path, process id and shared flag. A forked child does not own the
/// claims of its parent. The locks of the system belong to the whole process, so they exclude only other
/// processes.
static CLAIMED: Mutex<Vec<(PathBuf, u32, bool)>> = Mutex::new(Vec::new());

/// Claim on a file that one run at a time writes repeatedly. It is a locked file next to the target, and it
/// is removed with the claim. The lock ends when its process ends for any reason, even if forked children
/// continue.
#[derive(Debug)]
pub struct Claim {
    /// `None` if this process already has a shared claim on the file, or if the target is not a file that is
    /// replaced.
    locked: Option<File>,
    path: PathBuf,
    process: u32,
}

impl Claim {
    /// Claims the file at this path, which need not exist. With `is_shared`, other claims of this process on
    /// the file are accepted at the same time.
    ///
    /// # Errors
    /// Returns [`io::ErrorKind::ResourceBusy`] if the file is already claimed; the message contains the id of
    /// the process, or states that it is this process. Also returns the errors of the system.
    pub fn new(path: &Path, is_shared: bool) -> io::Result<Self> {
        let target = followed(path);
        let process = std::process::id();
        if fs::metadata(&target).is_ok_and(|there| !there.is_file()) {
            return Ok(Self { locked: None, path: target, process });
        }
        let mut name = target.file_name().unwrap_or_default().to_owned();
        name.push(".lock");
        let place = fs::canonicalize(folder_of(&target))?.join(name);
        let mut claimed = CLAIMED.lock().unwrap_or_else(PoisonError::into_inner);
        // Checked before the file is opened, because closing any of its descriptors releases the lock of the
        // process.
        match claimed.iter().find(|(path, owner, _)| *path == place && *owner == process) {
            Some((.., true)) => return Ok(Self { locked: None, path: place, process }),
            Some((.., false)) => {
                let message = "another run in this process is writing to it";
                return Err(io::Error::new(io::ErrorKind::ResourceBusy, message));
            }
            None => {}
        }
        loop {
            let mut options = OpenOptions::new();
            options.read(true).write(true).create(true).truncate(false);
            #[cfg(unix)]
            let file = without_waiting(&mut options, libc::O_NOFOLLOW).open(&place)?;
            #[cfg(not(unix))]
            let file = options.open(&place)?;
            let mut file = require_regular(file)?;
            match try_lock(&file) {
                Ok(()) if !is_at(&file, &place)? => {}
                Ok(()) => {
                    file.set_len(0)?;
                    file.write_all(process.to_string().as_bytes())?;
                    claimed.push((place.clone(), process, is_shared));
                    return Ok(Self { locked: Some(file), path: place, process });
                }
                Err(fs::TryLockError::WouldBlock) => {
                    let mut owner = String::new();
                    let _ = file.read_to_string(&mut owner);
                    let message = format!("process {owner} is writing to it");
                    return Err(io::Error::new(io::ErrorKind::ResourceBusy, message));
                }
                // Some file systems do not support locks.
                Err(fs::TryLockError::Error(_)) => return Ok(Self { locked: None, path: place, process }),
            }
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // A forked child has a copy of the claim but neither the lock nor the file.
        if self.locked.is_some() && self.process == std::process::id() {
            let mut claimed = CLAIMED.lock().unwrap_or_else(PoisonError::into_inner);
            let _ = fs::remove_file(&self.path);
            claimed.retain(|(path, process, _)| *path != self.path || *process != self.process);
        }
    }
}

/// Locks a file for this process. The lock is a record lock (`fcntl`, POSIX.1-2024). Forked children do not
/// inherit it, so they cannot keep it after the process has ended.
#[cfg(unix)]
fn try_lock(file: &File) -> Result<(), fs::TryLockError> {
    use rustix::io::Errno;
    match rustix::fs::fcntl_lock(file, rustix::fs::FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(()),
        Err(Errno::ACCESS | Errno::AGAIN) => Err(fs::TryLockError::WouldBlock),
        Err(error) => Err(fs::TryLockError::Error(error.into())),
    }
}

#[cfg(not(unix))]
fn try_lock(file: &File) -> Result<(), fs::TryLockError> {
    file.try_lock()
}

/// True if an open file is still the file at a path and the path is not a link. Its owner may have removed it
/// in the meantime.
fn is_at(file: &File, place: &Path) -> io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let same =
            |there: fs::Metadata, open: fs::Metadata| (there.dev(), there.ino()) == (open.dev(), open.ino());
        match fs::symlink_metadata(place) {
            Ok(there) => Ok(same(there, file.metadata()?)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        }
    }
    #[cfg(not(unix))]
    Ok(file.metadata().is_ok() && place.exists())
}

/// A file that replaces another file once it is complete. If it is never completed, the other file remains
/// unchanged.
///
/// Links are followed, and the permissions of the existing file are kept. An existing read-only file is an
/// error. A device or a named pipe is not replaced: the complete content is written to it at the end.
#[derive(Debug)]
pub struct AtomicFile {
    file: NamedTempFile,
    target: PathBuf,
    /// Device or pipe at the path.
    stream: Option<File>,
}

impl AtomicFile {
    /// Creates a temporary file for this path.
    ///
    /// # Errors
    /// Returns an error if the folder does not exist or is not writable. Also returns an error if the path is
    /// a folder, a read-only file, or a pipe without a reader.
    pub fn new(path: &Path) -> io::Result<Self> {
        let target = followed(path);
        let old = match fs::metadata(&target) {
            Ok(old) => Some(old),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        if old.as_ref().is_some_and(fs::Metadata::is_dir) {
            return Err(io::ErrorKind::IsADirectory.into());
        }
        if old.as_ref().is_some_and(|old| old.is_file() && old.permissions().readonly()) {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "the existing file is read-only"));
        }
        let is_stream = old.as_ref().is_some_and(|old| !old.is_file());
        let stream = match is_stream {
            true => Some(without_waiting(OpenOptions::new().write(true), 0).open(&target)?),
            false => None,
        };
        let folder = folder_of(&target);
        let name = target.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let prefix = format!("{}{}-", prefix(&name), std::process::id());
        let suffix = target.extension().map(|extension| format!(".{}", extension.to_string_lossy()));
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(suffix.as_deref().unwrap_or_default());
        // The system reduces these permissions according to the user's umask.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let file = if is_stream { builder.tempfile() } else { builder.tempfile_in(folder) };
        // Omits the name of the temporary file, which does not help the user.
        let file = file.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound if !folder.is_dir() => {
                io::Error::new(error.kind(), format!("folder '{}' does not exist", folder.display()))
            }
            kind => io::Error::new(kind, format!("folder '{}': {}", folder.display(), io::Error::from(kind))),
        })?;
        if let Some(old) = old.filter(fs::Metadata::is_file) {
            file.as_file().set_permissions(old.permissions())?;
        }
        Ok(Self { file, target, stream })
    }

    /// Returns the file to write to.
    pub fn file(&self) -> &File {
        self.file.as_file()
    }

    /// Returns the path of the temporary file.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Completes the file: flushes it to the disk and replaces the target.
    ///
    /// # Errors
    /// Returns the errors of the system. The existing file then remains unchanged.
    pub fn finish(self) -> io::Result<()> {
        let Some(mut stream) = self.stream else {
            self.file.as_file().sync_all()?;
            let (file, path) = self.file.keep().map_err(|error| error.error)?;
            drop(file);
            return replace(&path, &self.target).inspect_err(|_| _ = fs::remove_file(&path));
        };
        let (mut file, path): (File, TempPath) = self.file.into_parts();
        file.seek(SeekFrom::Start(0))?;
        let copied = io::copy(&mut file, &mut stream);
        drop((file, path));
        copied.map(drop)
    }
}

/// Replaces a file by another one. Windows refuses this while some program has the file open, for example a
/// virus scanner. Such programs soon close it, so the replacement is tried again for half a second.
fn replace(from: &Path, to: &Path) -> io::Result<()> {
    // ERROR_ACCESS_DENIED and ERROR_SHARING_VIOLATION.
    let is_open =
        |error: &io::Error| cfg!(windows) && matches!(error.raw_os_error(), Some(5 | 32)) && to.is_file();
    for _ in 0..50 {
        match fs::rename(from, to) {
            Err(error) if is_open(&error) => std::thread::sleep(std::time::Duration::from_millis(10)),
            outcome => return outcome,
        }
    }
    fs::rename(from, to)
}

/// Writes a file atomically.
///
/// # Errors
/// Returns the errors of [`AtomicFile::new`] and [`AtomicFile::finish`].
pub fn write_atomically(path: &Path, content: &[u8]) -> io::Result<()> {
    let unfinished = AtomicFile::new(path)?;
    io::Write::write_all(&mut unfinished.file(), content)?;
    unfinished.finish()
}

/// Returns the common prefix of the names of the temporary files for a file.
fn prefix(name: &str) -> String {
    let end = (0..=name.len().min(LONGEST)).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    format!(".{}{WRITING}", &name[..end])
}

/// Removes temporary files of this file that killed processes have left.
pub fn remove_unfinished(path: &Path) {
    let target = followed(path);
    let prefix =
        prefix(&target.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default());
    for entry in fs::read_dir(folder_of(&target)).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let rest = name.to_str().and_then(|name| name.strip_prefix(&prefix));
        let process = rest.and_then(|rest| rest.split_once('-')?.0.parse::<u32>().ok());
        if process.is_some_and(|process| !is_alive(process, &entry)) {
            // Another process may have removed the file already.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// True if a process may still be writing its temporary file. The process must exist. If this cannot be
/// checked, the file must be younger than a day.
fn is_alive(process: u32, file: &fs::DirEntry) -> bool {
    if Path::new("/proc/self").exists() {
        return Path::new("/proc").join(process.to_string()).exists();
    }
    let age = file.metadata().and_then(|m| m.modified()).ok().and_then(|time| time.elapsed().ok());
    age.is_none_or(|age| age < Duration::from_secs(24 * 3600))
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;
    use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
    use std::process::Command;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn file_is_claimed_once_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        let claim = Claim::new(&path, true).unwrap();
        // This process accepts further claims while a shared claim exists.
        drop(Claim::new(&path, false).unwrap());
        assert_eq!(names(folder.path()), ["run.lock"]);
        drop(claim);
        let claim = Claim::new(&path, false).unwrap();
        for is_shared in [false, true] {
            let error = Claim::new(&path, is_shared).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::ResourceBusy);
            assert_eq!(error.to_string(), "another run in this process is writing to it");
        }
        drop(claim);
        assert_eq!(names(folder.path()), Vec::<String>::new());
        // A file left behind by another process is not a claim; a file that it locks is one.
        let lock = folder.path().join("run.lock");
        fs::write(&lock, "4711").unwrap();
        drop(Claim::new(&path, false).unwrap());
        fs::write(&lock, "4711").unwrap();
        let mut owner = Command::new("python3")
            .args(["-c", "import fcntl, sys\nf = open(sys.argv[1], 'r+')\nfcntl.lockf(f, fcntl.LOCK_EX)\nprint('locked', flush=True)\nsys.stdin.read()"])
            .arg(&lock)
            .stdin(std::process::Stdio::piped())
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut reported = [0; 6];
        owner.stdout.as_mut().unwrap().read_exact(&mut reported).unwrap();
        let error = Claim::new(&path, false).unwrap_err();
        assert_eq!((error.kind(), error.to_string().contains("4711")), (io::ErrorKind::ResourceBusy, true));
        owner.kill().unwrap();
        owner.wait().unwrap();
        drop(Claim::new(&path, false).unwrap());
        Claim::new(Path::new("/dev/null"), false).unwrap();
    }

    #[test]
    fn atomic_write_keeps_permissions_and_links() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("a.csv"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
        symlink("a.csv", &link).unwrap();
        write_atomically(&link, b"new").unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        fs::set_permissions(&file, fs::Permissions::from_mode(0o400)).unwrap();
        let error = write_atomically(&file, b"newer").unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.csv", "link"]);
    }

    #[test]
    fn atomic_write_writes_to_devices_and_pipes() {
        write_atomically(Path::new("/dev/null"), b"anything").unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        // The pipe has no reader.
        assert!(write_atomically(&pipe, b"x").is_err());
        let reader = without_waiting(OpenOptions::new().read(true), 0).open(&pipe).unwrap();
        write_atomically(&pipe, b"through").unwrap();
        // Reads only seven bytes, because a process started by another test keeps the write end open until it calls
        // exec.
        let mut content = [0; 7];
        (&reader).read_exact(&mut content).unwrap();
        assert_eq!(&content, b"through");
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
        assert_eq!(names(folder.path()), ["pipe"]);
    }

    #[test]
    fn irregular_files_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for path in [&pipe, Path::new("/dev/zero")] {
            let error = open_regular(path).unwrap_err();
            assert_eq!(
                (error.kind(), error.to_string().as_str()),
                (io::ErrorKind::InvalidInput, "it is not a regular file")
            );
        }
        assert_eq!(open_regular(folder.path()).unwrap_err().kind(), io::ErrorKind::IsADirectory);
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "content").unwrap();
        symlink(&file, &link).unwrap();
        assert_eq!(read_regular(&link).unwrap(), b"content");
        assert!(open_of_user(&file).is_ok() && open_of_user(&link).is_err() && open_of_user(&pipe).is_err());
    }

    #[test]
    fn failed_write_leaves_no_files() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        drop(AtomicFile::new(&file).unwrap());
        assert!(write_atomically(folder.path(), b"x").is_err());
        let message = write_atomically(&folder.path().join("none/a"), b"x").unwrap_err().to_string();
        assert!(message.starts_with("folder '") && message.ends_with("does not exist"), "{message}");
        // The process of this file no longer exists.
        fs::write(folder.path().join(".a.writing-999999999-Xy"), "").unwrap();
        fs::write(folder.path().join(".b.writing-999999999-Xy"), "").unwrap();
        remove_unfinished(&file);
        assert_eq!(names(folder.path()), [".b.writing-999999999-Xy"]);
    }

    #[test]
    fn atomic_write_supports_long_names() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("\u{e4}".repeat(127));
        write_atomically(&file, b"x").unwrap();
        assert_eq!(fs::read(file).unwrap(), b"x");
    }
}
