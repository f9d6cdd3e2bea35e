//! Searches the binaries of an FMU for the library of a model.

use super::binary::{self, BinaryFormat, BinaryHeader, Machine};
use super::binary_folders::{FolderNames, LIBRARY_EXTENSION, binary_folders};
use crate::error::{FmiError, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// A library found in `binaries/`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoundBinary {
    /// Path of the library.
    pub path: PathBuf,
    /// Irregularity, if any: the name differs from the model identifier.
    pub note: Option<String>,
}

/// Finds the library of a model for this platform.
///
/// A library with another name is used (with a note) if it is the only one in its folder. Returns
/// [`FmiError::NoBinary`] with the existing libraries and their machine types if there is none.
pub fn find_binary(root: &Path, model_identifier: &str, names: FolderNames) -> Result<FoundBinary> {
    let folders = binary_folders(names);
    for folder in &folders {
        let folder = root.join("binaries").join(folder);
        let exact = folder.join(format!("{model_identifier}.{LIBRARY_EXTENSION}"));
        if runs_here(&exact) {
            return Ok(FoundBinary { path: exact, note: None });
        }
        if exact.exists() {
            continue;
        }
        if let [only] = &libraries_in(&folder)[..]
            && runs_here(only)
        {
            let note = format!(
                "{} is used for the model identifier \"{model_identifier}\", because it is the only library \
                 in its folder",
                only.strip_prefix(root).unwrap_or(only).display()
            );
            return Ok(FoundBinary { path: only.clone(), note: Some(note) });
        }
    }
    Err(FmiError::NoBinary {
        path: root.to_owned(),
        wanted: format!("{} with {} {}", folders.join(" or "), BinaryFormat::host(), Machine::host()),
        present: present_binaries(root),
    })
}

/// Returns the library of a model for this platform if it exists but cannot run here.
pub(crate) fn unusable_binary(root: &Path, model_identifier: &str, names: FolderNames) -> Option<PathBuf> {
    let file = format!("{model_identifier}.{LIBRARY_EXTENSION}");
    let places =
        binary_folders(names).into_iter().map(|folder| root.join("binaries").join(folder).join(&file));
    places.into_iter().find(|place| place.is_file() && !runs_here(place))
}

fn runs_here(path: &Path) -> bool {
    matches!(BinaryHeader::read(path), Ok(Some(header)) if header.runs_here())
}

/// Returns the files with the library extension of this platform, sorted; empty if there is no such folder.
fn libraries_in(folder: &Path) -> Vec<PathBuf> {
    sorted_entries(folder)
        .into_iter()
        .filter(|path| {
            path.extension().is_some_and(|extension| extension == LIBRARY_EXTENSION) && path.is_file()
        })
        .collect()
}

fn sorted_entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

/// Describes the folders of `binaries/` and their contents, for a message.
fn present_binaries(root: &Path) -> String {
    let folders = sorted_entries(&root.join("binaries"));
    let described: Vec<String> =
        folders.iter().filter(|path| path.is_dir()).take(20).map(|folder| describe_folder(folder)).collect();
    if described.is_empty() { "no binaries".to_owned() } else { described.join(", ") }
}

fn describe_folder(folder: &Path) -> String {
    let files: Vec<String> = sorted_entries(folder)
        .iter()
        .filter(|path| path.is_file())
        .take(5)
        .map(|path| format!("{}: {}", file_name(path), binary::describe(path)))
        .collect();
    let inside = if files.is_empty() { "empty".to_owned() } else { files.join(", ") };
    format!("{} ({inside})", file_name(folder))
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::env;

    /// The header of an ELF library for 64-bit PowerPC, whose machine number is 21.
    fn foreign_library() -> Vec<u8> {
        let mut bytes = b"\x7fELF\x02\x01\x01".to_vec();
        bytes.resize(18, 0);
        bytes.extend([21, 0]);
        bytes
    }

    #[test]
    fn find_binary_lists_library_of_other_machine() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("binaries").join(&binary_folders(FolderNames::SystemAndBits)[0]);
        let other = root.path().join("binaries/plan9");
        fs::create_dir_all(&folder).unwrap();
        fs::create_dir_all(&other).unwrap();
        fs::write(folder.join(format!("m.{LIBRARY_EXTENSION}")), foreign_library()).unwrap();
        let message = find_binary(root.path(), "m", FolderNames::SystemAndBits).unwrap_err().to_string();
        assert!(message.contains("ELF machine 21") && message.contains("plan9 (empty)"), "{message}");
        assert!(message.contains(&binary_folders(FolderNames::SystemAndBits)[0]), "{message}");
    }

    #[test]
    fn find_binary_accepts_single_library_with_other_name() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("binaries").join(&binary_folders(FolderNames::SystemAndBits)[0]);
        fs::create_dir_all(&folder).unwrap();
        let program = env::current_exe().unwrap();
        let library = folder.join(format!("other.{LIBRARY_EXTENSION}"));
        fs::copy(&program, &library).unwrap();
        let found = find_binary(root.path(), "m", FolderNames::SystemAndBits).unwrap();
        assert_eq!(found.path, library);
        assert!(found.note.unwrap().contains("\"m\""));
        fs::copy(&program, folder.join(format!("third.{LIBRARY_EXTENSION}"))).unwrap();
        assert!(matches!(
            find_binary(root.path(), "m", FolderNames::SystemAndBits),
            Err(FmiError::NoBinary { .. })
        ));
        let exact = folder.join(format!("m.{LIBRARY_EXTENSION}"));
        fs::copy(&program, &exact).unwrap();
        assert_eq!(
            find_binary(root.path(), "m", FolderNames::SystemAndBits).unwrap(),
            FoundBinary { path: exact, note: None }
        );
    }

    #[test]
    fn find_binary_reports_missing_binaries() {
        let root = tempfile::tempdir().unwrap();
        let message = find_binary(root.path(), "m", FolderNames::SystemAndBits).unwrap_err().to_string();
        assert!(message.contains("no binaries"), "{message}");
    }
}
