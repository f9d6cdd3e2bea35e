//! Writing entries of a checked archive into a folder, or anywhere else, counting every byte.

use super::directory::Record;
use super::entries::{DEFLATED, refused};
use super::hash::Hashing;
use super::positioned::Positioned;
use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use flate2::bufread::DeflateDecoder;
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Bytes read at a time, at most; bytes inflated and written at a time.
const BUFFER: usize = 1 << 16;

/// Room for a local header and its name, in front of packed bytes.
const HEADER_ROOM: u64 = 256;

/// Where entries are read from.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) path: &'a Path,
    pub(super) file: &'a File,
    pub(super) cancel: &'a CancelRequest,
}

impl Source<'_> {
    /// Unpacks an entry below `root`, and notes the folder that holds it. A file that cannot be unpacked
    /// whole does not stay.
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
        // Refuses to write where something is already: names may collide in ways only the file system knows.
        let mut out = File::create_new(target).map_err(FmiError::io("create", target))?;
        let written = match entry.unix_mode & 0o111 != 0 {
            true => {
                crate::platform::make_executable(&out).map_err(FmiError::io("mark as executable", target))
            }
            false => Ok(()),
        };
        written.and_then(|()| self.copy(entry, &mut out, target)).inspect_err(|_| {
            // Nothing more can be done about half a file that does not go.
            let _ = fs::remove_file(target);
        })
    }

    /// The contents of an entry, which its header says are not too long to be held in memory.
    pub(super) fn read(self, entry: &Record) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let size = usize::try_from(entry.size).unwrap_or(usize::MAX);
        bytes
            .try_reserve_exact(size)
            .map_err(|_| FmiError::io("read", self.path)(io::Error::from(io::ErrorKind::OutOfMemory)))?;
        self.copy(entry, &mut bytes, self.path)?;
        Ok(bytes)
    }

    /// Returns true if two entries have the same contents.
    pub(super) fn are_same(self, one: &Record, other: &Record) -> Result<bool> {
        let hash = |entry: &Record| {
            let mut hashing = Hashing::default();
            self.copy(entry, &mut hashing, self.path)?;
            Ok::<String, FmiError>(hashing.finish())
        };
        Ok(hash(one)? == hash(other)?)
    }

    /// Copies the contents of an entry to `out`, which is or stands for the file `target`.
    fn copy(self, entry: &Record, out: &mut dyn Write, target: &Path) -> Result<()> {
        let size = entry.compressed_size.saturating_add(HEADER_ROOM).min(BUFFER as u64) as usize;
        let mut file = BufReader::with_capacity(size, Positioned::new(self.file, 0));
        let data_start =
            entry.find_data(&mut file).map_err(|problem| refused(self.path, &entry.name, problem))?;
        let behind_name = file.stream_position().map_err(FmiError::io("read", self.path))?;
        // Its extra fields stand between.
        file.seek_relative((data_start - behind_name) as i64).map_err(FmiError::io("read", self.path))?;
        let mut packed = file.take(entry.compressed_size);
        if entry.method == DEFLATED {
            self.copy_from(&mut DeflateDecoder::new(&mut packed), entry, out, target)?;
        } else {
            self.copy_from(&mut packed, entry, out, target)?;
        }
        // A deflate stream that ends before the packed bytes do was declared too long.
        match packed.limit() {
            0 => Ok(()),
            unused => Err(self.damaged(
                entry,
                format!(
                    "only {} of its {} packed bytes are used",
                    entry.compressed_size - unused,
                    entry.compressed_size
                ),
            )),
        }
    }

    /// Copies the contents of an entry; stops as soon as there are more bytes than declared.
    fn copy_from(
        self,
        source: &mut impl Read,
        entry: &Record,
        out: &mut dyn Write,
        target: &Path,
    ) -> Result<()> {
        let wrong_size = |found| EntryProblem::WrongSize { found, declared: entry.size };
        let mut buffer = vec![0; BUFFER];
        let mut found = 0;
        let mut checksum = crc32fast::Hasher::new();
        loop {
            self.cancel.check()?;
            let n = match source.read(&mut buffer) {
                Ok(0) => break,
                Ok(n) => n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(self.damaged(entry, error.to_string())),
            };
            found += n as u64;
            if found > entry.size {
                return Err(refused(self.path, &entry.name, wrong_size(found)));
            }
            checksum.update(&buffer[..n]);
            out.write_all(&buffer[..n]).map_err(FmiError::io("write", target))?;
        }
        if found < entry.size {
            return Err(refused(self.path, &entry.name, wrong_size(found)));
        }
        match checksum.finalize() {
            sum if sum == entry.crc32 => Ok(()),
            sum => {
                Err(self.damaged(entry, format!("its checksum is {sum:08x} instead of {:08x}", entry.crc32)))
            }
        }
    }

    fn damaged(self, entry: &Record, problem: String) -> FmiError {
        refused(self.path, &entry.name, EntryProblem::Damaged(problem))
    }
}
