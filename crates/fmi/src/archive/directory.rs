//! The directory of a zip archive, record by record as it stands in the file (PKWARE APPNOTE 6.3.10).
//!
//! Read here rather than by the `zip` library because that one keeps entries by name, so that duplicates
//! vanish before they can be refused, and reads the whole directory before its length can be judged.

use std::io::{self, Read, Seek, SeekFrom};

/// Smallest record at the end of an archive, and the longest with its comment.
const END_BYTES: u64 = 22;
const LONGEST_END: u64 = END_BYTES + u16::MAX as u64;
const LOCATOR_BYTES: u64 = 20;
/// Central header without its variable parts.
const HEADER_BYTES: u64 = 46;

/// Where the directory lies and how many entries it claims to have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Directory {
    pub(super) start: u64,
    pub(super) end: u64,
    pub(super) n_entries: u64,
}

/// One central header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Record {
    /// Name as it is to be understood; of an entry that is listed without the slash at the end of folders.
    /// Empty for the folder of the archive itself (`./`).
    pub(super) name: String,
    pub(super) is_folder: bool,
    /// Index of an earlier entry with this name, size and checksum: the content has to be the same.
    pub(super) repeats: Option<usize>,
    /// Name as the local header repeats it, where its bytes are others.
    pub(super) raw_name: Option<Vec<u8>>,
    pub(super) flags: u16,
    pub(super) method: u16,
    pub(super) crc32: u32,
    pub(super) compressed_size: u64,
    pub(super) size: u64,
    /// File type and permissions as Unix has them, 0 where unknown.
    pub(super) unix_mode: u32,
    /// Position of the local header.
    pub(super) header_start: u64,
}

/// Error for a directory that cannot be read as one.
fn damaged<T>(reason: impl Into<String>) -> io::Result<T> {
    Err(io::Error::new(io::ErrorKind::InvalidData, reason.into()))
}

impl Directory {
    /// Finds the directory by the record at the end of the archive.
    pub(super) fn find(archive: &mut (impl Read + Seek)) -> io::Result<Directory> {
        let length = archive.seek(SeekFrom::End(0))?;
        let ends_plainly = |tail: &[u8]| tail.starts_with(b"PK\x05\x06") && Fields(tail).half(20) == 0;
        let mut tail_start = length.saturating_sub(END_BYTES);
        let mut tail = read_at(archive, tail_start, length - tail_start)?;
        if !ends_plainly(&tail) {
            tail_start = length.saturating_sub(LONGEST_END);
            tail = read_at(archive, tail_start, length - tail_start)?;
        }
        let Some(at) = find_end(&tail) else {
            return damaged(if starts_as_zip(archive)? {
                "it is cut off: the directory at the end of the archive is missing"
            } else {
                "it is not a zip archive"
            });
        };
        let end_start = tail_start + at as u64;
        let record = Fields(&tail[at..]);
        let classic = Directory {
            n_entries: u64::from(record.half(10)),
            start: u64::from(record.word(16)),
            end: u64::from(record.word(16)) + u64::from(record.word(12)),
        };
        let (directory, limit) = match zip64_end(archive, end_start)? {
            Some((extended, extended_start)) => (extended, extended_start),
            None if record.half(4) != 0 || record.half(6) != 0 => {
                return damaged("it is one volume of several");
            }
            None => (classic, end_start),
        };
        if directory.start > directory.end || directory.end > limit {
            return damaged(format!(
                "its directory is said to take the bytes {}..{}, of {limit}",
                directory.start, directory.end
            ));
        }
        let room = (directory.end - directory.start) / HEADER_BYTES;
        if directory.n_entries > room {
            return damaged(format!(
                "its directory has room for {room} entries, not {}",
                directory.n_entries
            ));
        }
        Ok(directory)
    }

    /// Reads all records. The number of entries should have been judged before.
    pub(super) fn read(&self, archive: &mut (impl Read + Seek)) -> io::Result<Vec<Record>> {
        archive.seek(SeekFrom::Start(self.start))?;
        let mut archive = archive.take(self.end - self.start);
        let mut records = Vec::with_capacity(self.n_entries as usize);
        let mut texts = Vec::new();
        for _ in 0..self.n_entries {
            records.push(Record::read(&mut archive, &mut texts)?);
        }
        // A hidden record behind the last one would be seen by tools that do not count.
        let mut rest = [0; 4];
        match archive.read_exact(&mut rest) {
            Ok(()) if &rest == b"PK\x01\x02" => {
                damaged(format!("its directory has more than the {} entries it counts", self.n_entries))
            }
            _ => Ok(records),
        }
    }
}

