//! The identity of a file, which distinguishes it from other files and from its earlier versions. Also
//! system-dependent names, permissions and reading of files.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// True if a component of a path in an archive can be a file name on this system.
pub(crate) fn is_file_name(component: &str) -> bool {
    if !cfg!(windows) {
        return true;
    }
    let stem = component.split('.').next().unwrap_or_default().trim_end().to_ascii_uppercase();
    let numbered = |prefix: &str| {
        stem.strip_prefix(prefix).is_some_and(|rest| rest.len() == 1 && rest.as_bytes()[0].is_ascii_digit())
    };
    let device = matches!(stem.as_str(), "CON" | "PRN" | "AUX" | "NUL") || numbered("COM") || numbered("LPT");
    !device && !component.ends_with(['.', ' ']) && !component.contains(['<', '>', ':', '"', '|', '?', '*'])
}

/// True if the owner may execute the file.
pub(crate) fn is_executable(metadata: &fs::Metadata) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        metadata.permissions().mode() & 0o100 != 0
    }
    #[cfg(not(unix))]
    {
        let _ = metadata;
        false
    }
}

/// Makes a file executable for all users who can read it, on systems with such permissions.
pub(crate) fn make_executable(file: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.set_permissions(fs::Permissions::from_mode(0o755))?;
    }
    #[cfg(not(unix))]
    let _ = file;
    Ok(())
}

/// Creates a link to a folder, on systems that support it without special permission.
pub(crate) fn link_folder(folder: &Path, link: &Path) -> io::Result<()> {
    #[cfg(unix)]
    std::os::unix::fs::symlink(folder, link)?;
    #[cfg(not(unix))]
    let _ = (folder, link);
    Ok(())
}

/// Reads at a position in a file. If the system supports it, the position of the file does not change.
pub(crate) fn read_at(file: &File, buffer: &mut [u8], position: u64) -> io::Result<usize> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_at(file, buffer, position);
    #[cfg(not(unix))]
    {
        use std::io::{Read, Seek};
        let mut file = file;
        file.seek(io::SeekFrom::Start(position))?;
        file.read(buffer)
    }
}

/// Data that distinguish a file from other files and from its earlier versions.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct FileIdentity {
    /// Device and inode, if the system has them.
    place: (u64, u64),
    size: u64,
    /// Seconds and nanoseconds of the last modification of the content and, if known, of the status.
    modified: (i64, i64),
    changed: (i64, i64),
}

/// Location of a file: device and inode, or the path on systems without them.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum FilePlace {
    Inode(u64, u64),
    Path(PathBuf),
}

impl FileIdentity {
    /// Returns the location of the file at `path`.
    pub(crate) fn place(&self, path: &Path) -> FilePlace {
        match self.place {
            (0, 0) => FilePlace::Path(path.canonicalize().unwrap_or_else(|_| path.to_owned())),
            (device, inode) => FilePlace::Inode(device, inode),
        }
    }

    /// True if the file has not been modified since.
    pub(crate) fn same_content(&self, other: &Self) -> bool {
        (self.size, self.modified) == (other.size, other.modified)
    }
}

/// Returns the identity of a file from its metadata. The file is not read.
pub(crate) fn file_identity(metadata: &fs::Metadata) -> FileIdentity {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        FileIdentity {
            place: (metadata.dev(), metadata.ino()),
            size: metadata.size(),
            modified: (metadata.mtime(), metadata.mtime_nsec()),
            changed: (metadata.ctime(), metadata.ctime_nsec()),
        }
    }
    #[cfg(not(unix))]
    {
        let since_epoch = metadata.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
        let modified = since_epoch.map_or((0, 0), |d| (d.as_secs() as i64, i64::from(d.subsec_nanos())));
        FileIdentity { place: (0, 0), size: metadata.len(), modified, changed: (0, 0) }
    }
}
