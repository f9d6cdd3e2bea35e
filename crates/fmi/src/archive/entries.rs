//! The list of entries of an archive, checked: names, kinds, sizes, and that no byte serves two entries.

use super::directory::{Directory, Fields, Record};
use super::limits::{ArchiveLimits, check_limit};
use super::names::MODEL_DESCRIPTION;
use super::names::{self, Names};
use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Bits of the flags.
const ENCRYPTED: u16 = 1 | 1 << 6 | 1 << 13;
const SIZES_FOLLOW_DATA: u16 = 1 << 3;

/// Compression methods.
const STORED: u16 = 0;
const DEFLATED: u16 = 8;

/// Bytes read at once of the directory, which is in one piece, and of local headers, which lie apart.
const DIRECTORY_BUFFER: usize = 1 << 13;
const HEADER_BUFFER: usize = 256;

/// One entry that has passed all checks.
#[derive(Debug)]
pub(super) struct Listed {
    /// Name without the slash at the end of folders.
    pub(super) name: String,
    pub(super) is_folder: bool,
    /// An earlier entry has this name, size and checksum: the content has to be the same.
    pub(super) is_repeated: bool,
    pub(super) is_executable: bool,
    pub(super) is_deflated: bool,
    pub(super) data_start: u64,
    pub(super) compressed_size: u64,
    pub(super) size: u64,
    pub(super) crc32: u32,
}

/// Bytes of the archive that belong to one entry: its local header and its data.
struct ByteRange {
    start: u64,
    end: u64,
    position: usize,
}

/// Lists the entries of an archive. Nothing is inflated and nothing written.
pub(super) fn list(
    path: &Path,
    archive: impl Read + Seek,
    limits: &ArchiveLimits,
    cancel: &CancelRequest,
) -> Result<Vec<Listed>> {
    let mut archive = BufReader::with_capacity(DIRECTORY_BUFFER, archive);
    let unreadable = |error| unreadable_at(path, error);
    let directory = Directory::find(&mut archive).map_err(unreadable)?;
    check_limit(path, "entries", directory.n_entries, limits.entries)?;
    let records = directory.read(&mut archive).map_err(unreadable)?;
    let mut names = Names::with_capacity(records.len());
    let mut listed = Vec::with_capacity(records.len());
    for record in &records {
        cancel.check()?;
        let checked = check_record(record, &mut names, &listed, limits);
        listed.push(checked.map_err(|problem| refused(path, &record.name, problem))?);
        check_limit(path, "files and folders", names.count(), limits.entries)?;
        check_limit(path, "folders", names.n_folders(), limits.folders)?;
    }
    check_root(path, &listed)?;
    let sizes = listed.iter().map(|entry| (entry.compressed_size, entry.size));
    limits.check_totals(path, sizes)?;
    let mut archive = BufReader::with_capacity(HEADER_BUFFER, archive.into_inner());
    check_local_headers(path, &mut archive, directory, &records, &mut listed, cancel)?;
    Ok(listed)
}

fn unreadable_at(path: &Path, error: io::Error) -> FmiError {
    match error.kind() {
        io::ErrorKind::InvalidData => FmiError::bad_archive(path, error.to_string()),
        io::ErrorKind::UnexpectedEof => FmiError::bad_archive(path, "it ends inside of its directory"),
        _ => FmiError::io("read", path)(error),
    }
}

/// The error for a problem with one entry.
pub(super) fn refused(path: &Path, entry: &str, problem: EntryProblem) -> FmiError {
    FmiError::BadEntry { path: path.to_owned(), entry: entry.to_owned(), problem }
}

fn check_record(
    record: &Record,
    names: &mut Names,
    listed: &[Listed],
    limits: &ArchiveLimits,
) -> Result<Listed, EntryProblem> {
    names::check(&record.name)?;
    let is_folder = is_folder(record)?;
    check_storage(record, is_folder, limits)?;
    let is_repeated = match names.add(&record.name, is_folder) {
        // Some tools pack a file twice.
        Err(EntryProblem::Duplicate) if repeats(record, names, listed) => true,
        other => other.map(|()| false)?,
    };
    Ok(Listed {
        is_repeated,
        name: record.name.strip_suffix('/').unwrap_or(&record.name).to_owned(),
        is_folder,
        is_executable: record.unix_mode & 0o111 != 0,
        is_deflated: record.method == DEFLATED,
        data_start: 0,
        compressed_size: record.compressed_size,
        size: record.size,
        crc32: record.crc32,
    })
}