/// Position of the record that ends the archive: the last one whose comment ends with the archive, else the
/// last one whose comment fits.
fn find_end(tail: &[u8]) -> Option<usize> {
    let last = tail.len().checked_sub(END_BYTES as usize)?;
    let mut fits = None;
    for at in (0..=last).rev() {
        if !tail[at..].starts_with(b"PK\x05\x06") {
            continue;
        }
        let end = at + END_BYTES as usize + usize::from(Fields(&tail[at..]).half(20));
        if end == tail.len() {
            return Some(at);
        }
        if end < tail.len() && fits.is_none() {
            fits = Some(at);
        }
    }
    fits
}

fn starts_as_zip(archive: &mut (impl Read + Seek)) -> io::Result<bool> {
    archive.rewind()?;
    let mut start = Vec::new();
    archive.take(4).read_to_end(&mut start)?;
    Ok(start == b"PK\x03\x04")
}

/// The 64-bit variant of the end record and its position, if its locator stands before the end record.
fn zip64_end(archive: &mut (impl Read + Seek), end_start: u64) -> io::Result<Option<(Directory, u64)>> {
    let Some(locator_start) = end_start.checked_sub(LOCATOR_BYTES) else { return Ok(None) };
    let locator = read_at(archive, locator_start, LOCATOR_BYTES)?;
    if !locator.starts_with(b"PK\x06\x07") {
        return Ok(None);
    }
    let start = Fields(&locator).long(8);
    if start > locator_start.saturating_sub(56) {
        return damaged(format!("its 64-bit end record is said to lie at byte {start}"));
    }
    let bytes = read_at(archive, start, 56)?;
    let record = Fields(&bytes);
    if !bytes.starts_with(b"PK\x06\x06") {
        return damaged(format!("there is no 64-bit end record at byte {start}"));
    }
    if record.word(16) != 0 || record.word(20) != 0 {
        return damaged("it is one volume of several");
    }
    let Some(end) = record.long(48).checked_add(record.long(40)) else {
        return damaged(format!("its directory is said to have {} bytes", record.long(40)));
    };
    Ok(Some((Directory { start: record.long(48), end, n_entries: record.long(32) }, start)))
}

impl Record {
    /// Name without the slash of folders, size, compressed size and checksum.
    pub(super) fn content(&self) -> (&str, u64, u64, u32) {
        let name = self.name.strip_suffix('/').unwrap_or(&self.name);
        (name, self.size, self.compressed_size, self.crc32)
    }

    /// Reads the next record; `texts` is a buffer.
    fn read(source: &mut impl Read, texts: &mut Vec<u8>) -> io::Result<Record> {
        let mut bytes = [0; HEADER_BYTES as usize];
        source.read_exact(&mut bytes)?;
        if !bytes.starts_with(b"PK\x01\x02") {
            return damaged("its directory holds something that is no entry");
        }
        let fields = Fields(&bytes);
        // Name, extra fields, comment.
        let [name, extra, comment] = [28, 30, 32].map(|at| usize::from(fields.half(at)));
        texts.resize(name + extra + comment, 0);
        source.read_exact(texts)?;
        let (raw_name, extra) = texts[..name + extra].split_at(name);
        let name = normalized(&decode_name(raw_name, extra));
        let mut record = Record {
            raw_name: (name.as_bytes() != raw_name).then(|| raw_name.to_owned()),
            name,
            is_folder: false,
            repeats: None,
            flags: fields.half(8),
            method: fields.half(10),
            crc32: fields.word(16),
            compressed_size: u64::from(fields.word(20)),
            size: u64::from(fields.word(24)),
            unix_mode: fields.word(38) >> 16,
            header_start: u64::from(fields.word(42)),
        };
        record.widen(extra);
        Ok(record)
    }

