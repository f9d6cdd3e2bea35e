//! The files of an FMU. A `.fmu` archive is unpacked part by part into a private folder that is removed with
//! the value. An unpacked folder is used in place. Archives with entries that are not allowed in FMUs are
//! rejected before anything is written.

mod entries;
mod hash;
mod limits;
mod names;
mod packed;
mod positioned;
mod private;
mod unpack;

pub(crate) use hash::{files_below, of_texts as hash_of_texts};
pub use limits::ArchiveLimits;
pub(crate) use names::MODEL_DESCRIPTION;
pub(crate) use packed::Part;
pub(crate) use private::PrivateFolder;

use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use crate::platform::{FileIdentity, LIBRARY_EXTENSION, file_identity};
use base::files::open_regular;
use packed::Packed;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Checks that the names can be the names of files in one archive. Otherwise, returns the first invalid name
/// and the reason.
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

/// True if a relative path with slashes stays inside its base folder.
pub(crate) fn is_inside(path: &str) -> bool {
    names::check(path).is_ok()
}

/// An opened FMU: a `.fmu` file or a folder with `modelDescription.xml` at its root.
///
/// The directory of a file is read and checked when the file is opened. The headers of all entries must agree
/// with the directory, and no two entries may share bytes. Contents are unpacked on demand, and then checked
/// against their sizes and checksums.
#[derive(Debug)]
pub struct Archive {
    content: Content,
    content_hash: OnceLock<String>,
}

#[derive(Debug)]
enum Content {
    Folder(Folder),
    Packed(Packed),
    Absent(Absent),
}

/// A file or folder that does not exist or no longer exists, with its stored description.
#[derive(Debug)]
struct Absent {
    path: PathBuf,
    description: Vec<u8>,
    /// Reason why the file is unavailable.
    reason: String,
}

/// An unpacked folder.
#[derive(Debug)]
struct Folder {
    /// Absolute path.
    root: PathBuf,
    /// Limits on the number and size of the files.
    limits: ArchiveLimits,
    /// Identities of the libraries when the folder was opened.
    libraries: Vec<(PathBuf, FileIdentity)>,
}

impl Archive {
    /// Opens a `.fmu` file or an unpacked folder with the default limits.
    ///
    /// # Errors
    /// Returns the errors of [`open_with`](Self::open_with).
    pub fn open(path: impl AsRef<Path>) -> Result<Archive> {
        Archive::open_with(path, &ArchiveLimits::default(), &CancelRequest::default())
    }

    /// Opens a `.fmu` file or an unpacked folder.
    ///
    /// # Errors
    /// Returns [`FmiError::Io`] for errors of the operating system; [`FmiError::BadArchive`],
    /// [`FmiError::BadEntry`] and [`FmiError::ArchiveLimit`] for archives that are damaged, inconsistent or
    /// too large; [`FmiError::NoModelDescription`] for archives and folders without a model description; or
    /// [`FmiError::Cancelled`].
    pub fn open_with(
        path: impl AsRef<Path>,
        limits: &ArchiveLimits,
        cancel: &CancelRequest,
    ) -> Result<Archive> {
        let path = path.as_ref();
        let metadata = path.metadata().map_err(FmiError::io("open", path))?;
        let content = match metadata.is_dir() {
            true => Content::Folder(Folder::open(path, limits)?),
            false if path.extension().is_some_and(|suffix| suffix.eq_ignore_ascii_case("ssd")) => {
                let hint = ", because an .ssd file describes a system of models. Use one of its FMUs";
                return Err(FmiError::NoModelDescription {
                    path: path.to_owned(),
                    hint: Some(hint.to_owned()),
                });
            }
            false => Content::Packed(Packed::open(path, limits, cancel)?),
        };
        Ok(Archive { content, content_hash: OnceLock::new() })
    }

