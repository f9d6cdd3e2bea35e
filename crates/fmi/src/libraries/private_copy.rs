//! The files of a private copy of a library. The copy is a separate file, so the loader creates separate
//! static variables for it. Files that the library may expect next to it are also provided.

use super::original::OriginalLibrary;
use crate::archive::PrivateFolder;
use crate::error::FmiError;
use crate::platform::{self, BinaryHeader, check_length};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Copies the library into a separate folder. Returns the path of the copy, and the folder. Data blocks are
/// shared if the file system supports that.
///
/// # Errors
/// Returns an error if the operating system reports one, or if the library has been modified since it was
/// first loaded.
pub(super) fn copy(source: &OriginalLibrary) -> Result<(PathBuf, PrivateFolder), FmiError> {
    source.check_unchanged()?;
    let folder = PrivateFolder::create()?;
    let root = folder.path();
    let path = root.join(source.place());
    let target = path.parent().unwrap_or(root);
    fs::create_dir_all(target).map_err(FmiError::io("create", target))?;
    copy_file(&source.library, &path).map_err(FmiError::io("copy to", &path))?;
    if source.is_inside() {
        place_beside(&source.library, target)?;
    }
    let (resources, place) = (source.root.join("resources"), root.join("resources"));
    if source.is_inside() && resources.is_dir() {
        platform::link_folder(&resources, &place).map_err(FmiError::io("link", &place))?;
    }
    Ok((path, folder))
}

/// Provides the files next to the library for its copy. Libraries are copied, so that the loader treats them
/// as different when they are opened by path. Other files become links, or copies if links are not possible.
fn place_beside(library: &Path, target: &Path) -> Result<(), FmiError> {
    let beside = library.parent().unwrap_or(Path::new(""));
    let entries = fs::read_dir(beside).map_err(FmiError::io("list", beside))?;
    for entry in entries {
        let from = entry.map_err(FmiError::io("list", beside))?.path();
        if from == library {
            continue;
        }
        let to = target.join(from.file_name().unwrap_or_default());
        let copied = || copy_file(&from, &to);
        let placed = if from.is_dir() {
            platform::link_folder(&from, &to)
        } else if matches!(BinaryHeader::read(&from), Ok(Some(_))) {
            check_length(&from)?;
            copied()
        } else {
            fs::hard_link(&from, &to).or_else(|_| copied())
        };
        placed.map_err(FmiError::io("link", &to))?;
    }
    Ok(())
}

/// Copies a file with its execute permission. [`fs::copy`] changes the mode of the copy afterwards, which a
/// sandbox denies.
fn copy_file(from: &Path, to: &Path) -> io::Result<()> {
    let mut source = fs::File::open(from)?;
    let mut options = fs::File::options();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
        options.mode(source.metadata()?.mode() & 0o777);
    }
    io::copy(&mut source, &mut options.open(to)?).map(drop)
}
