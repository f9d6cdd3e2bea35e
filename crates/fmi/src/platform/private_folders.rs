//! Folders of this library: caches, and private folders that no other user may write to.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::{env, io};

/// Returns the folder for private unpack folders.
///
/// Some FMUs do not work in a path with spaces, braces or non-ASCII letters. They insert the path into a URI
/// or a format string. Another folder for temporary files is then preferred, if there is one.
pub(crate) fn unpack_base() -> PathBuf {
    let usual = env::temp_dir();
    let others = if cfg!(unix) { &["/tmp", "/var/tmp"][..] } else { &[] };
    if is_plain(&usual) {
        return usual;
    }
    others.iter().map(PathBuf::from).find(|path| path.is_dir()).unwrap_or(usual)
}

fn is_plain(path: &Path) -> bool {
    path.to_str()
        .is_some_and(|text| text.chars().all(|c| c.is_ascii_alphanumeric() || "/\\:._-~+,=@".contains(c)))
}

/// Returns the folder for files that are kept between runs: `FMUFIT_CACHE` if set, otherwise the system's
/// cache folder of the user. Returns `None` if the user is unknown.
pub(crate) fn cache_folder() -> Option<PathBuf> {
    if let Some(folder) = absolute_from("FMUFIT_CACHE") {
        return Some(folder);
    }
    let users = if cfg!(windows) {
        absolute_from("LOCALAPPDATA")
    } else if cfg!(target_vendor = "apple") {
        absolute_from("HOME").map(|home| home.join("Library").join("Caches"))
    } else {
        absolute_from("XDG_CACHE_HOME").or_else(|| absolute_from("HOME").map(|home| home.join(".cache")))
    };
    users.map(|folder| folder.join("fmufit"))
}

/// Returns a folder from an environment variable. Relative paths are ignored, as the XDG specification
/// requires.
fn absolute_from(variable: &str) -> Option<PathBuf> {
    env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}

/// Returns the folder for caches that is used if [`cache_folder`] is unusable.
pub(crate) fn fallback_cache_folder() -> PathBuf {
    unpack_base().join("fmufit-cache")
}

/// Returns a builder of folders that only this user can access, on systems with such permissions.
pub(crate) fn private_folder_builder() -> fs::DirBuilder {
    #[cfg_attr(not(unix), allow(unused_mut))]
    let mut builder = fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder
}

/// Creates a folder that only its owner may write to. Returns an error if an existing folder has other
/// permissions. Libraries are loaded from this folder, and folders for temporary files are open to all users.
pub(crate) fn create_private_folder(path: &Path) -> io::Result<()> {
    match private_folder_builder().create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let found = fs::symlink_metadata(path)?;
        let user = file_of_user()?.metadata()?.uid();
        if !found.is_dir() || found.uid() != user || found.mode() & 0o022 != 0 {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "other users can write to it"));
        }
    }
    Ok(())
}

/// Returns an unnamed file of this user.
pub(crate) fn file_of_user() -> io::Result<File> {
    tempfile::tempfile()
}

/// Removes write permission for the group from a folder. `user_file` is a file of this user. Returns an error
/// if all users may write to the folder, or if its owner is not the owner of `user_file`. Other users may
/// have written files there.
pub(crate) fn keep_others_out(folder: &Path, user_file: &File) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt};
        let found = folder.metadata()?;
        if found.uid() != user_file.metadata()?.uid() || found.mode() & 0o002 != 0 {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "other users can write to it"));
        }
        if found.mode() & 0o020 != 0 {
            fs::set_permissions(folder, fs::Permissions::from_mode(found.mode() & 0o7755))?;
        }
    }
    #[cfg(not(unix))]
    let _ = (folder, user_file);
    Ok(())
}

/// Removes the paths of private folders of this library from a text, because they differ between processes.
/// Paths of files in these folders then begin inside the FMU.
pub fn without_private_folders(text: &str) -> String {
    let base = unpack_base().join(PRIVATE_PREFIX).display().to_string();
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find(&base) {
        let after = &rest[at + base.len()..];
        let name = after.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(after.len());
        let inside = after[name..].strip_prefix(std::path::is_separator);
        let inside = inside.and_then(|inside| inside.strip_prefix(PRIVATE_INSIDE));
        let Some(inside) = inside.and_then(|inside| inside.strip_prefix(std::path::is_separator)) else {
            out.push_str(&rest[..at + base.len()]);
            rest = after;
            continue;
        };
        out.push_str(&rest[..at]);
        rest = inside;
    }
    out + rest
}

/// Prefix of the names of private folders.
pub(crate) const PRIVATE_PREFIX: &str = "fmufit-unpacked-";
/// Folder in a private folder with its contents.
const PRIVATE_INSIDE: &str = "fmu";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn private_folders_are_removed_from_texts() {
        let base = unpack_base();
        let base = base.join("fmufit-").display().to_string();
        let file = unpack_base().join("fmufit-unpacked-Ab12Cd").join("fmu").join("a.txt");
        let rest = format!("or {base}unpacked-9/x, {base}");
        let text = format!("cannot open {} {rest}", file.display());
        let wanted = format!("cannot open a.txt {rest}");
        assert_eq!(without_private_folders(&text), wanted);
    }

    #[test]
    fn paths_that_break_fmus_are_recognised() {
        assert!(is_plain(Path::new("/tmp/a-b_c.d")));
        for bad in ["/tmp/a b", "/tmp/{a}", "/tmp/\u{e4}", "/tmp/a%20b"] {
            assert!(!is_plain(Path::new(bad)), "{bad}");
        }
    }
}