    /// Creates an archive of which only the description is available. The archive had this content when it
    /// was at `path`. No other file of it can be read.
    pub(crate) fn absent(path: &Path, description: Vec<u8>, content_hash: String, reason: String) -> Archive {
        let content = Content::Absent(Absent { path: path.to_owned(), description, reason });
        Archive { content, content_hash: content_hash.into() }
    }

    /// True if only the description is available.
    pub(crate) fn is_absent(&self) -> bool {
        matches!(self.content, Content::Absent(_))
    }

    fn missing(&self, absent: &Absent) -> FmiError {
        let Absent { path, reason, .. } = absent;
        let content_hash = self.content_hash.get().cloned().unwrap_or_default();
        FmiError::Absent { path: path.clone(), content_hash, reason: reason.clone() }
    }

    /// Unpacks the whole archive into a private folder, which is removed with this value. Returns the
    /// absolute path of the folder that contains `modelDescription.xml`. An unpacked folder is returned
    /// unchanged.
    ///
    /// # Errors
    /// Returns [`FmiError::BadEntry`] for contents that differ from the directory of the archive,
    /// [`FmiError::Io`], or [`FmiError::BadArchive`] if the file has been modified since it was opened. No
    /// files remain after an error.
    pub fn unpack(&self) -> Result<PathBuf> {
        self.unpack_part(Part::All, &CancelRequest::default())
    }

    /// True if this process and copies of it can share the unpacked files. This requires an archive without
    /// resources, because simulations may change resources.
    pub(crate) fn serves_copies(&self) -> bool {
        matches!(&self.content, Content::Packed(packed) if !packed.has_resources())
    }

    /// Unpacks a part of the archive. Existing files are kept, and removed files are unpacked again.
    pub(crate) fn unpack_part(&self, part: Part, cancel: &CancelRequest) -> Result<PathBuf> {
        match &self.content {
            Content::Packed(packed) => packed.unpack(part, cancel),
            Content::Folder(Folder { root, .. }) => {
                root.metadata().map_err(FmiError::io("open", root))?;
                Ok(root.clone())
            }
            Content::Absent(absent) => Err(self.missing(absent)),
        }
    }

    /// Returns the names of all files.
    pub(crate) fn file_names(&self) -> Result<Vec<String>> {
        match &self.content {
            Content::Packed(packed) => Ok(packed.file_names().map(str::to_owned).collect()),
            Content::Absent(absent) => Err(self.missing(absent)),
            Content::Folder(Folder { root, limits, .. }) => {
                Ok(files_below(root, limits.entries)?.into_iter().map(|(name, _)| name).collect())
            }
        }
    }

    /// Returns the bytes of `modelDescription.xml`.
    pub(crate) fn description(&self, limit: u64, cancel: &CancelRequest) -> Result<Vec<u8>> {
        let path = || match &self.content {
            Content::Packed(packed) => packed.path(),
            Content::Folder(folder) => &folder.root,
            Content::Absent(absent) => &absent.path,
        };
        let bytes = self.read(MODEL_DESCRIPTION, limit, cancel)?;
        bytes.ok_or_else(|| FmiError::NoModelDescription { path: path().to_owned(), hint: None })
    }

    /// Returns the bytes of a file, at most `limit` (one more for an unpacked folder); `None` if there is no
    /// file with this name.
    pub(crate) fn read(&self, name: &str, limit: u64, cancel: &CancelRequest) -> Result<Option<Vec<u8>>> {
        match &self.content {
            Content::Packed(packed) => packed.read(name, limit, cancel),
            Content::Absent(absent) => Ok((name == MODEL_DESCRIPTION).then(|| absent.description.clone())),
            Content::Folder(Folder { root, .. }) => {
                let path = root.join(name);
                let file = match open_regular(&path) {
                    Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
                    file => file.map_err(FmiError::io("open", &path))?,
                };
                let mut bytes = Vec::new();
                file.take(limit.saturating_add(1))
                    .read_to_end(&mut bytes)
                    .map_err(FmiError::io("read", &path))?;
                Ok(Some(bytes))
            }
        }
    }

