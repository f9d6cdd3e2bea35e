//! An FMU as a folder: a `.fmu` archive unpacked into a private folder that goes when the value goes,
//! or an unpacked folder as it is. Archives that are not honest are refused before anything is written.

mod directory;
mod entries;
mod hash;
mod names;
mod private;
mod snapshot;
mod unpack;

pub(crate) use hash::{files_below, of_texts as hash_of_texts};
pub(crate) use private::PrivateFolder;
pub(crate) use snapshot::Snapshot;

use crate::error::{EntryProblem, FmiError};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Name of the file every FMU has at its root.
pub(crate) const MODEL_DESCRIPTION: &str = "modelDescription.xml";

/// Whether names could be those of the files of one archive; else the first that could not, and why.
pub(crate) fn check_names<'a>(
    names: impl IntoIterator<Item = &'a str>,
) -> Result<(), (String, EntryProblem)> {
    let mut seen = names::Names::default();
    for name in names {
        names::check(name)
            .and_then(|()| seen.add(name, false))
            .map_err(|problem| (name.to_owned(), problem))?;
    }
    Ok(())
}

/// Whether a relative path with slashes stays inside of the folder it starts in.
pub(crate) fn is_inside(path: &str) -> bool {
    names::check(path).is_ok()
}

/// What an archive may contain. The defaults are far above any real FMU, and stop archives made to fill a disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArchiveLimits {
    /// Files and folders (default 100 000).
    pub entries: u64,
    /// Unpacked bytes of one file (default 2 GiB).
    pub file_bytes: u64,
    /// Unpacked bytes of all files (default 4 GiB).
    pub total_bytes: u64,
    /// Unpacked bytes per packed byte, for one file and for all (default 200). Text tables pack well:
    /// what unpacks to less than [`ratio_free_bytes`](Self::ratio_free_bytes) is not asked.
    pub ratio: u64,
    /// Unpacked bytes up to which the ratio does not matter (default 256 MiB).
    pub ratio_free_bytes: u64,
}

impl Default for ArchiveLimits {
    fn default() -> Self {
        ArchiveLimits {
            entries: 100_000,
            file_bytes: 2 << 30,
            total_bytes: 4 << 30,
            ratio: 200,
            ratio_free_bytes: 256 << 20,
        }
    }
}

/// An opened FMU: a folder with `modelDescription.xml` at its root, and the hash of its content.
#[derive(Debug)]
pub struct Archive {
    root: PathBuf,
    content_hash: String,
    /// Names of files that the archive holds more than once, with the same content each time.
    repeated: Vec<String>,
    /// Removes the folder on drop.
    private: Option<PrivateFolder>,
}

impl Archive {
    /// Opens a `.fmu` file or an unpacked folder with the default limits.
    pub fn open(path: impl AsRef<Path>) -> Result<Archive, FmiError> {
        Archive::open_with(path, &ArchiveLimits::default())
    }

    /// Opens a `.fmu` file or an unpacked folder.
    ///
    /// Errors: [`FmiError::Io`] for what the system refuses; [`FmiError::BadArchive`], [`FmiError::BadEntry`]
    /// and [`FmiError::ArchiveLimit`] for archives that are damaged, dishonest or too large;
    /// [`FmiError::NoModelDescription`] for other archives and folders. Nothing is left behind.
    pub fn open_with(path: impl AsRef<Path>, limits: &ArchiveLimits) -> Result<Archive, FmiError> {
        let path = path.as_ref();
        let metadata = path.metadata().map_err(FmiError::io("open", path))?;
        if metadata.is_dir() { Archive::open_folder(path, limits) } else { Archive::unpack(path, limits) }
    }

    fn open_folder(path: &Path, limits: &ArchiveLimits) -> Result<Archive, FmiError> {
        let root = std::path::absolute(path).map_err(FmiError::io("find", path))?;
        if !root.join(MODEL_DESCRIPTION).is_file() {
            return Err(FmiError::NoModelDescription { path: path.to_owned(), hint: None });
        }
        let content_hash = hash::of_folder(&root, limits)?;
        Ok(Archive { root, content_hash, repeated: Vec::new(), private: None })
    }

    fn unpack(path: &Path, limits: &ArchiveLimits) -> Result<Archive, FmiError> {
        let mut file = File::open(path).map_err(FmiError::io("open", path))?;
        let listing = entries::list(path, &file, limits)?;
        let content_hash = hash::of_file(path, &mut file)?;
        let private = PrivateFolder::create()?;
        unpack::all(path, &file, &listing, private.path())?;
        let repeated =
            listing.into_iter().filter(|entry| entry.is_repeated).map(|entry| entry.name).collect();
        Ok(Archive { root: private.path().to_owned(), content_hash, repeated, private: Some(private) })
    }

    /// The folder that holds `modelDescription.xml`; an absolute path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// SHA-256 of the archive file, or of all names and contents of a folder, in hexadecimal digits.
    pub fn content_hash(&self) -> &str {
        &self.content_hash
    }

    /// Names of files that the archive holds more than once, with the same content each time.
    pub fn repeated(&self) -> &[String] {
        &self.repeated
    }

    /// The hash of the content as it is at present: a folder that is not private may have been edited.
    pub(crate) fn present_hash(&self) -> Result<String, FmiError> {
        match self.private {
            Some(_) => Ok(self.content_hash.clone()),
            None => hash::of_folder(&self.root, &ArchiveLimits::default()),
        }
    }

    /// Whether the folder is a private one that goes with this value.
    pub fn is_private(&self) -> bool {
        self.private.is_some()
    }
}

impl AsRef<Path> for Archive {
    fn as_ref(&self) -> &Path {
        &self.root
    }
}
