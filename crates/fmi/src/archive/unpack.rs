//! Writing the entries of a checked archive into a folder, counting every byte.

use super::entries::{Listed, refused};
use crate::error::{EntryProblem, FmiError};
use flate2::bufread::DeflateDecoder;
use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Unpacks all entries of the archive at `path` below `root`, an empty folder.
pub(super) fn all(path: &Path, archive: &File, listed: &[Listed], root: &Path) -> Result<(), FmiError> {
    let mut archive = BufReader::with_capacity(1 << 16, archive);
    let mut buffer = vec![0; 1 << 16];
    let mut made = HashSet::new();
    for entry in listed {
        let target = root.join(&entry.name);
        let folder = if entry.is_folder { &target } else { target.parent().unwrap_or(root) };
        if made.insert(folder.to_owned()) {
            fs::create_dir_all(folder).map_err(FmiError::io("create", folder))?;
        }
        if entry.is_repeated {
            again(path, &mut archive, entry, &target, &mut buffer)?;
        } else if !entry.is_folder {
            one(path, &mut archive, entry, &target, &mut buffer)?;
        }
    }
    Ok(())
}

fn one(
    path: &Path,
    archive: &mut BufReader<&File>,
    entry: &Listed,
    target: &Path,
    buffer: &mut [u8],
) -> Result<(), FmiError> {
    // Refuses to write where something is already: names may collide in ways only the file system knows.
    let mut out = File::create_new(target).map_err(FmiError::io("create", target))?;
    if entry.is_executable {
        crate::platform::make_executable(&out).map_err(FmiError::io("mark as executable", target))?;
    }
    contents(path, archive, entry, target, &mut out, buffer)
}

/// Compares an entry with the file that an earlier one has made.
fn again(
    path: &Path,
    archive: &mut BufReader<&File>,
    entry: &Listed,
    target: &Path,
    buffer: &mut [u8],
) -> Result<(), FmiError> {
    let file = File::open(target).map_err(FmiError::io("open", target))?;
    let mut compared =
        Compared { first: BufReader::with_capacity(1 << 16, file), same: true, bytes: Vec::new() };
    contents(path, archive, entry, target, &mut compared, buffer)?;
    if compared.same { Ok(()) } else { Err(refused(path, &entry.name, EntryProblem::Duplicate)) }
}

/// Takes bytes and tells whether they are those of a file.
struct Compared {
    first: BufReader<File>,
    same: bool,
    bytes: Vec<u8>,
}

impl Write for Compared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes.resize(bytes.len(), 0);
        self.first.read_exact(&mut self.bytes)?;
        self.same &= self.bytes == bytes;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Copies the contents of an entry to `out`, which is or stands for the file `target`.
fn contents(
    path: &Path,
    archive: &mut BufReader<&File>,
    entry: &Listed,
    target: &Path,
    out: &mut dyn Write,
    buffer: &mut [u8],
) -> Result<(), FmiError> {
    archive.seek(SeekFrom::Start(entry.data_start)).map_err(FmiError::io("read", path))?;
    let mut packed = archive.take(entry.compressed_size);
    let copied = if entry.is_deflated {
        let mut inflated = DeflateDecoder::new(&mut packed);
        copy(&mut inflated, entry, out, buffer)
    } else {
        copy(&mut packed, entry, out, buffer)
    };
    copied.and_then(|()| check_all_used(packed.limit(), entry)).map_err(|failure| match failure {
        Failure::Entry(problem) => refused(path, &entry.name, problem),
        Failure::Write(error) => FmiError::io("write", target)(error),
    })
}

enum Failure {
    Entry(EntryProblem),
    Write(io::Error),
}

/// Copies the contents of an entry; stops as soon as there are more bytes than declared.
fn copy(
    source: &mut impl Read,
    entry: &Listed,
    out: &mut dyn Write,
    buffer: &mut [u8],
) -> Result<(), Failure> {
    let mut found = 0;
    let mut checksum = crc32fast::Hasher::new();
    loop {
        let n = match source.read(buffer) {
            Ok(0) => break,
            Ok(n) => n,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(Failure::Entry(EntryProblem::Damaged(error.to_string()))),
        };
        found += n as u64;
        if found > entry.size {
            return Err(Failure::Entry(EntryProblem::WrongSize { found, declared: entry.size }));
        }
        checksum.update(&buffer[..n]);
        out.write_all(&buffer[..n]).map_err(Failure::Write)?;
    }
    if found < entry.size {
        return Err(Failure::Entry(EntryProblem::WrongSize { found, declared: entry.size }));
    }
    match checksum.finalize() {
        sum if sum == entry.crc32 => Ok(()),
        sum => Err(Failure::Entry(EntryProblem::Damaged(format!(
            "its checksum is {sum:08x} instead of {:08x}",
            entry.crc32
        )))),
    }
}

/// A deflate stream that ends before the packed bytes do was declared too long.
fn check_all_used(unused: u64, entry: &Listed) -> Result<(), Failure> {
    match unused {
        0 => Ok(()),
        _ => Err(Failure::Entry(EntryProblem::Damaged(format!(
            "only {} of its {} packed bytes are used",
            entry.compressed_size - unused,
            entry.compressed_size
        )))),
    }
}
