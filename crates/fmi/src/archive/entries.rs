//! The list of entries of an archive, as read by the crate `zip`. This module adds the checks that the crate
//! omits: names, kinds, sizes, uncounted records, and bytes shared by two entries.

use super::limits::{ArchiveLimits, check_limit};
use super::names::{self, MODEL_DESCRIPTION, Names};
use super::positioned::Positioned;
use crate::cancel_request::CancelRequest;
use crate::error::{EntryProblem, FmiError, Result};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use zip::read::{ArchiveOffset, Config, OwnedZipFileEntry, ZipFileEntry};
use zip::result::{ZipError, ZipResult};
use zip::unstable::read::ZipIterable;
use zip::{CompressionMethod, HasZipMetadata};

/// Flag bits of encrypted entries.
const ENCRYPTED: u16 = 1 | 1 << 6 | 1 << 13;

/// Size in bytes of a central header without its variable parts.
const HEADER_BYTES: usize = 46;

/// An entry of an archive.
#[derive(Debug)]
pub(super) struct Record {
    /// Normalized name, without the slash at the end of folders. Empty for the root folder of the archive
    /// (`./`).
    pub(super) name: String,
    pub(super) is_folder: bool,
    /// Index of an earlier entry with this name, size and checksum. The contents must be identical.
    pub(super) repeats: Option<usize>,
    pub(super) entry: OwnedZipFileEntry,
}

impl Record {
    fn new(entry: ZipFileEntry<'static>) -> ZipResult<Self> {
        let name = names::normalized(&entry.name()?);
        Ok(Self { name, is_folder: false, repeats: None, entry: entry.into() })
    }

    /// Returns the name, size, compressed size and checksum.
    pub(super) fn content(&self) -> (&str, u64, u64, u32) {
        (&self.name, self.entry.size(), self.entry.compressed_size(), self.entry.crc32())
    }
}

/// Byte range of one entry in the archive: its local header and its data.
struct ByteRange {
    start: u64,
    end: u64,
    position: usize,
}

/// Opens an archive for sequential reading. Unlike [`zip::ZipArchive`], the result contains all entries with
/// the same name, and their number before they are read.
fn open(file: &File) -> ZipResult<ZipIterable<Positioned<'_>>> {
    ZipIterable::try_new(Positioned::new(file), Config { archive_offset: ArchiveOffset::Known(0) })
}

/// Lists the entries of an archive. Nothing is decompressed or written.
pub(super) fn list(
    path: &Path,
    file: &File,
    limits: &ArchiveLimits,
    cancel: &CancelRequest,
) -> Result<Vec<Record>> {
    let unreadable = |error| unreadable_at(path, file, error);
    let mut archive = open(file).map_err(unreadable)?;
    check_limit(path, "entries", archive.len() as u64, limits.entries)?;
    let mut records = Vec::with_capacity(archive.len());
    for entry in archive.files().map_err(unreadable)? {
        cancel.check()?;
        records.push(entry.and_then(Record::new).map_err(unreadable)?);
    }
    if let Some(last) = records.last()
        && has_record_after(file, last.entry.central_header_start()).map_err(FmiError::io("read", path))?
    {
        let reason =
            format!("its directory contains more entries than the {} that it declares", records.len());
        return Err(FmiError::bad_archive(path, reason));
    }
    let mut names = Names::with_capacity(records.len());
    let mut kinds = Vec::with_capacity(records.len());
    for record in &records {
        cancel.check()?;
        let checked = check_record(record, &mut names, &records, limits);
        kinds.push(checked.map_err(|problem| refused(path, &record.name, problem))?);
        check_limit(path, "files and folders", names.count(), limits.entries)?;
        check_limit(path, "folders", names.n_folders(), limits.folders)?;
    }
    for (record, kind) in records.iter_mut().zip(kinds) {
        (record.is_folder, record.repeats) = kind;
        record.name.truncate(record.name.trim_end_matches('/').len());
    }
    check_root(path, &records)?;
    limits.check_totals(path, records.iter().map(|one| (one.entry.compressed_size(), one.entry.size())))?;
    check_local_headers(path, file, &records, cancel)?;
    Ok(records)
}

