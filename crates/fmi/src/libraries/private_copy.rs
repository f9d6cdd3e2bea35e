//! The files of a private copy of a library: a file of its own, for which the loader makes static variables
//! of its own, and around it what the library may look for from where it lies.

use super::original::OriginalLibrary;
use crate::archive::PrivateFolder;
use crate::error::FmiError;
use crate::platform::{self, BinaryHeader, check_length};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Copies the library into a folder of its own; its path there, and the folder. Blocks are shared where the
/// file system can.
///
/// # Errors
/// The system refuses; the library was written over since it was loaded first.
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

/// Places what lies beside the library beside its copy: libraries as copies, which the loader takes for
/// others when they are opened by their paths; the rest as links, or copies where links cannot be made.
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

/// Copies a file with the right to execute it. [`fs::copy`] changes the mode of the copy afterwards, which a
/// sandbox refuses.
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
