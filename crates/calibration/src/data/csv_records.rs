//! Records of a CSV text: encoding, delimiter, cells, quotes and comments.

use std::borrow::Cow;

/// Maximum number of columns. Each requires some 200 bytes in addition to its values.
pub(super) const MOST_COLUMNS: usize = 1 << 16;

/// Records of a table from a given line. Blank lines and comments are skipped.
#[derive(Clone)]
pub(super) struct Records<'t> {
    text: &'t str,
    /// Position of the next record.
    at: usize,
    /// Line of the next record, counted from 1.
    line: usize,
    delimiter: u8,
}

impl<'t> Records<'t> {
    /// Splits a text into records. Returns the records and the delimiter of their cells.
    pub(super) fn new(text: &'t str) -> (Self, u8) {
        let mut records = Self { text, at: 0, line: 1, delimiter: b',' };
        records.skip();
        let header = records.rest().lines().next().unwrap_or_default();
        match header.trim_end().strip_prefix("sep=").map(str::as_bytes) {
            Some([delimiter]) if records.line == 1 => {
                records.at += header.len();
                records.delimiter = *delimiter;
            }
            _ => records.delimiter = delimiter(header),
        }
        let delimiter = records.delimiter;
        (records, delimiter)
    }

    pub(super) fn rest(&self) -> &'t str {
        &self.text[self.at..]
    }

    /// Returns the number of remaining lines.
    pub(super) fn n_lines(&self) -> usize {
        self.rest().bytes().filter(|byte| matches!(byte, b'\n' | b'\r')).count() + 1
    }

    /// Skips blank lines and comments.
    fn skip(&mut self) {
        let bytes = self.text.as_bytes();
        loop {
            let blank = bytes[self.at..].iter().take_while(|byte| matches!(byte, b' ' | b'\t')).count();
            let next = self.at + blank;
            match bytes.get(next) {
                Some(b'#') => {
                    let is_end = |byte: &u8| matches!(byte, b'\n' | b'\r');
                    let end = bytes[next..].iter().position(is_end);
                    self.at = end.map_or(bytes.len(), |end| next + end);
                }
                Some(b'\n' | b'\r') => self.at = next,
                None => self.at = next,
                Some(_) => return,
            }
            if self.at == bytes.len() {
                return;
            }
            self.end_line();
        }
    }

    /// Skips the end of a line.
    fn end_line(&mut self) {
        let rest = &self.text.as_bytes()[self.at..];
        self.at += if rest.starts_with(b"\r\n") { 2 } else { usize::from(!rest.is_empty()) };
        self.line += 1;
    }

    /// Reads the cells of the next record, without surrounding spaces, up to the last non-empty cell. If
    /// there are more than [`MOST_COLUMNS`], one additional cell is kept. Returns the line where the record
    /// begins and the number of its cells, or `None` at the end.
    pub(super) fn next(&mut self, cells: &mut Vec<Cow<'t, str>>) -> Option<(usize, usize)> {
        cells.clear();
        self.skip();
        let (bytes, line, mut n_cells) = (self.text.as_bytes(), self.line, 0);
        if self.at == bytes.len() {
            return None;
        }
        loop {
            let begin = self.at;
            let cell = match bytes.get(begin) {
                Some(b'"') => self.quoted(),
                _ => {
                    self.at += self.to_end_of_cell();
                    Cow::Borrowed(trimmed(&self.text[begin..self.at]))
                }
            };
            if !cell.is_empty() && cells.len() <= MOST_COLUMNS {
                cells.resize(n_cells.min(MOST_COLUMNS), Cow::Borrowed(""));
                cells.push(cell);
            }
            n_cells += 1;
            match bytes.get(self.at) {
                Some(byte) if *byte == self.delimiter => self.at += 1,
                Some(_) => {
                    self.end_line();
                    return Some((line, n_cells));
                }
                None => return Some((line, n_cells)),
            }
        }
    }

    /// Returns the number of bytes until the next delimiter or line end.
    fn to_end_of_cell(&self) -> usize {
        let rest = &self.text.as_bytes()[self.at..];
        let is_end = |byte: &u8| *byte == self.delimiter || matches!(byte, b'\n' | b'\r');
        rest.iter().position(is_end).unwrap_or(rest.len())
    }

    /// Reads a quoted cell, in which two quotes denote one, and the text after it. The cell may contain line
    /// ends.
    fn quoted(&mut self) -> Cow<'t, str> {
        let mut cell = String::new();
        loop {
            self.at += 1;
            let begin = self.at;
            let length = self.rest().find('"').unwrap_or(self.rest().len());
            self.at += length;
            let part = &self.text[begin..self.at];
            self.line += part.bytes().filter(|byte| *byte == b'\n').count();
            cell.push_str(part);
            self.at = (self.at + 1).min(self.text.len());
            if !self.rest().starts_with('"') {
                break;
            }
            cell.push('"');
        }
        let begin = self.at;
        self.at += self.to_end_of_cell();
        cell.push_str(&self.text[begin..self.at]);
        Cow::Owned(trimmed(&cell).to_owned())
    }
}

/// Returns the cell without surrounding white space.
fn trimmed(cell: &str) -> &str {
    let is_plain = |byte: Option<&u8>| byte.is_none_or(|byte| (b'!'..=b'~').contains(byte));
    let bytes = cell.as_bytes();
    if is_plain(bytes.first()) && is_plain(bytes.last()) { cell } else { cell.trim() }
}

/// Decodes UTF-8, UTF-16 with a byte order mark, or otherwise Windows-1252, which includes Latin 1.
/// Spreadsheets write these encodings.
pub(super) fn decode(text: &[u8]) -> Cow<'_, str> {
    let (encoding, skip) = encoding_rs::Encoding::for_bom(text).unwrap_or_else(|| {
        let utf8 = std::str::from_utf8(text).is_ok();
        (if utf8 { encoding_rs::UTF_8 } else { encoding_rs::WINDOWS_1252 }, 0)
    });
    encoding.decode_without_bom_handling(&text[skip..]).0
}

/// Returns the most frequent of comma, semicolon and tab in the header, outside of quotes.
fn delimiter(header: &str) -> u8 {
    let mut quoted = false;
    let mut counts = [(b',', 0), (b';', 0), (b'\t', 0)];
    for byte in header.bytes() {
        quoted ^= byte == b'"';
        for (_, count) in counts.iter_mut().filter(|c| c.0 == byte && !quoted) {
            *count += 1;
        }
    }
    // If counts are equal, the first delimiter is used.
    counts.into_iter().rev().max_by_key(|c| c.1).map_or(b',', |c| c.0)
}
