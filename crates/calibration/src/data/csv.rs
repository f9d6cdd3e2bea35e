//! CSV files as tables, as spreadsheets and data loggers write them.

use super::dates::date_seconds;
use super::table::{Column, Data, mixed_decimal_signs};
use super::time_column::{PairUnit, TimeColumn, time_unit};
use super::units::Unit;
use crate::error::CalibrationError;
use std::borrow::Cow;
use std::path::Path;

/// Spellings of a missing value in a CSV file; compared without regard to case.
const MISSING: [&str; 5] = ["", "nan", "na", "n/a", "null"];

impl Data {
    /// Reads a CSV file with a header line, which a line of units may follow. The delimiter is the one of comma, semicolon and tab that stands most
    /// often in the header (a first line `sep=;`, as spreadsheets write it, names it); one more at the end of each
    /// row is no column. Where it is no comma, numbers may have decimal commas, all of them: where some have commas
    /// and others points, one of the two separates thousands. The times are those of the column `time` (in any case),
    /// in s or in the unit that follows in brackets or parentheses: s, ms, us, ns, min, h, d (`time [ms]`); dates (of ISO 8601, or as
    /// `31.05.2024 13:45:10`) and times of day become s since the first row; `00:01` wants a name such as `time [mm:ss]` or `time [hh:mm]`
    /// where it can be either. Empty
    /// cells, `NaN` and `NA` are missing values. Columns of text are kept aside: only using one is an error. Lines that begin with
    /// `#` are comments.
    ///
    /// # Errors
    /// The file cannot be read, has no column of times (the message lists those there are), no rows, rows of different
    /// length, or times that are missing or not ascending; each error names the line.
    pub fn from_csv(path: impl AsRef<Path>) -> Result<Self, CalibrationError> {
        Self::read_csv(path.as_ref(), None)
    }

    /// As [`from_csv`](Self::from_csv), with the times in the column `time`, whatever it is called.
    ///
    /// # Errors
    /// As [`from_csv`](Self::from_csv).
    pub fn from_csv_with_time(path: impl AsRef<Path>, time: &str) -> Result<Self, CalibrationError> {
        Self::read_csv(path.as_ref(), Some(time))
    }

    fn read_csv(path: &Path, time: Option<&str>) -> Result<Self, CalibrationError> {
        let text = base::files::read_regular(path)
            .map_err(|source| CalibrationError::DataFile { path: path.to_owned(), source })?;
        Self::from_csv_text(&text, &path.display().to_string(), time)
    }

