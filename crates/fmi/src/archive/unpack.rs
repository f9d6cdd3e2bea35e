//! Writes entries of a checked archive to a folder or to another writer. Every byte is counted.

use super::entries::{Record, refused};
use super::hash::Hashing;
use super::positioned::Positioned;
use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use zip::ZipReadOptions;

/// Number of bytes that are decompressed and written at a time.
const BUFFER: usize = 1 << 16;

/// Archive from which entries are read.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) path: &'a Path,
    pub(super) file: &'a File,
    pub(super) cancel: &'a CancelRequest,
}

impl Source<'_> {
    /// Unpacks an entry below `root`, and records its folder. A file that cannot be unpacked completely is
    /// removed.
    pub(super) fn unpack<T: Default>(
        self,
        entry: &Record,
        root: &Path,
        folders: &mut HashMap<PathBuf, T>,
    ) -> Result<()> {
        let target = root.join(&entry.name);
        let folder = if entry.is_folder { &target } else { target.parent().unwrap_or(root) };
        if !folders.contains_key(folder) {
            fs::create_dir_all(folder).map_err(FmiError::io("create", folder))?;
            folders.insert(folder.to_owned(), T::default());
        }
        if entry.is_folder { Ok(()) } else { self.unpack_file(entry, &target) }
    }

    fn unpack_file(self, entry: &Record, target: &Path) -> Result<()> {
        // Never writes to an existing file, because names may collide in ways that only the file system
        // knows.
        let mut out = File::create_new(target).map_err(FmiError::io("create", target))?;
        let written = match (entry.entry.external_attributes() >> 16) & 0o111 != 0 {
            true => {
                crate::platform::make_executable(&out).map_err(FmiError::io("set the permissions of", target))
            }
            false => Ok(()),
        };
        written.and_then(|()| self.copy(entry, &mut out, target)).inspect_err(|_| {
            // An error is ignored, because nothing more can be done about an incomplete file that cannot be
            // removed.
            let _ = fs::remove_file(target);
        })
    }

    /// Returns the contents of an entry. Its header declares a size that fits into memory.
    pub(super) fn read(self, entry: &Record) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let size = usize::try_from(entry.entry.size()).unwrap_or(usize::MAX);
        bytes
            .try_reserve_exact(size)
            .map_err(|_| FmiError::io("read", self.path)(io::Error::from(io::ErrorKind::OutOfMemory)))?;
        self.copy(entry, &mut bytes, self.path)?;
        Ok(bytes)
    }

    /// True if two entries have the same contents.
    pub(super) fn are_same(self, one: &Record, other: &Record) -> Result<bool> {
        let hash = |entry: &Record| {
            let mut hashing = Hashing::default();
            self.copy(entry, &mut hashing, self.path)?;
            Ok::<String, FmiError>(hashing.finish())
        };
        Ok(hash(one)? == hash(other)?)
    }

    /// Copies the contents of an entry to `out`. `target` is the path for error messages. Stops as soon as
    /// there are more bytes than declared. The checksum is compared at the end.
    fn copy(self, entry: &Record, out: &mut dyn Write, target: &Path) -> Result<()> {
        let mut file = Positioned::new(self.file);
        let source = entry.entry.as_ref().with_reader(&mut file, ZipReadOptions::new());
        let mut source = source.map_err(|error| self.damaged(entry, error.to_string()))?;
        let mut buffer = vec![0; BUFFER];
        let (mut found, declared) = (0, entry.entry.size());
        loop {
            self.cancel.check()?;
            let n = match source.read(&mut buffer) {
                Ok(0) if found == declared => return Ok(()),
                Ok(0) => {
                    let problem = EntryProblem::WrongSize { found, declared };
                    return Err(refused(self.path, &entry.name, problem));
                }
                Ok(n) => n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(self.damaged(entry, error.to_string())),
            };
            found += n as u64;
            out.write_all(&buffer[..n]).map_err(FmiError::io("write", target))?;
        }
    }

    fn damaged(self, entry: &Record, problem: String) -> FmiError {
        refused(self.path, &entry.name, EntryProblem::Damaged(problem))
    }
}