/// True if a record follows the one at `last`. Tools that ignore the count would read it.
fn has_record_after(file: &File, last: u64) -> io::Result<bool> {
    let mut archive = Positioned::new(file);
    archive.seek(SeekFrom::Start(last))?;
    let (mut record, mut next) = ([0; HEADER_BYTES], Vec::new());
    archive.read_exact(&mut record)?;
    // Name, extra fields, comment.
    let variable = [28, 30, 32].map(|at| i64::from(u16::from_le_bytes([record[at], record[at + 1]])));
    archive.seek(SeekFrom::Current(variable.iter().sum()))?;
    archive.take(4).read_to_end(&mut next)?;
    Ok(next == b"PK\x01\x02")
}

/// Reads all local headers, and checks that they agree with the directory and that no two entries share
/// bytes.
fn check_local_headers(path: &Path, file: &File, records: &[Record], cancel: &CancelRequest) -> Result<()> {
    let unreadable = |error| unreadable_at(path, file, error);
    let mut archive = open(file).map_err(unreadable)?.enforce_header_consistency(true);
    let mut ranges = Vec::with_capacity(records.len());
    for (record, entry) in records.iter().zip(archive.files().map_err(unreadable)?) {
        cancel.check()?;
        let mismatch = |error: ZipError| EntryProblem::HeaderMismatch(error.to_string());
        let entry = entry.map_err(|error| refused(path, &record.name, mismatch(error)))?;
        let entry = entry.get_metadata();
        let data_start = entry.data_start.get().copied().unwrap_or(entry.header_start);
        let end = data_start.saturating_add(entry.compressed_size);
        ranges.push(ByteRange { start: entry.header_start, end, position: ranges.len() });
    }
    ranges.sort_by_key(|range| (range.start, range.end));
    match find_overlap(&ranges, records) {
        Some((record, problem)) => Err(refused(path, &record.name, problem)),
        None => Ok(()),
    }
}

/// True if the directory of an archive lists these contents at these positions.
pub(super) fn are_those_of(records: &[Record], file: &File) -> bool {
    fn place(entry: &impl HasZipMetadata) -> (u32, u64, u64, u64) {
        let entry = entry.get_metadata();
        (entry.crc32, entry.compressed_size, entry.uncompressed_size, entry.header_start)
    }
    let Ok(mut archive) = open(file) else { return false };
    archive.len() == records.len()
        && archive.files().is_ok_and(|entries| {
            records.iter().zip(entries).all(|(record, entry)| {
                entry.is_ok_and(|entry| {
                    entry.name_raw() == record.entry.name_raw() && place(&entry) == place(&record.entry)
                })
            })
        })
}

fn unreadable_at(path: &Path, file: &File, error: ZipError) -> FmiError {
    let error = match error {
        ZipError::Io(error) if error.kind() != io::ErrorKind::UnexpectedEof => {
            return FmiError::io("read", path)(error);
        }
        error => error,
    };
    let mut start = Vec::new();
    match Positioned::new(file).take(4).read_to_end(&mut start) {
        Ok(_) if start == b"PK\x03\x04" => {
            let reason =
                format!("the directory at the end of the file is missing, truncated or damaged: {error}");
            FmiError::bad_archive(path, reason)
        }
        _ => FmiError::bad_archive(path, format!("not a zip archive: {error}")),
    }
}

/// Returns the error for a problem with one entry.
pub(super) fn refused(path: &Path, entry: &str, problem: EntryProblem) -> FmiError {
    FmiError::BadEntry { path: path.to_owned(), entry: entry.to_owned(), problem }
}

/// Kind of an entry: true for a folder, and the index of the earlier entry that it repeats.
type Kind = (bool, Option<usize>);

