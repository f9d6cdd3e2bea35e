//! The files of an FMU: a `.fmu` archive, unpacked part by part into a private folder that goes when the
//! value goes, or an unpacked folder as it is. Archives whose entries are not what FMUs hold are refused
//! before anything is written.

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

/// Checks that the names could be those of the files of one archive; else returns the first that could not,
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

/// True if a relative path with slashes stays inside of the folder it starts in.
pub(crate) fn is_inside(path: &str) -> bool {
    names::check(path).is_ok()
}

/// An opened FMU: a `.fmu` file or a folder with `modelDescription.xml` at its root.
///
/// Of a file, the directory is read and checked when it is opened: the headers of all entries agree with it,
/// and no byte serves two of them. Contents are unpacked, and checked against their sizes and checksums, when
/// they are needed.
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

/// A file or folder that is not there (any more), of which the description was kept.
#[derive(Debug)]
struct Absent {
    path: PathBuf,
    description: Vec<u8>,
    /// Why it is not at hand.
    reason: String,
}

/// An unpacked folder.
#[derive(Debug)]
struct Folder {
    /// An absolute path.
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
    /// As [`open_with`](Self::open_with).
    pub fn open(path: impl AsRef<Path>) -> Result<Archive> {
        Archive::open_with(path, &ArchiveLimits::default(), &CancelRequest::default())
    }

    /// Opens a `.fmu` file or an unpacked folder.
    ///
    /// # Errors
    /// [`FmiError::Io`] for what the system refuses; [`FmiError::BadArchive`], [`FmiError::BadEntry`]
    /// and [`FmiError::ArchiveLimit`] for archives that are damaged, contradict themselves or are too large;
    /// [`FmiError::NoModelDescription`] for other archives and folders; [`FmiError::Cancelled`].
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
                let hint = ": an .ssd describes a system of models, of which none is simulated as a whole; give one of its FMUs";
                return Err(FmiError::NoModelDescription {
                    path: path.to_owned(),
                    hint: Some(hint.to_owned()),
                });
            }
            false => Content::Packed(Packed::open(path, limits, cancel)?),
        };
        Ok(Archive { content, content_hash: OnceLock::new() })
    }

    /// An archive of which only the description is available: it was at `path` with this content, and no
    /// other file of it can be read.
    pub(crate) fn absent(path: &Path, description: Vec<u8>, content_hash: String, reason: String) -> Archive {
        let content = Content::Absent(Absent { path: path.to_owned(), description, reason });
        Archive { content, content_hash: content_hash.into() }
    }

    /// Why there is nothing but the description.
    pub(crate) fn is_absent(&self) -> bool {
        matches!(self.content, Content::Absent(_))
    }

    fn missing(&self, absent: &Absent) -> FmiError {
        let Absent { path, reason, .. } = absent;
        let content_hash = self.content_hash.get().cloned().unwrap_or_default();
        FmiError::Absent { path: path.clone(), content_hash, reason: reason.clone() }
    }

    /// Unpacks all of it into a private folder, which goes with this value; returns the folder that holds
    /// `modelDescription.xml`, an absolute path. An unpacked folder is returned as it is.
    ///
    /// # Errors
    /// [`FmiError::BadEntry`] for contents that are not what the directory of the archive says,
    /// [`FmiError::Io`]; [`FmiError::BadArchive`] if the file was written over since it was opened. Nothing
    /// is left behind.
    pub fn unpack(&self) -> Result<PathBuf> {
        self.unpack_part(Part::All, &CancelRequest::default())
    }

    /// True if this process and copies of it can share what is unpacked: it is packed, and there are no
    /// resources, which simulations may change.
    pub(crate) fn serves_copies(&self) -> bool {
        matches!(&self.content, Content::Packed(packed) if !packed.has_resources())
    }

    /// Unpacks a part of it; what is there already stays, and what somebody has removed is unpacked again.
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

    /// The bytes of `modelDescription.xml`.
    pub(crate) fn description(&self, limit: u64, cancel: &CancelRequest) -> Result<Vec<u8>> {
        let path = || match &self.content {
            Content::Packed(packed) => packed.path(),
            Content::Folder(folder) => &folder.root,
            Content::Absent(absent) => &absent.path,
        };
        let bytes = self.read(MODEL_DESCRIPTION, limit, cancel)?;
        bytes.ok_or_else(|| FmiError::NoModelDescription { path: path().to_owned(), hint: None })
    }

    /// The bytes of a file, no more than `limit` (of an unpacked folder: one more); `None` if there is none
    /// of this name.
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

    /// SHA-256 of the archive file, or of all names and contents of a folder, in hexadecimal digits; computed
    /// when it is first asked for.
    ///
    /// # Errors
    /// The files cannot be read any more, or the archive was written over since it was opened.
    pub fn content_hash(&self) -> Result<&str> {
        if let Some(known) = self.content_hash.get() {
            return Ok(known);
        }
        let hash = match &self.content {
            Content::Packed(packed) => packed.hash()?,
            Content::Folder(folder) => hash::of_folder(&folder.root, &folder.limits)?,
            Content::Absent(absent) => return Err(self.missing(absent)),
        };
        Ok(self.content_hash.get_or_init(|| hash))
    }

    /// A hash of the directory of an archive (names, sizes and checksums); a folder, which can be edited, has
    /// none.
    pub(crate) fn fingerprint(&self) -> Option<String> {
        match &self.content {
            Content::Packed(packed) => Some(packed.fingerprint()),
            Content::Folder(..) | Content::Absent(_) => None,
        }
    }

    /// Names of files that the archive holds more than once, with the same content each time.
    pub fn repeated(&self) -> Vec<&str> {
        match &self.content {
            Content::Packed(packed) => packed.repeated().collect(),
            Content::Folder(..) | Content::Absent(_) => Vec::new(),
        }
    }

    /// The hash of the content as it is at present: a folder that is not private may have been edited.
    pub(crate) fn present_hash(&self) -> Result<String> {
        match &self.content {
            Content::Packed(_) | Content::Absent(_) => self.content_hash().map(str::to_owned),
            Content::Folder(folder) => hash::of_folder(&folder.root, &folder.limits),
        }
    }

    /// A library in a folder that is not any more what it was when the folder was opened: its description may
    /// be that of another version.
    pub(crate) fn changed_library(&self) -> Option<&Path> {
        let Content::Folder(folder) = &self.content else { return None };
        let is_changed = |(path, then): &&(PathBuf, FileIdentity)| {
            !path.metadata().is_ok_and(|now| file_identity(&now).same_content(then))
        };
        folder.libraries.iter().find(is_changed).map(|(path, _)| &**path)
    }

    /// The files of a folder by their names in an archive; `None` for a file, which is one archive.
    pub(crate) fn loose_files(&self) -> Result<Option<Vec<(String, PathBuf)>>> {
        match &self.content {
            Content::Folder(Folder { root, limits, .. }) => files_below(root, limits.entries).map(Some),
            Content::Packed(_) => Ok(None),
            Content::Absent(absent) => Err(self.missing(absent)),
        }
    }

    /// True for a file, which is unpacked into a private folder that is removed with this value.
    pub fn is_private(&self) -> bool {
        matches!(self.content, Content::Packed(_))
    }
}

impl Folder {
    /// A folder whose files are fit to be those of an FMU.
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
        let known =
            |(_, path): (String, PathBuf)| Some((path.clone(), file_identity(&path.metadata().ok()?)));
        Ok(Self { root, limits: limits.clone(), libraries: libraries.filter_map(known).collect() })
    }
}
