//! A `.fmu` file. It is listed and checked when it is opened. Each part is unpacked into a private folder on
//! demand, and again if it has been removed.

use super::entries::{self, Record, refused};
use super::hash::{self, Hashing};
use super::limits::ArchiveLimits;
use super::positioned::Positioned;
use super::private::PrivateFolder;
use super::unpack::Source;
use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use crate::platform::{self, FileIdentity, FolderNames};
use base::files::open_regular;
use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Folders at the root that are not needed to run an FMU.
const NOT_FOR_RUNNING: &[&str] = &["documentation", "sources", "terminalsAndIcons"];

/// Parts of an archive that are unpacked together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Files that the library may access at run time: all files except documentation, sources and the
    /// binaries of other platforms.
    Running,
    /// `sources/`.
    Sources,
    /// Binaries of all platforms.
    Binaries,
    /// All files.
    All,
}

impl Part {
    fn holds(self, entry: &Record, platform: &[String]) -> bool {
        let (top, below) = entry.name.split_once('/').unwrap_or((&entry.name, ""));
        let second = below.split('/').next().unwrap_or_default();
        match self {
            Part::All => true,
            Part::Sources => top == "sources",
            Part::Binaries => top == "binaries",
            Part::Running if NOT_FOR_RUNNING.contains(&top) => false,
            Part::Running if top != "binaries" || below.is_empty() => true,
            Part::Running => {
                let is_file_of_all = second == below && !entry.is_folder;
                is_file_of_all || platform.iter().any(|folder| folder == second)
            }
        }
    }
}

/// An archive whose entries have been listed.
#[derive(Debug)]
pub(super) struct Packed {
    path: PathBuf,
    /// Kept open, so that another file that is moved to this path does not replace it.
    file: File,
    /// Identity of the file when it was listed.
    identity: FileIdentity,
    entries: Vec<Record>,
    unpacked: Mutex<Unpacked>,
}

/// Unpacked entries.
#[derive(Debug, Default)]
struct Unpacked {
    folder: Option<PrivateFolder>,
    /// True for each unpacked entry.
    done: Vec<bool>,
    /// Created folders, with an identity that changes if a file in the folder is removed.
    folders: HashMap<PathBuf, Option<FileIdentity>>,
}

impl Packed {
    pub(super) fn open(path: &Path, limits: &ArchiveLimits, cancel: &CancelRequest) -> Result<Self> {
        let file = open_regular(path).map_err(FmiError::io("open", path))?;
        let identity = platform::file_identity(&file.metadata().map_err(FmiError::io("open", path))?);
        let entries = entries::list(path, &file, limits, cancel)?;
        let source = Source { path, file: &file, cancel };
        for entry in &entries {
            if let Some(first) = entry.repeats
                && !source.are_same(&entries[first], entry)?
            {
                return Err(refused(path, &entry.name, EntryProblem::Duplicate));
            }
        }
        Ok(Self { path: path.to_owned(), file, identity, entries, unpacked: Mutex::default() })
    }

    /// Returns the names of files that occur more than once.
    pub(super) fn repeated(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().filter(|entry| entry.repeats.is_some()).map(|entry| entry.name.as_str())
    }