/// True if an earlier entry seems to be the same file.
fn repeats(record: &Record, names: &Names, listed: &[Listed]) -> bool {
    let first = names.position(&record.name).and_then(|position| listed.get(position));
    first.is_some_and(|first| {
        (&first.name, first.size, first.crc32) == (&record.name, record.size, record.crc32)
    })
}

/// Tells folders from files and refuses everything else. The file type of Unix is looked at whatever system
/// the entry claims to come from, because programs that unpack do the same.
fn is_folder(record: &Record) -> Result<bool, EntryProblem> {
    match record.unix_mode & 0o170_000 {
        0o040_000 => Ok(true),
        0 | 0o100_000 => Ok(record.name.ends_with('/')),
        0o120_000 => Err(EntryProblem::NotAFile("symbolic link")),
        0o020_000 | 0o060_000 => Err(EntryProblem::NotAFile("device")),
        0o010_000 => Err(EntryProblem::NotAFile("pipe")),
        0o140_000 => Err(EntryProblem::NotAFile("socket")),
        _ => Err(EntryProblem::NotAFile("thing of an unknown type")),
    }
}

/// Checks the storage of the data: not encrypted, by a known method, with plausible sizes.
fn check_storage(record: &Record, is_folder: bool, limits: &ArchiveLimits) -> Result<(), EntryProblem> {
    let (compressed, size) = (record.compressed_size, record.size);
    if record.flags & ENCRYPTED != 0 {
        return Err(EntryProblem::Encrypted);
    }
    if is_folder && size > 0 {
        return Err(EntryProblem::FolderWithData(size));
    }
    match record.method {
        STORED if compressed != size => {
            return Err(EntryProblem::WrongSize { found: compressed, declared: size });
        }
        STORED | DEFLATED => {}
        other => return Err(EntryProblem::Compression(other)),
    }
    if size > limits.file_bytes {
        return Err(EntryProblem::TooLarge { found: size, limit: limits.file_bytes });
    }
    if limits.inflates_too_much(compressed, size) {
        return Err(EntryProblem::Ratio { compressed, size, limit: limits.ratio });
    }
    Ok(())
}

/// The description of a system of models (SSP standard 1.0, section 4.3).
const SYSTEM_STRUCTURE: &str = "SystemStructure.ssd";

/// So many FMUs and parameter sets of such an archive are named.
const MOST_NAMED: usize = 8;

/// The model description is a file at the root; if it is one folder down, the message says so.
fn check_root(path: &Path, listed: &[Listed]) -> Result<()> {
    if listed.iter().any(|entry| entry.name == MODEL_DESCRIPTION && !entry.is_folder) {
        return Ok(());
    }
    if listed.iter().any(|entry| entry.name == MODEL_DESCRIPTION) {
        let hint = Some(": what has that name there is a folder".to_owned());
        return Err(FmiError::NoModelDescription { path: path.to_owned(), hint });
    }
    if listed.iter().any(|entry| entry.name == SYSTEM_STRUCTURE) {
        let named = |suffix: &str| {
            let names = listed.iter().map(|entry| entry.name.as_str()).filter(|name| name.ends_with(suffix));
            let names: Vec<&str> = names.take(MOST_NAMED).collect();
            if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) }
        };
        let (fmus, sets) = (named(".fmu"), named(".ssv"));
        let sets = match sets.is_empty() {
            true => sets,
            false => format!(", with a parameter set{sets} as its start values"),
        };
        let hint = format!(
            ": it is an SSP archive, a system of models, of which none is simulated as a whole; unzip it and take one of its FMUs{fmus}{sets}"
        );
        return Err(FmiError::NoModelDescription { path: path.to_owned(), hint: Some(hint) });
    }
    let elsewhere = listed.iter().map(|entry| entry.name.as_str()).find(|name| {
        let file = name.rsplit('/').next().unwrap_or(name);
        file.eq_ignore_ascii_case(MODEL_DESCRIPTION) && name.matches('/').count() <= 1
    });
    let hint = elsewhere.map(|name| match name.split_once('/') {
        Some((folder, _)) => {
            format!(", but \"{name}\": pack the contents of \"{folder}\", not the folder itself")
        }
        None => format!(", but \"{name}\": upper and lower case matter"),
    });
    Err(FmiError::NoModelDescription { path: path.to_owned(), hint })
}

