//! What lies in a folder at a time, to find out whether somebody wrote into it.

use super::files_below;
use crate::platform::{FileIdentity, file_identity};
use std::path::{Path, PathBuf};

/// Files looked at.
const MAX_FILES: u64 = 10_000;

/// The files below a folder, with what changes when they are written.
#[derive(Debug)]
pub(crate) struct Snapshot {
    folder: PathBuf,
    files: Vec<(String, FileIdentity)>,
}

impl Snapshot {
    /// A folder that is not there, or holds too many files to be looked at, is as good as empty.
    pub(crate) fn of(folder: &Path) -> Self {
        let files = files_below(folder, MAX_FILES).unwrap_or_default();
        let look = |(name, path): (String, PathBuf)| Some((name, file_identity(&path.metadata().ok()?)));
        Self { folder: folder.to_owned(), files: files.into_iter().filter_map(look).collect() }
    }

    /// The first file that was made, written or removed since.
    pub(crate) fn first_change(&self) -> Option<PathBuf> {
        let now = Self::of(&self.folder);
        let is_new = |(name, file): &&(String, FileIdentity)| {
            let before = self.files.binary_search_by(|(known, _)| known.cmp(name));
            before.is_err() || before.is_ok_and(|place| self.files[place].1 != *file)
        };
        let is_gone = |(name, _): &&(String, FileIdentity)| {
            now.files.binary_search_by(|(known, _)| known.cmp(name)).is_err()
        };
        let changed = now.files.iter().find(is_new).or_else(|| self.files.iter().find(is_gone));
        changed.map(|(name, _)| self.folder.join(name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn new_changed_and_removed_files_are_seen() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("tables")).unwrap();
        fs::write(path("tables/a.txt"), "1").unwrap();
        fs::write(path("b.txt"), "2").unwrap();
        let before = Snapshot::of(folder.path());
        assert_eq!(before.first_change(), None);
        fs::write(path("c.txt"), "").unwrap();
        assert_eq!(before.first_change(), Some(path("c.txt")));
        fs::remove_file(path("c.txt")).unwrap();
        assert_eq!(before.first_change(), None);
        fs::write(path("tables/a.txt"), "10").unwrap();
        assert_eq!(before.first_change(), Some(path("tables/a.txt")));
        let before = Snapshot::of(folder.path());
        fs::remove_file(path("b.txt")).unwrap();
        assert_eq!(before.first_change(), Some(path("b.txt")));
        assert_eq!(Snapshot::of(&path("none")).first_change(), None);
    }
}