    /// Takes the sizes and the position that do not fit 32 bits from the extra field made for them, where
    /// each stands only if its 32-bit place is filled with ones (APPNOTE 4.5.3).
    fn widen(&mut self, extra: &[u8]) {
        let Some(mut data) = extra_field(extra, 0x0001) else { return };
        for value in [&mut self.size, &mut self.compressed_size, &mut self.header_start] {
            if *value == u64::from(u32::MAX)
                && let Some((first, rest)) = data.split_first_chunk()
            {
                *value = u64::from_le_bytes(*first);
                data = rest;
            }
        }
    }
}

/// Contents of the first extra field with this number; what is malformed counts as absent.
fn extra_field(mut extra: &[u8], number: u16) -> Option<&[u8]> {
    while let Some(([a, b, c, d], rest)) = extra.split_first_chunk() {
        let length = usize::from(u16::from_le_bytes([*c, *d]));
        if u16::from_le_bytes([*a, *b]) == number {
            return rest.get(..length);
        }
        extra = rest.get(length..)?;
    }
    None
}

/// The name as Info-ZIP understands it: backslashes, which some tools of Windows write, are slashes;
/// components that are empty or `.` lead nowhere and are left out. What leads out of the archive stays as it
/// is.
fn normalized(name: &str) -> String {
    let slashes = name.replace('\\', "/");
    let kept = |component: &&str| !matches!(*component, "" | ".");
    let mut path = slashes.split('/').filter(kept).collect::<Vec<_>>().join("/");
    if slashes.starts_with('/') {
        path.insert(0, '/');
    }
    let last = slashes.rsplit('/').next().unwrap_or_default();
    if !kept(&last) && !path.is_empty() && !path.ends_with('/') {
        path.push('/');
    }
    path
}

/// The text of the name: from Info-ZIP's Unicode field if there is a valid one (APPNOTE 4.6.9), else as UTF-8
/// (declared or not), else in the alphabet of the first IBM PC, as the format prescribes.
fn decode_name(raw: &[u8], extra: &[u8]) -> String {
    if let Some([1, c0, c1, c2, c3, unicode @ ..]) = extra_field(extra, 0x7075)
        && u32::from_le_bytes([*c0, *c1, *c2, *c3]) == crc32fast::hash(raw)
        && let Ok(name) = std::str::from_utf8(unicode)
    {
        return name.to_owned();
    }
    match std::str::from_utf8(raw) {
        Ok(name) => name.to_owned(),
        Err(_) => raw.iter().map(|&byte| code_page_437(byte)).collect(),
    }
}

fn code_page_437(byte: u8) -> char {
    const UPPER: &str = "\
        ÇüéâäàåçêëèïîìÄÅÉæÆôöòûùÿÖÜ¢£¥₧ƒáíóúñÑªº¿⌐¬½¼¡«»░▒▓│┤╡╢╖╕╣║╗╝╜╛┐\
        └┴┬├─┼╞╟╚╔╩╦╠═╬╧╨╤╥╙╘╒╓╫╪┘┌█▄▌▐▀αßΓπΣσµτΦΘΩδ∞φε∩≡±≥≤⌠⌡÷≈°∙·√ⁿ²■\u{a0}";
    match byte.checked_sub(128) {
        None => char::from(byte),
        Some(upper) => UPPER.chars().nth(usize::from(upper)).unwrap_or(char::REPLACEMENT_CHARACTER),
    }
}

/// Little-endian fields of a record; what lies behind its end reads as 0.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&self, at: usize) -> [u8; N] {
        self.0.get(at..).and_then(|rest| rest.first_chunk().copied()).unwrap_or([0; N])
    }

    pub(super) fn half(&self, at: usize) -> u16 {
        u16::from_le_bytes(self.take(at))
    }

    pub(super) fn word(&self, at: usize) -> u32 {
        u32::from_le_bytes(self.take(at))
    }

    fn long(&self, at: usize) -> u64 {
        u64::from_le_bytes(self.take(at))
    }
}