/// Reads all local headers: they agree with the directory, and no byte serves two entries.
fn check_local_headers(
    path: &Path,
    archive: &mut (impl Read + Seek),
    directory: Directory,
    records: &[Record],
    listed: &mut [Listed],
    cancel: &CancelRequest,
) -> Result<()> {
    let mut extents = Vec::with_capacity(records.len());
    for (position, record) in records.iter().enumerate() {
        cancel.check()?;
        let data_start =
            check_local_header(archive, record).map_err(|problem| refused(path, &record.name, problem))?;
        listed[position].data_start = data_start;
        let end = data_start.saturating_add(record.compressed_size);
        extents.push(ByteRange { start: record.header_start, end, position });
    }
    extents.sort_by_key(|extent| (extent.start, extent.end));
    match find_overlap(&extents, directory, records) {
        Some((record, problem)) => Err(refused(path, &record.name, problem)),
        None => Ok(()),
    }
}

/// Compares the local header of an entry with the directory and returns where its data start.
fn check_local_header(archive: &mut (impl Read + Seek), record: &Record) -> Result<u64, EntryProblem> {
    let missing = |error: io::Error| {
        EntryProblem::Damaged(format!("no local header at byte {} ({error})", record.header_start))
    };
    archive.seek(SeekFrom::Start(record.header_start)).map_err(missing)?;
    let mut bytes = [0; 30];
    archive.read_exact(&mut bytes).map_err(missing)?;
    if !bytes.starts_with(b"PK\x03\x04") {
        return Err(EntryProblem::Damaged(format!("no local header at byte {}", record.header_start)));
    }
    let header = Fields(&bytes);
    let mut name = vec![0; usize::from(header.half(26))];
    archive.read_exact(&mut name).map_err(missing)?;
    if name != record.raw_name {
        let local = String::from_utf8_lossy(&name);
        return Err(EntryProblem::HeaderMismatch(format!("name \"{}\"", local.escape_debug())));
    }
    if header.half(6) & ENCRYPTED != 0 {
        return Err(EntryProblem::Encrypted);
    }
    if header.half(8) != record.method {
        return Err(EntryProblem::HeaderMismatch(format!("compression method {}", header.half(8))));
    }
    if header.half(6) & SIZES_FOLLOW_DATA == 0 {
        check_local_size("packed", header.word(18), record.compressed_size)?;
        check_local_size("unpacked", header.word(22), record.size)?;
    }
    Ok(record.header_start + 30 + u64::from(header.half(26)) + u64::from(header.half(28)))
}

/// A size in a local header: all ones mean that the true one stands in an extra field.
fn check_local_size(what: &str, local: u32, declared: u64) -> Result<(), EntryProblem> {
    if local == u32::MAX || u64::from(local) == declared {
        return Ok(());
    }
    Err(EntryProblem::HeaderMismatch(format!("{local} {what} bytes instead of {declared}")))
}

/// Expects the extents in the order of their starts. Entries without data may not share headers either.
fn find_overlap<'a>(
    extents: &[ByteRange],
    directory: Directory,
    records: &'a [Record],
) -> Option<(&'a Record, EntryProblem)> {
    let record = |extent: &ByteRange| &records[extent.position];
    for pair in extents.windows(2) {
        let (start, end) = (pair[1].start, pair[0].end.min(pair[1].end));
        if pair[0].end > start {
            let other = record(&pair[0]).name.clone();
            return Some((record(&pair[1]), EntryProblem::Overlap { start, end, other }));
        }
    }
    let last = extents.last().filter(|last| last.end > directory.start)?;
    let other = "the directory of the archive".to_owned();
    Some((record(last), EntryProblem::Overlap { start: directory.start, end: last.end, other }))
}