    /// As [`from_csv`](Self::from_csv), from the text itself; `source` names it in errors, `time` the column of times.
    ///
    /// # Errors
    /// As [`from_csv`](Self::from_csv).
    pub fn from_csv_text(text: &[u8], source: &str, time: Option<&str>) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: source.to_owned(), message };
        if text.starts_with(b"PK\x03\x04") {
            return Err(bad("this is a zip archive (an FMU, a workbook), no CSV file".to_owned()));
        }
        let text = decode(text);
        // Comments and blank lines go first, so that the reader below sees a table and each row knows its line.
        let mut numbers = Vec::new();
        let mut table = String::with_capacity(text.len());
        let mut named_delimiter = None;
        for (number, line) in text.lines().enumerate() {
            if let (0, Some([delimiter])) = (number, line.trim_end().strip_prefix("sep=").map(str::as_bytes))
            {
                named_delimiter = Some(*delimiter);
            } else if !line.trim().is_empty() && !line.trim_start().starts_with('#') {
                numbers.push(number + 1);
                table.push_str(line);
                table.push('\n');
            }
        }
        let delimiter =
            named_delimiter.unwrap_or_else(|| delimiter(table.lines().next().unwrap_or_default()));
        let mut reader = csv::ReaderBuilder::new()
            .delimiter(delimiter)
            .flexible(true)
            .trim(csv::Trim::All)
            .from_reader(table.as_bytes());
        let line_of = |position: Option<&csv::Position>| {
            let index = position.map_or(0, |p| p.line() as usize).saturating_sub(1);
            numbers.get(index).copied().unwrap_or(0)
        };
        let names: Vec<String> =
            reader.headers().map_err(|e| bad(e.to_string()))?.iter().map(str::to_owned).collect();
        if !names.is_empty() && names.iter().all(|n| number(n, delimiter).is_some()) {
            return Err(bad(format!("there is no header: line {} holds numbers only", numbers[0])));
        }
        if names.is_empty() {
            return Err(bad("there are no rows".to_owned()));
        }
        let mut time_column =
            TimeColumn::find(names.iter().map(String::as_str), time).map_err(|message| {
                let hint = "; there is one column only: columns are separated by commas, semicolons or tabs";
                bad(if names.len() == 1 { message + hint } else { message })
            })?;
        let mut columns: Vec<Column> = names.iter().map(|n| Column::new(n.clone(), Vec::new())).collect();
        let (mut lines, mut dates, mut has_units) = (Vec::new(), Vec::new(), false);
        for record in reader.records() {
            let record = record.map_err(|e| bad(e.to_string()))?;
            let line = line_of(record.position());
            // A delimiter at the end of a row or of the header makes an empty cell that belongs to no column.
            let (len, expected) = (record.len(), names.len());
            let is_whole = record.iter().skip(expected).chain(names.iter().skip(len).map(String::as_str));
            if !is_whole.clone().all(str::is_empty) {
                let hint = match delimiter {
                    b',' if len == 2 * expected => {
                        "; numbers with decimal commas need semicolons or tabs between the columns"
                    }
                    _ => "",
                };
                return Err(bad(format!("line {line} has {len} cells, the header has {expected}{hint}")));
            }
            if lines.is_empty()
                && !has_units
                && let Some(units) = line_of_units(&record, time_column.index)
            {
                has_units = true;
                for (column, unit) in columns.iter_mut().zip(units) {
                    column.unit = unit;
                }
                let (name, unit) = (&names[time_column.index], &columns[time_column.index].unit);
                if let Some(unit) = unit {
                    time_column.unit = time_unit(name, unit).map_err(bad)?;
                }
                continue;
            }
            lines.push(line);
            for (column, cell) in columns.iter_mut().zip(record.iter().chain(std::iter::repeat(""))) {
                column.push(cell, line, delimiter);
            }
            let cell = record.get(time_column.index).unwrap_or_default();
            if !cell.is_empty() && number(cell, delimiter).is_none() {
                dates.push(cell.to_owned());
            }
        }
        if lines.is_empty() {
            return Err(bad("there are no rows".to_owned()));
        }
        if let Some(message) = mixed_decimal_signs(&columns, &columns[time_column.index]) {
            return Err(bad(message));
        }
        let mut time = columns.remove(time_column.index);
        if let Some((line, text)) = &time.text {
            if dates.len() != lines.len() {
                return Err(bad(format!(
                    "time '{text}' in line {line} is not a number, as those of other lines are, or there is none in them"
                )));
            }
            let stated = time.unit.as_deref().and_then(PairUnit::named);
            let pair = stated.or_else(|| PairUnit::of_column(&time.name));
            let seconds = date_seconds(&dates, pair);
            time.values = seconds.map_err(|(row, why)| bad(format!("time in line {}: {why}", lines[row])))?;
            time_column.unit = (1.0, 1.0);
        }
        time.values.iter_mut().for_each(|t| *t = time_column.seconds(*t));
        Self::new(source.to_owned(), time.name, time.values, columns, |row| format!("line {}", lines[row]))
    }
}

/// UTF-8, UTF-16 with a byte order mark, else Windows-1252 (which reads Latin 1 too): what spreadsheets write.
fn decode(text: &[u8]) -> Cow<'_, str> {
    let (encoding, skip) = encoding_rs::Encoding::for_bom(text).unwrap_or_else(|| {
        let utf8 = std::str::from_utf8(text).is_ok();
        (if utf8 { encoding_rs::UTF_8 } else { encoding_rs::WINDOWS_1252 }, 0)
    });
    encoding.decode_without_bom_handling(&text[skip..]).0
}