    /// Returns the SHA-256 of the archive file, or of all names and contents of a folder, in hexadecimal
    /// digits. The first call computes it.
    ///
    /// # Errors
    /// Returns an error if the files can no longer be read, or if the archive has been modified since it was
    /// opened.
    pub fn content_hash(&self) -> Result<&str> {
        if let Some(hash) = self.content_hash.get() {
            return Ok(hash);
        }
        let hash = match &self.content {
            Content::Packed(packed) => packed.hash()?,
            Content::Folder(folder) => hash::of_folder(&folder.root, &folder.limits)?,
            Content::Absent(absent) => return Err(self.missing(absent)),
        };
        Ok(self.content_hash.get_or_init(|| hash))
    }

    /// Returns a hash of the directory of an archive (names, sizes and checksums). Returns `None` for a
    /// folder, because it can be edited.
    pub(crate) fn fingerprint(&self) -> Option<String> {
        match &self.content {
            Content::Packed(packed) => Some(packed.fingerprint()),
            Content::Folder(..) | Content::Absent(_) => None,
        }
    }

    /// Returns the names of files that the archive contains more than once, with identical contents.
    pub fn repeated(&self) -> Vec<&str> {
        match &self.content {
            Content::Packed(packed) => packed.repeated().collect(),
            Content::Folder(..) | Content::Absent(_) => Vec::new(),
        }
    }

    /// Returns the hash of the current content. A folder that is not private may have been edited.
    pub(crate) fn present_hash(&self) -> Result<String> {
        match &self.content {
            Content::Packed(_) | Content::Absent(_) => self.content_hash().map(str::to_owned),
            Content::Folder(folder) => hash::of_folder(&folder.root, &folder.limits),
        }
    }

    /// Returns a library in a folder that has changed since the folder was opened. The description may then
    /// belong to another version of the library.
    pub(crate) fn changed_library(&self) -> Option<&Path> {
        let Content::Folder(folder) = &self.content else { return None };
        let is_changed = |(path, then): &&(PathBuf, FileIdentity)| {
            !path.metadata().is_ok_and(|now| file_identity(&now).same_content(then))
        };
        folder.libraries.iter().find(is_changed).map(|(path, _)| &**path)
    }

    /// Returns the files of a folder by their names in an archive; `None` for an archive.
    pub(crate) fn loose_files(&self) -> Result<Option<Vec<(String, PathBuf)>>> {
        match &self.content {
            Content::Folder(Folder { root, limits, .. }) => files_below(root, limits.entries).map(Some),
            Content::Packed(_) => Ok(None),
            Content::Absent(absent) => Err(self.missing(absent)),
        }
    }

    /// True for an archive, which is unpacked into a private folder that is removed with this value.
    pub fn is_private(&self) -> bool {
        matches!(self.content, Content::Packed(_))
    }
}

impl Folder {
    /// Opens a folder, and checks that its files could belong to an FMU.
    fn open(path: &Path, limits: &ArchiveLimits) -> Result<Self> {
        let root = std::path::absolute(path).map_err(FmiError::io("find", path))?;
        if !root.join(MODEL_DESCRIPTION).is_file() {
            return Err(FmiError::NoModelDescription { path: path.to_owned(), hint: None });
        }
        let files = files_below(&root, limits.entries)?;
        let is_library = |name: &str| {
            let extension = Path::new(name).extension();
            name.starts_with("binaries/") && extension.is_some_and(|extension| extension == LIBRARY_EXTENSION)
        };
        let libraries = files.into_iter().filter(|(name, _)| is_library(name));
        let with_identity =
            |(_, path): (String, PathBuf)| Some((path.clone(), file_identity(&path.metadata().ok()?)));
        Ok(Self { root, limits: limits.clone(), libraries: libraries.filter_map(with_identity).collect() })
    }
}
