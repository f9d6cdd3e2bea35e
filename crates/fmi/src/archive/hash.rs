//! Content hashes: SHA-256 of an archive, or of the sorted names and contents of a folder.

use super::limits::ArchiveLimits;
use crate::error::{FmiError, Result};
use base::files::open_regular;
use sha2::{Digest, Sha256};
use std::fs;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

/// A hash that is being computed.
#[derive(Default)]
pub(super) struct Hashing(Sha256);

impl Hashing {
    /// Adds the rest of a stream.
    pub(super) fn feed(&mut self, source: &mut impl Read) -> io::Result<()> {
        io::copy(&mut BufReader::with_capacity(1 << 16, source), self).map(drop)
    }

    /// Adds a string after its length.
    fn text(&mut self, text: &str) {
        self.0.update((text.len() as u64).to_le_bytes());
        self.0.update(text.as_bytes());
    }

    /// Returns the hash in hexadecimal digits.
    pub(super) fn finish(self) -> String {
        self.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl io::Write for Hashing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns the hash of all files below a folder. Files are sorted by path. The path and the content of each
/// file are added, each after its length.
pub(super) fn of_folder(root: &Path, limits: &ArchiveLimits) -> Result<String> {
    let mut hashing = Hashing::default();
    for (name, path) in files_below(root, limits.entries)? {
        let mut file = open_regular(&path).map_err(FmiError::io("open", &path))?;
        let size = file.metadata().map_err(FmiError::io("read", &path))?.len();
        hashing.text(&name);
        hashing.0.update(size.to_le_bytes());
        hashing.feed(&mut file).map_err(FmiError::io("read", &path))?;
    }
    Ok(hashing.finish())
}

/// Returns the hash of several strings, each added after its length.
pub(crate) fn of_texts(texts: impl IntoIterator<Item: AsRef<str>>) -> String {
    let mut hashing = Hashing::default();
    for text in texts {
        hashing.text(text.as_ref());
    }
    hashing.finish()
}

/// Returns the files below a folder as (relative path with slashes, path), sorted by relative path. Links to
/// files count as files. Links to folders are rejected, because their targets may change unnoticed, and links
/// may form a cycle.
pub(crate) fn files_below(root: &Path, limit: u64) -> Result<Vec<(String, PathBuf)>> {
    let mut files = Vec::new();
    let mut folders = vec![(String::new(), root.to_owned())];
    let mut seen = 0;
    while let Some((prefix, folder)) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(FmiError::io("list", &folder))? {
            let entry = entry.map_err(FmiError::io("list", &folder))?;
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            let kind = entry.file_type().map_err(FmiError::io("inspect", entry.path()))?;
            seen += 1;
            if seen > limit {
                return Err(FmiError::ArchiveLimit {
                    path: root.to_owned(),
                    what: "files",
                    found: seen,
                    limit,
                });
            }
            if kind.is_dir() {
                folders.push((name + "/", entry.path()));
            } else if entry.path().is_dir() {
                let reason = format!("\"{name}\" is a link to a folder; replace the link with the folder");
                return Err(FmiError::bad_archive(root, reason));
            } else if kind.is_file() || entry.path().is_file() {
                files.push((name, entry.path()));
            }
        }
    }
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (name, content) in files {
            let path = root.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        root
    }

    fn hash(files: &[(&str, &str)]) -> String {
        of_folder(folder(files).path(), &ArchiveLimits::default()).unwrap()
    }

    #[test]
    fn hash_of_stream_matches_fips_180_4() {
        let mut hashing = Hashing::default();
        hashing.feed(&mut &b"abc"[..]).unwrap();
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"; // FIPS 180-4, "abc"
        assert_eq!(hashing.finish(), expected);
    }

    #[test]
    fn hash_of_folder_depends_only_on_names_and_contents() {
        let one = [("a", "1"), ("b/c", "2")];
        assert_eq!(hash(&one), hash(&[("b/c", "2"), ("a", "1")]));
        for other in [[("a", "2"), ("b/c", "2")], [("a", "1"), ("b/d", "2")], [("a", "12"), ("b/c", "")]] {
            assert_ne!(hash(&one), hash(&other), "{other:?}");
        }
    }

    #[test]
    fn hash_rejects_folder_with_too_many_files() {
        let root = folder(&[("a", ""), ("b", ""), ("c", "")]);
        let limits = ArchiveLimits { entries: 2, ..ArchiveLimits::default() };
        assert!(matches!(
            of_folder(root.path(), &limits),
            Err(FmiError::ArchiveLimit { found: 3, limit: 2, .. })
        ));
    }

    #[test]
    #[cfg(unix)]
    fn files_below_includes_file_links_and_rejects_folder_links() {
        let root = folder(&[("a/b", "1")]);
        std::os::unix::fs::symlink(root.path().join("a/b"), root.path().join("a/c")).unwrap();
        assert_eq!(files_below(root.path(), 100).unwrap().len(), 2);
        std::os::unix::fs::symlink(root.path(), root.path().join("a/up")).unwrap();
        let error = files_below(root.path(), 100).unwrap_err().to_string();
        assert!(error.contains("\"a/up\" is a link to a folder"), "{error}");
    }
}