/// The one of comma, semicolon and tab that stands most often in the header, outside of quotes.
fn delimiter(header: &str) -> u8 {
    let mut quoted = false;
    let mut counts = [(b',', 0), (b';', 0), (b'\t', 0)];
    for byte in header.bytes() {
        quoted ^= byte == b'"';
        for (_, count) in counts.iter_mut().filter(|c| c.0 == byte && !quoted) {
            *count += 1;
        }
    }
    // Of equals the first.
    counts.into_iter().rev().max_by_key(|c| c.1).map_or(b',', |c| c.0)
}

/// The units of the columns, where the first line below the header has no values: the cell of the times is a unit of time or empty, and
/// no other is a number, but for the unit 1.
fn line_of_units(record: &csv::StringRecord, time: usize) -> Option<Vec<Option<String>>> {
    let bare = |cell: &str| {
        let inner = |(open, close)| cell.strip_prefix(open)?.strip_suffix(close).map(str::trim);
        [('[', ']'), ('(', ')')].into_iter().find_map(inner).unwrap_or(cell).to_owned()
    };
    let is_unit = |cell: &str| Unit::parse(cell).is_ok();
    let cells: Vec<String> = record.iter().map(bare).collect();
    let is_of_time = match cells.get(time)?.as_str() {
        "" | "-" => cells.iter().any(|cell| !matches!(&cell[..], "1" | "-") && is_unit(cell)),
        cell => {
            PairUnit::named(cell).is_some()
                || Unit::parse(cell).is_ok_and(|unit| unit.time_factor().is_some())
        }
    };
    let is_number = |cell: &String| cell != "1" && number(cell, b';').is_some_and(|value| !value.is_nan());
    let stated = |cell: String| (!cell.is_empty()).then_some(cell);
    (is_of_time && !cells.iter().any(is_number)).then(|| cells.into_iter().map(stated).collect())
}

/// The number in a cell, NaN for a missing one, `None` for a text.
fn number(cell: &str, delimiter: u8) -> Option<f64> {
    if MISSING.iter().any(|m| cell.eq_ignore_ascii_case(m)) {
        return Some(f64::NAN);
    }
    // A decimal comma is safe to read where the comma does not separate.
    let with_comma = || (delimiter != b',').then(|| cell.replacen(',', ".", 1).parse().ok()).flatten();
    cell.parse().ok().or_else(with_comma)
}