    pub(super) fn file_names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().filter(|entry| !entry.is_folder).map(|entry| entry.name.as_str())
    }

    pub(super) fn has_resources(&self) -> bool {
        self.entries.iter().any(|entry| entry.name.starts_with("resources/"))
    }

    /// Returns a hash of the directory.
    pub(super) fn fingerprint(&self) -> String {
        hash::of_texts(self.entries.iter().map(Record::content).map(
            |(name, size, compressed_size, crc32)| format!("{name}\0{size} {compressed_size} {crc32:x}"),
        ))
    }

    pub(super) fn hash(&self) -> Result<String> {
        let mut hashing = Hashing::default();
        let mut file = Positioned::new(&self.file);
        hashing.feed(&mut file).map_err(FmiError::io("read", &self.path))?;
        self.check_unchanged()?;
        Ok(hashing.finish())
    }

    /// Returns the path of the archive.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the bytes of a file if it is not larger than `limit`; `None` if there is no file with this
    /// name.
    pub(super) fn read(&self, name: &str, limit: u64, cancel: &CancelRequest) -> Result<Option<Vec<u8>>> {
        let is_meant = |entry: &&Record| entry.name == name && !entry.is_folder;
        let Some(entry) = self.entries.iter().find(is_meant) else { return Ok(None) };
        let found = entry.entry.size();
        if found > limit {
            let problem = EntryProblem::TooLarge { found, limit };
            return Err(refused(&self.path, name, problem));
        }
        self.source(cancel).read(entry).map(Some)
    }

    /// Returns the folder with the files of `part`. Unpacks the files on the first call.
    pub(super) fn unpack(&self, part: Part, cancel: &CancelRequest) -> Result<PathBuf> {
        let mut unpacked = self.unpacked.lock().unwrap_or_else(PoisonError::into_inner);
        let is_first = unpacked.folder.is_none();
        if is_first {
            self.check_unchanged()?;
        }
        let outcome = self.complete(&mut unpacked, part, cancel);
        if is_first && outcome.is_err() {
            // Nothing is kept from an archive whose contents differ from its directory.
            *unpacked = Unpacked::default();
        }
        outcome
    }

    fn complete(&self, unpacked: &mut Unpacked, part: Part, cancel: &CancelRequest) -> Result<PathBuf> {
        let n_removed = unpacked.look_after(&self.entries)?;
        let folder = match &mut unpacked.folder {
            Some(folder) => folder,
            none => none.insert(PrivateFolder::create()?),
        };
        let root = folder.path().to_owned();
        unpacked.done.resize(self.entries.len(), false);
        let platform = platform::binary_folders(FolderNames::SystemAndBits);
        let is_missing = |&k: &usize| {
            let entry = &self.entries[k];
            !unpacked.done[k] && entry.repeats.is_none() && part.holds(entry, &platform)
        };
        let missing: Vec<usize> = (0..self.entries.len()).filter(is_missing).collect();
        if missing.is_empty() {
            return Ok(root);
        }
        if n_removed > 0 {
            let path = self.path.display();
            log::warn!(
                "{path}: {n_removed} files were removed from {} and are unpacked again",
                root.display()
            );
        }
        let again = |error: FmiError| match n_removed > 0 {
            true => {
                let root = root.display();
                let reason =
                    format!("files were removed from {root}, and unpacking them again failed: {error}");
                FmiError::bad_archive(&self.path, reason)
            }
            false => error,
        };
        self.check_unchanged().map_err(again)?;
        for k in missing {
            cancel.check()?;
            let unpack = self.source(cancel).unpack(&self.entries[k], &root, &mut unpacked.folders);
            unpack.map_err(again)?;
            unpacked.done[k] = true;
        }
        unpacked.note_folders();
        Ok(root)
    }

    fn source<'a>(&'a self, cancel: &'a CancelRequest) -> Source<'a> {
        Source { path: &self.path, file: &self.file, cancel }
    }

    /// Rejects a modified file, because it may now be a different archive.
    fn check_unchanged(&self) -> Result<()> {
        let now = self.file.metadata().map_err(FmiError::io("read", &self.path))?;
        let now = platform::file_identity(&now);
        // Links and modes also change the status, and a writer may restore the modification time.
        if now == self.identity
            || (now.same_content(&self.identity) && entries::are_those_of(&self.entries, &self.file))
        {
            return Ok(());
        }
        Err(FmiError::bad_archive(
            &self.path,
            "the file has been modified since it was opened; open it again",
        ))
    }
}

impl Unpacked {
    /// Detects files removed by others, for example by programs that clean folders for temporary files. Marks
    /// these files as not unpacked, and recreates the private folder if necessary. Returns the number of
    /// missing files.
    fn look_after(&mut self, entries: &[Record]) -> Result<usize> {
        let Some(folder) = &mut self.folder else { return Ok(0) };
        if self.folders.iter().all(|(folder, recorded)| recorded.is_some() && *recorded == identity(folder)) {
            return Ok(0);
        }
        folder.restore()?;
        self.folders.retain(|folder, _| folder.is_dir());
        let mut n_removed = 0;
        for (entry, done) in entries.iter().zip(&mut self.done) {
            if *done && !folder.path().join(&entry.name).exists() {
                *done = false;
                n_removed += 1;
            }
        }
        self.note_folders();
        Ok(n_removed)
    }

    fn note_folders(&mut self) {
        for (folder, recorded) in &mut self.folders {
            *recorded = identity(folder);
        }
    }
}

fn identity(folder: &Path) -> Option<FileIdentity> {
    folder.metadata().ok().map(|found| platform::file_identity(&found))
}