fn check_record<'a>(
    record: &'a Record,
    names: &mut Names<'a>,
    records: &[Record],
    limits: &ArchiveLimits,
) -> Result<Kind, EntryProblem> {
    // The root folder of the archive, which some tools list.
    let is_root = record.name.is_empty() && !record.entry.name_raw().is_empty();
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

/// Returns the index of an earlier entry that appears to be the same file.
fn repeated(record: &Record, names: &Names<'_>, records: &[Record]) -> Option<usize> {
    let content = |record: &Record| (record.entry.size(), record.entry.crc32());
    names
        .position(&record.name)
        .filter(|&first| records[first].name == record.name && content(&records[first]) == content(record))
}

/// Distinguishes folders from files, and rejects everything else. The Unix file type is checked regardless of
/// the system declared in the entry, because other programs also check it.
fn is_folder(record: &Record) -> Result<bool, EntryProblem> {
    match (record.entry.external_attributes() >> 16) & 0o170_000 {
        0o040_000 => Ok(true),
        0 | 0o100_000 => Ok(record.name.ends_with('/')),
        0o120_000 => Err(EntryProblem::NotAFile("symbolic link")),
        0o020_000 | 0o060_000 => Err(EntryProblem::NotAFile("device")),
        0o010_000 => Err(EntryProblem::NotAFile("pipe")),
        0o140_000 => Err(EntryProblem::NotAFile("socket")),
        _ => Err(EntryProblem::NotAFile("special file of unknown type")),
    }
}

/// Checks that the data are not encrypted, use a supported method, and have plausible sizes.
fn check_storage(record: &Record, is_folder: bool, limits: &ArchiveLimits) -> Result<(), EntryProblem> {
    let (compressed, size) = (record.entry.compressed_size(), record.entry.size());
    if record.entry.flags().as_u16() & ENCRYPTED != 0 {
        return Err(EntryProblem::Encrypted);
    }
    if is_folder && size > 0 {
        return Err(EntryProblem::FolderWithData(size));
    }
    match record.entry.compression() {
        CompressionMethod::Stored if compressed != size => {
            return Err(EntryProblem::WrongSize { found: compressed, declared: size });
        }
        CompressionMethod::Stored | CompressionMethod::Deflated => {}
        #[expect(deprecated, reason = "the number is for a message")]
        other => return Err(EntryProblem::Compression(other.to_u16())),
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

/// Maximum number of FMUs, and of parameter sets, in the message about such an archive.
const MOST_NAMED: usize = 8;

/// Checks that the model description is a file at the root. If it is in a subfolder, the message reports
/// that.
fn check_root(path: &Path, listed: &[Record]) -> Result<()> {
    if listed.iter().any(|entry| entry.name == MODEL_DESCRIPTION && !entry.is_folder) {
        return Ok(());
    }
    if listed.iter().any(|entry| entry.name == MODEL_DESCRIPTION) {
        let hint = Some(", because the entry of this name is a folder".to_owned());
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
            ", because it is an SSP archive (a system of models). Unzip it and use one of its \
             FMUs{fmus}{sets}"
        );
        return Err(FmiError::NoModelDescription { path: path.to_owned(), hint: Some(hint) });
    }
    let elsewhere = listed.iter().map(|entry| entry.name.as_str()).find(|name| {
        let file = name.rsplit('/').next().unwrap_or(name);
        file.eq_ignore_ascii_case(MODEL_DESCRIPTION) && name.matches('/').count() <= 1
    });
    let hint = elsewhere.map(|name| match name.split_once('/') {
        Some((folder, _)) => {
            format!(", but contains \"{name}\". Pack the contents of \"{folder}\", not the folder itself")
        }
        None => format!(", but contains \"{name}\"; names are case-sensitive"),
    });
    Err(FmiError::NoModelDescription { path: path.to_owned(), hint })
}

/// Finds overlapping ranges in a list sorted by start. Entries without data may not share headers either.
fn find_overlap<'a>(ranges: &[ByteRange], records: &'a [Record]) -> Option<(&'a Record, EntryProblem)> {
    let record = |range: &ByteRange| &records[range.position];
    for pair in ranges.windows(2) {
        let (start, end) = (pair[1].start, pair[0].end.min(pair[1].end));
        if pair[0].end > start {
            let other = record(&pair[0]).name.clone();
            return Some((record(&pair[1]), EntryProblem::Overlap { start, end, other }));
        }
    }
    let start = records.first()?.entry.central_header_start();
    let last = ranges.last().filter(|last| last.end > start)?;
    let other = "the directory of the archive".to_owned();
    Some((record(last), EntryProblem::Overlap { start, end: last.end, other }))
}