fn read_at(archive: &mut (impl Read + Seek), start: u64, length: u64) -> io::Result<Vec<u8>> {
    archive.seek(SeekFrom::Start(start))?;
    let mut bytes = vec![0; length as usize];
    archive.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn end_record(n_entries: u16, size: u32, start: u32, comment: &[u8]) -> Vec<u8> {
        let mut bytes = b"PK\x05\x06\0\0\0\0".to_vec();
        bytes.extend(n_entries.to_le_bytes());
        bytes.extend(n_entries.to_le_bytes());
        bytes.extend(size.to_le_bytes());
        bytes.extend(start.to_le_bytes());
        bytes.extend((comment.len() as u16).to_le_bytes());
        bytes.extend(comment);
        bytes
    }

    fn reason(bytes: &[u8]) -> String {
        Directory::find(&mut Cursor::new(bytes)).unwrap_err().to_string()
    }

    #[test]
    fn the_record_that_ends_with_the_archive_is_the_one() {
        let fake = end_record(9, 0, 0, b"");
        let mut comment = b"a comment that holds ".to_vec();
        comment.extend(&fake[..20]);
        let bytes = end_record(0, 0, 0, &comment);
        assert_eq!(
            Directory::find(&mut Cursor::new(bytes)).unwrap(),
            Directory { start: 0, end: 0, n_entries: 0 }
        );
        let mut garbage = end_record(0, 0, 0, b"");
        garbage.extend(b"bytes behind the end");
        assert!(Directory::find(&mut Cursor::new(garbage)).is_ok());
    }

    #[test]
    fn what_is_wrong_is_said() {
        assert!(reason(b"").contains("not a zip"));
        assert!(reason(b"PK\x03\x04 and then nothing").contains("cut off"));
        assert!(reason(&end_record(0, 10, 0, b"")).contains("0..10, of 0"));
        let mut many = vec![0; 100];
        many.extend(end_record(3, 100, 0, b""));
        assert!(reason(&many).contains("room for 2 entries, not 3"));
    }

    #[test]
    fn names_are_decoded_by_field_then_utf8_then_code_page() {
        assert_eq!(decode_name("\u{e4}".as_bytes(), b""), "\u{e4}");
        assert_eq!(decode_name(b"\x84.txt", b""), "\u{e4}.txt");
        assert_eq!(decode_name(b"\xff", b""), "\u{a0}");
        let raw = b"\x84";
        let mut extra = b"\x99\x99\x02\x00ab\x75\x70\x07\x00\x01".to_vec();
        extra.extend(crc32fast::hash(raw).to_le_bytes());
        extra.extend("\u{f6}".as_bytes());
        assert_eq!(decode_name(raw, &extra), "\u{f6}");
        let last = extra.len() - 3;
        extra[last] ^= 1; // the field belongs to another name
        assert_eq!(decode_name(raw, &extra), "\u{e4}");
    }

    #[test]
    fn names_are_normalized_as_info_zip_does() {
        for (name, expected) in [
            ("./modelDescription.xml", "modelDescription.xml"),
            ("binaries\\linux64\\m.so", "binaries/linux64/m.so"),
            (".\\resources\\", "resources/"),
            ("./", ""),
            (".", ""),
            ("a//./b/", "a/b/"),
            ("a/.", "a/"),
            ("\\a", "/a"),
            ("\\\\host\\a", "/host/a"),
            ("/", "/"),
            ("..\\a", "../a"),
            ("a\\..\\..\\b", "a/../../b"),
            ("C:\\a", "C:/a"),
            ("", ""),
        ] {
            assert_eq!(normalized(name), expected, "{name:?}");
        }
    }

    #[test]
    fn the_code_page_is_complete() {
        let all: String = (128..=255).map(code_page_437).collect();
        assert!(!all.contains(char::REPLACEMENT_CHARACTER));
        assert_eq!(code_page_437(b'a'), 'a');
        assert_eq!(code_page_437(0xe1), '\u{df}');
    }

    #[test]
    fn sizes_beyond_32_bits_stand_in_the_extra_field() {
        let mut header = b"PK\x01\x02".to_vec();
        header.resize(HEADER_BYTES as usize, 0);
        header[20..28].fill(0xff);
        header[28] = 1;
        header[30] = 20;
        header.push(b'a');
        header.extend([1, 0, 16, 0]);
        header.extend(5_000_000_000_u64.to_le_bytes());
        header.extend(6_000_000_000_u64.to_le_bytes());
        let record = Record::read(&mut &header[..], &mut Vec::new()).unwrap();
        assert_eq!(
            (record.size, record.compressed_size, record.header_start),
            (5_000_000_000, 6_000_000_000, 0)
        );
    }
}
