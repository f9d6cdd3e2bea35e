//! The list of entries of an archive, checked: names, kinds and sizes when it is opened; local headers, and
//! that no byte serves two entries, before anything is unpacked.

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
pub(super) const DEFLATED: u16 = 8;

/// Bytes read at once of the directory, which is in one piece, and of local headers, which lie apart.
const DIRECTORY_BUFFER: usize = 1 << 14;
const HEADER_BUFFER: usize = 256;

/// After so many entries it is looked whether work is to end.
const ENTRIES_BETWEEN_LOOKS: usize = 64;

/// The entries of an archive.
#[derive(Debug)]
pub(super) struct Entries {
    pub(super) listed: Vec<Record>,
    directory: Directory,
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
) -> Result<Entries> {
    let mut archive = BufReader::with_capacity(DIRECTORY_BUFFER, archive);
    let unreadable = |error| unreadable_at(path, error);
    let directory = Directory::find(&mut archive).map_err(unreadable)?;
    check_limit(path, "entries", directory.n_entries, limits.entries)?;
    let mut records = directory.read(&mut archive).map_err(unreadable)?;
    let mut names = Names::with_capacity(records.len());
    let mut kinds = Vec::with_capacity(records.len());
    for (position, record) in records.iter().enumerate() {
        if position.is_multiple_of(ENTRIES_BETWEEN_LOOKS) {
            cancel.check()?;
        }
        let checked = check_record(record, &mut names, &records, limits);
        kinds.push(checked.map_err(|problem| refused(path, &record.name, problem))?);
        check_limit(path, "files and folders", names.count(), limits.entries)?;
        check_limit(path, "folders", names.n_folders(), limits.folders)?;
    }
    for (record, kind) in records.iter_mut().zip(kinds) {
        (record.is_folder, record.repeats) = kind;
        if record.name.ends_with('/') {
            record.raw_name.get_or_insert_with(|| record.name.clone().into_bytes());
            record.name.pop();
        }
    }
    check_root(path, &records)?;
    let sizes = records.iter().map(|entry| (entry.compressed_size, entry.size));
    limits.check_totals(path, sizes)?;
    Ok(Entries { listed: records, directory })
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

/// Kind of an entry: whether it is a folder, and which earlier one it repeats.
type Kind = (bool, Option<usize>);

fn check_record<'a>(
    record: &'a Record,
    names: &mut Names<'a>,
    records: &[Record],
    limits: &ArchiveLimits,
) -> Result<Kind, EntryProblem> {
    // The folder of the archive itself, which some tools list.
    let is_root = record.name.is_empty() && record.raw_name.as_ref().is_some_and(|raw| !raw.is_empty());
    if !is_root {
        names::check(&record.name)?;
    }
    let is_folder = is_root || is_folder(record)?;
    check_storage(record, is_folder, limits)?;
    if is_root {
        return Ok((true, None));
    }
    match names.add(&record.name, is_folder) {
        // Some tools pack a file twice.
        Err(EntryProblem::Duplicate) => match repeated(record, names, records) {
            None => Err(EntryProblem::Duplicate),
            first => Ok((is_folder, first)),
        },
        other => other.map(|()| (is_folder, None)),
    }
}

/// Index of an earlier entry that seems to be the same file.
fn repeated(record: &Record, names: &Names<'_>, records: &[Record]) -> Option<usize> {
    let content = |record: &Record| (record.size, record.crc32);
    names
        .position(&record.name)
        .filter(|&first| records[first].name == record.name && content(&records[first]) == content(record))
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
fn check_root(path: &Path, listed: &[Record]) -> Result<()> {
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

impl Entries {
    /// True if the directory of an archive lists the same contents at the same places.
    pub(super) fn are_those_of(&self, archive: impl Read + Seek) -> bool {
        let mut archive = BufReader::with_capacity(DIRECTORY_BUFFER, archive);
        let is_same =
            |(a, b): (&Record, &Record)| (a.content(), a.header_start) == (b.content(), b.header_start);
        Directory::find(&mut archive).is_ok_and(|directory| {
            directory.n_entries == self.listed.len() as u64
                && directory
                    .read(&mut archive)
                    .is_ok_and(|records| self.listed.iter().zip(&records).all(is_same))
        })
    }

    /// Reads all local headers: they agree with the directory, and no byte serves two entries.
    pub(super) fn check_local_headers(
        &self,
        path: &Path,
        archive: impl Read + Seek,
        cancel: &CancelRequest,
    ) -> Result<()> {
        let mut archive = BufReader::with_capacity(HEADER_BUFFER, archive);
        let mut extents = Vec::with_capacity(self.listed.len());
        for (position, entry) in self.listed.iter().enumerate() {
            cancel.check()?;
            let data_start =
                entry.find_data(&mut archive).map_err(|problem| refused(path, &entry.name, problem))?;
            let end = data_start.saturating_add(entry.compressed_size);
            extents.push(ByteRange { start: entry.header_start, end, position });
        }
        extents.sort_by_key(|extent| (extent.start, extent.end));
        match find_overlap(&extents, self.directory, &self.listed) {
            Some((entry, problem)) => Err(refused(path, &entry.name, problem)),
            None => Ok(()),
        }
    }
}

impl Record {
    /// Compares the local header of the entry with the directory and returns where its data start.
    pub(super) fn find_data(&self, archive: &mut (impl Read + Seek)) -> Result<u64, EntryProblem> {
        let missing = |error: io::Error| {
            EntryProblem::Damaged(format!("no local header at byte {} ({error})", self.header_start))
        };
        archive.seek(SeekFrom::Start(self.header_start)).map_err(missing)?;
        let mut bytes = [0; 30];
        archive.read_exact(&mut bytes).map_err(missing)?;
        if !bytes.starts_with(b"PK\x03\x04") {
            return Err(EntryProblem::Damaged(format!("no local header at byte {}", self.header_start)));
        }
        let header = Fields(&bytes);
        let mut name = vec![0; usize::from(header.half(26))];
        archive.read_exact(&mut name).map_err(missing)?;
        if name != self.raw_name.as_deref().unwrap_or(self.name.as_bytes()) {
            let local = String::from_utf8_lossy(&name);
            return Err(EntryProblem::HeaderMismatch(format!("name \"{}\"", local.escape_debug())));
        }
        if header.half(6) & ENCRYPTED != 0 {
            return Err(EntryProblem::Encrypted);
        }
        if header.half(8) != self.method {
            return Err(EntryProblem::HeaderMismatch(format!("compression method {}", header.half(8))));
        }
        if header.half(6) & SIZES_FOLLOW_DATA == 0 {
            check_local_size("packed", header.word(18), self.compressed_size)?;
            check_local_size("unpacked", header.word(22), self.size)?;
        }
        Ok(self.header_start + 30 + u64::from(header.half(26)) + u64::from(header.half(28)))
    }
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
    listed: &'a [Record],
) -> Option<(&'a Record, EntryProblem)> {
    let entry = |extent: &ByteRange| &listed[extent.position];
    for pair in extents.windows(2) {
        let (start, end) = (pair[1].start, pair[0].end.min(pair[1].end));
        if pair[0].end > start {
            let other = entry(&pair[0]).name.clone();
            return Some((entry(&pair[1]), EntryProblem::Overlap { start, end, other }));
        }
    }
    let last = extents.last().filter(|last| last.end > directory.start)?;
    let other = "the directory of the archive".to_owned();
    Some((entry(last), EntryProblem::Overlap { start: directory.start, end: last.end, other }))
}