impl Column {
    fn push(&mut self, cell: &str, line: usize, delimiter: u8) {
        let number = number(cell, delimiter);
        let first = match number {
            None => &mut self.text,
            Some(_) if cell.contains(',') => &mut self.comma,
            _ => &mut self.point,
        };
        if first.is_none() && (number.is_none() || cell.contains([',', '.'])) {
            *first = Some((line, cell.to_owned()));
        }
        self.values.push(number.unwrap_or(f64::NAN));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(text: &str) -> Result<Data, CalibrationError> {
        Data::from_csv_text(text.as_bytes(), "test.csv", None)
    }

    #[test]
    fn reads_irregular_times_missing_values_and_text_aside() {
        let d = csv("time, a ,\"b,c\",note\n0,1,2,ok\n0.5,,4,bad\n0.7,NaN,1e-3,\n").unwrap();
        assert_eq!(d.time(), [0.0, 0.5, 0.7]);
        assert_eq!(d.names().collect::<Vec<_>>(), ["a", "b,c", "note"]);
        assert!(d.column("a").unwrap()[1].is_nan() && d.column("a").unwrap()[2].is_nan());
        assert_eq!(d.column("b,c").unwrap(), [2.0, 4.0, 1e-3]);
        let e = d.column("note").unwrap_err().to_string();
        assert!(e.contains("test.csv") && e.contains("'ok'") && e.contains("line 2"), "{e}");
        let e = d.column("d").unwrap_err().to_string();
        assert!(e.contains("'d'") && e.contains("'a', 'b,c', 'note'"), "{e}");
    }

    #[test]
    fn time_may_stand_anywhere_and_semicolons_allow_decimal_commas() {
        let d = csv("y;Time\n1,5;0\n2;0,25\n").unwrap();
        assert_eq!(d.time(), [0.0, 0.25]);
        assert_eq!(d.column("y").unwrap(), [1.5, 2.0]);
        let d = csv("\u{feff}time [ms]\ty\n# a comment\n0\t1\n1000\t2\n").unwrap();
        assert_eq!(d.time(), [0.0, 1.0]);
        let d = csv("sep=;\ny;time (min)\n1,5;0\n2;0,5\n").unwrap();
        assert_eq!((d.time(), d.column("y").unwrap()), (&[0.0, 30.0][..], &[1.5, 2.0][..]));
        let named = |time| Data::from_csv_text(b"k,t,y\n7,0,1\n8,1,2\n", "test.csv", time);
        assert_eq!(named(Some("t")).unwrap().time(), [0.0, 1.0]);
        let e = named(None).unwrap_err().to_string();
        assert!(e.contains("test.csv: there is no column 'time'; there are: 'k', 't', 'y'"), "{e}");
        let d = csv("# rig A, run 3\n\ntime;\"a,b,c\";y\n0;1;2\n").unwrap();
        assert_eq!(d.names().collect::<Vec<_>>(), ["a,b,c", "y"]);
    }

    #[test]
    fn commas_and_points_in_one_file_are_refused_where_they_are_used() {
        for (text, column) in [
            ("time;y\n0;1,234\n1;2.345\n", "y"),
            ("time;y;z\n0;1,234;1\n1;2,5;2.5\n", "y"),
            ("time;y;z\n0;1,234;1\n1;2,5;2.5\n", "z"),
        ] {
            let e = csv(text).unwrap().column(column).unwrap_err().to_string();
            assert!(e.contains("'1,234' in column 'y', line 2, has a comma and '2."), "{e}");
        }
        let e = csv("time;y\n0.5;1,234\n1;2\n").unwrap_err().to_string();
        assert!(e.contains("'0.5' in column 'time', line 2, a point"), "{e}");
        // Whole numbers, texts and columns without either have no sign.
        let d = csv("time;y;n;note\n0;1,5;7;v1.2\n1;2;8;a.b\n").unwrap();
        assert_eq!((d.column("y").unwrap(), d.column("n").unwrap()), (&[1.5, 2.0][..], &[7.0, 8.0][..]));
    }

    #[test]
    fn a_delimiter_at_the_end_of_a_row_is_no_column() {
        for text in
            ["time;y\n0;1;\n1;2;\n", "time;y;\n0;1;\n1;2;\n", "time;y;\n0;1\n1;2\n", "time;y\n0;1;;\n1;2\n"]
        {
            assert_eq!(csv(text).unwrap().column("y").unwrap(), [1.0, 2.0], "{text}");
        }
        for text in ["time;y\n0;1;3\n", "time;y\n0;1;;3\n", "time;y;z\n0;1\n"] {
            assert!(csv(text).unwrap_err().to_string().contains("line 2 has"), "{text}");
        }
    }

    #[test]
    fn what_spreadsheets_write_is_read() {
        let d = csv("time,y,,\r\n0,1,,\r\n1,2,,\r\n").unwrap();
        assert_eq!(d.column("y").unwrap(), [1.0, 2.0]);
        assert!(d.column("").unwrap_err().to_string().contains("two columns are named ''"));
        let d = Data::from_csv_text(b"time,\xb0C\n0,20\n", "latin.csv", None).unwrap();
        assert_eq!(d.column("\u{b0}C").unwrap(), [20.0]);
        let utf16: Vec<u8> = "\u{feff}time,y\n0,1\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert_eq!(Data::from_csv_text(&utf16, "utf16.csv", None).unwrap().column("y").unwrap(), [1.0]);
    }

    #[test]
    fn a_second_line_may_hold_units() {
        for text in [
            "time;phi;T;s;z\nms;deg;[degC];1;\n0;1,5;20;0;1\n500;2,5;21;0;1\n",
            "time,phi [deg],T,s,z\n[ms],,(degC),-,\n0,1.5,20,0,1\n500,2.5,21,0,1\n",
        ] {
            let d = csv(text).unwrap();
            assert_eq!(d.time(), [0.0, 0.5]);
            assert_eq!(d.column("phi").unwrap(), [1.5, 2.5]);
            assert_eq!((d.unit("phi"), d.unit("T"), d.unit("z")), (Some("deg"), Some("degC"), None));
        }
        let d = csv("time,y\n,mm\n2024-05-31T10:00:00,1\n2024-05-31T10:00:01,2\n").unwrap();
        assert_eq!(
            (d.time(), d.unit("y"), d.column("y").unwrap()),
            (&[0.0, 1.0][..], Some("mm"), &[1.0, 2.0][..])
        );
        // A row without a number is no line of units for that.
        let d = csv("time,y\n0,\n1,2\n").unwrap();
        assert_eq!((d.time().len(), d.unit("y")), (2, None));
    }

    #[test]
    fn dates_count_from_the_first() {
        for text in [
            "time,y\n2024-05-31T23:59:59.5,1\n2024-06-01T00:00:00.5,2\n",
            "time;y\n31.05.2024 23:59:59,5;1\n01.06.2024 00:00:00,5;2\n",
            "y;TIME\n1;10:00:00\n2;10:00:01\n",
            "y;time [mm:ss]\n1;10:00\n2;10:01\n",
            "time;y\nmm:ss;m\n10:00;1\n10:01;2\n",
            "time;y\n30:00;1\n30:01;2\n",
        ] {
            let d = csv(text).unwrap();
            assert_eq!((d.time(), d.column("y").unwrap()), (&[0.0, 1.0][..], &[1.0, 2.0][..]), "{text}");
        }
    }

    #[test]
    fn bad_tables_say_where() {
        for (text, expected) in [
            ("", "no rows"),
            ("time,y\n", "no rows"),
            ("time,y\n0,1\n2,1\n1,1\n", "time 1 at line 4 comes after 2"),
            ("time,y\n0,1\n0,1\n0,1\n", "third time"),
            ("time,y\nzero,1\n", "line 2: 'zero' is neither a number nor a date"),
            ("time,y\n0,1\nlater,1\n", "time 'later' in line 3 is not a number, as those of other lines are"),
            ("time,y\n05/31/2024 10:00,1\n", "which of them is the month cannot be told"),
            ("time,y\n10:00:00,1\n09:00:00,1\n", "times must ascend"),
            ("time,y\n00:00,1\n00:01,1\n", "'00:00' may be hours and minutes or minutes and seconds"),
            ("time,y\nkg,m\n0,1\n", "time 'kg' in line 2 is not a number"),
            ("time,y\n,1\n", "not finite"),
            ("time,y\ninf,1\n", "not finite"),
            ("time,y\n0,1\n1\n", "line 3 has 1 cells, the header has 2"),
            ("0,1\n1,2\n", "no header: line 1"),
            ("# time,y\n0,1\n1,2\n", "no header: line 2"),
            ("time,y\n# c\n\nzero,1\n", "in line 4: 'zero'"),
        ] {
            let e = csv(text).unwrap_err().to_string();
            assert!(e.contains(expected) && e.contains("test.csv"), "{text:?}: {e}");
        }
        let e = Data::from_columns(vec![0.0, 1.0], [("y".to_owned(), vec![1.0])]).unwrap_err().to_string();
        assert!(e.contains("'y' has 1 values, 'time' has 2"), "{e}");
    }

    #[test]
    fn a_time_may_stand_twice_for_inputs_but_not_for_measurements() {
        let d = csv("time,u,y\n0,1,5\n1,1,6\n1,2,\n2,2,7\n").unwrap();
        assert!(d.measured("y", 0..4).is_ok());
        assert!(d.measured("u", 2..4).is_ok());
        let e = d.measured("u", 0..4).unwrap_err().to_string();
        assert!(e.contains("two measurements at time 1: 1 and 2"), "{e}");
        let d = csv("time,y\n0,\n1,nan\n").unwrap();
        assert!(d.measured("y", 0..2).unwrap_err().to_string().contains("all 2 values"));
        let d = csv("time,y\n0,inf\n1,2\n").unwrap();
        assert!(d.measured("y", 0..2).unwrap_err().to_string().contains("infinite at time 0"));
    }
}
