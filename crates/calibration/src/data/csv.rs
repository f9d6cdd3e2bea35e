//! Reader for CSV files from spreadsheets and data loggers.

use super::csv_records::{MOST_COLUMNS, Records, decode};
use super::dates::{DateError, date_seconds, is_duration};
use super::recording::{Column, Data, hex, mixed_decimal_signs};
use super::time_column::{PairUnit, TimeColumn, find_column, time_unit};
use super::units::Unit;
use crate::error::CalibrationError;
use crate::findings::display_text::shortened;
use base::RunContext;
use sha2::{Digest, Sha256};
use std::borrow::Cow;
use std::io;
use std::path::{Path, PathBuf};

/// Spellings of a missing value in a CSV file, in upper or lower case.
const MISSING: [&str; 5] = ["", "nan", "na", "n/a", "null"];

/// Maximum length of a column name in bytes.
const LONGEST_NAME: usize = 1000;

/// Number of rows between two checks for cancellation.
const ROWS_PER_LOOK: usize = 4096;

/// Columns to read from a CSV file, and the context that can end the reading.
#[derive(Clone, Copy)]
pub struct CsvRequest<'a> {
    /// Name of the time column. `None` selects `time`, in upper or lower case.
    pub time: Option<&'a str>,
    /// Columns to keep in addition to the times. Only the names of the other columns are kept. `None` keeps
    /// all columns.
    pub columns: Option<&'a [String]>,
    /// Context that can end the reading. It is checked every few thousand rows.
    pub context: RunContext<'a>,
}

impl Default for CsvRequest<'_> {
    fn default() -> Self {
        Self { time: None, columns: None, context: RunContext::new() }
    }
}

impl Data {
    /// Reads a CSV file with a header line, which may be followed by a line of units. Lines that begin with
    /// `#` are comments.
    ///
    /// - Delimiter: comma, semicolon or tab, whichever occurs most often in the header. A first line `sep=;`,
    ///   as some spreadsheets write it, sets the delimiter. One additional delimiter at the end of each row
    ///   is ignored, and so are columns without a name at the end of the header.
    /// - Numbers: decimal commas are supported if the delimiter is not a comma. A file that mixes commas and
    ///   points is ambiguous because one of them may separate thousands. Using such a column is an error.
    /// - Times: the column `time` (in upper or lower case), in the unit that follows in brackets or
    ///   parentheses: s, ms, us, ns, min, h, d (`time [ms]`). Without a unit, they are in the time unit of
    ///   the model, which is s unless the model or [`SimulationSettings`](crate::SimulationSettings) state
    ///   another one. Dates (ISO 8601, or as `31.05.2024 13:45:10`) and times of day are converted to s since
    ///   the first row. If `00:01` is ambiguous, the name must include the format, as in `time [mm:ss]` or
    ///   `time [hh:mm]`.
    /// - Missing values: empty cells, `NaN`, `NA`, `N/A` and `null`, in upper or lower case.
    /// - Text columns are kept separately, and using one is an error. Using a column whose name and line of
    ///   units declare different units is also an error.
    ///
    /// Reading requires at most 8 times the size of the file in memory.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, has no time column (the message lists the columns), has
    /// no rows, has rows of different length, or has more than 65536 columns. Missing or non-ascending times
    /// are also an error. Each error reports the line. If there is not enough memory, returns
    /// [`CalibrationError::DataFile`] with the kind [`io::ErrorKind::OutOfMemory`].
    pub fn from_csv(path: impl AsRef<Path>) -> Result<Self, CalibrationError> {
        Self::read_csv(path, CsvRequest::default())
    }

    /// Reads a CSV file as [`from_csv`](Self::from_csv) does, with the times in the column `time` of any
    /// name.
    ///
    /// # Errors
    /// Returns the errors of [`from_csv`](Self::from_csv).
    pub fn from_csv_with_time(path: impl AsRef<Path>, time: &str) -> Result<Self, CalibrationError> {
        Self::read_csv(path, CsvRequest { time: Some(time), ..CsvRequest::default() })
    }

    /// Reads the requested columns of a CSV file as [`from_csv`](Self::from_csv) does.
    ///
    /// # Errors
    /// Returns the errors of [`from_csv`](Self::from_csv) and [`CalibrationError::Cancelled`]. A requested
    /// column that does not exist causes an error only when it is used.
    pub fn read_csv(path: impl AsRef<Path>, request: CsvRequest<'_>) -> Result<Self, CalibrationError> {
        let path = path.as_ref();
        let text = base::files::read_regular(path)
            .map_err(|source| CalibrationError::DataFile { path: path.to_owned(), source })?;
        let mut data = Self::read_csv_text(&text, &path.display().to_string(), request)?;
        data.file_hash = Some(hex(Sha256::new_with_prefix(&text)));
        Ok(data)
    }

    /// Reads CSV text as [`from_csv`](Self::from_csv) does. `source` is its name in errors, and `time` is the
    /// name of the time column.
    ///
    /// # Errors
    /// Returns the errors of [`from_csv`](Self::from_csv).
    pub fn from_csv_text(text: &[u8], source: &str, time: Option<&str>) -> Result<Self, CalibrationError> {
        Self::read_csv_text(text, source, CsvRequest { time, ..CsvRequest::default() })
    }

    /// Reads CSV text as [`read_csv`](Self::read_csv) does. `source_name` is its name in errors.
    ///
    /// # Errors
    /// Returns the errors of [`read_csv`](Self::read_csv).
    pub fn read_csv_text(
        text: &[u8],
        source_name: &str,
        request: CsvRequest<'_>,
    ) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: source_name.to_owned(), message };
        if text.starts_with(b"PK\x03\x04") {
            let what = "the file is a zip archive (such as an FMU or a workbook), not a CSV file";
            return Err(bad(format!("{what}. {}", how_to_convert(source_name, None))));
        }
        let text = decode(text);
        let (mut records, delimiter) = Records::new(&text);
        let (names, expected) = names_of(&mut records, delimiter).map_err(bad)?;
        let mut time_column =
            TimeColumn::find(names.iter().map(String::as_str), request.time).map_err(|message| {
                let hint = ". The file has only one column; separate columns with commas, semicolons or tabs";
                bad(if expected == 1 { message + hint } else { message })
            })?;
        let at = time_column.index;
        let mut is_kept = kept(&names, at, request.columns);
        // A row requires at least one byte per column.
        let (first_row, lines) = (records.clone(), records.n_lines());
        let most_rows = lines.min(records.rest().len() / names.len() + 1);
        let mut columns: Vec<Column> = names.iter().map(|n| Column::new(n.clone(), Vec::new())).collect();
        let mut values: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
        for (values, _) in values.iter_mut().zip(&is_kept).filter(|(_, is_kept)| **is_kept) {
            values.try_reserve_exact(most_rows).map_err(|_| no_memory(source_name))?;
        }
        let (mut n_rows, mut dates, mut has_units, mut cells) = (0, Vec::new(), false, Vec::new());
        while let Some((line, len)) = records.next(&mut cells) {
            if n_rows % ROWS_PER_LOOK == 0 && request.context.is_over() {
                return Err(CalibrationError::Cancelled);
            }
            // A delimiter at the end of a row or of the header creates an empty cell without a column.
            if cells.len() > expected || len < names.len() {
                return Err(bad(uneven(line, len, expected, delimiter)));
            }
            let units = (n_rows == 0 && !has_units).then(|| line_of_units(&cells, at)).flatten();
            if let Some(units) = units {
                has_units = true;
                columns.iter_mut().zip(units).for_each(|(column, unit)| column.state_unit(unit, line));
                if let Some(message) = columns[at].contradiction() {
                    return Err(bad(message));
                }
                if let Some(unit) = &columns[at].unit {
                    time_column.unit = Some(time_unit(&names[at], unit).map_err(bad)?);
                }
                continue;
            }
            n_rows += 1;
            for (k, column) in columns.iter_mut().enumerate() {
                let cell = cells.get(k).map_or("", |cell: &Cow<'_, str>| cell);
                // If commas are delimiters, numbers contain no commas, so the columns that are not kept need
                // no check.
                if is_kept[k] {
                    let value = column.note(cell, line, delimiter);
                    values[k].push(value);
                } else if delimiter != b',' && column.text.is_none() {
                    column.note(cell, line, delimiter);
                }
            }
            let date = columns[at].text.is_some().then(|| cells.get_mut(at)).flatten();
            dates.extend(date.filter(|date| number(date, delimiter).is_none()).map(std::mem::take));
        }
        if n_rows == 0 {
            return Err(bad("the file has no rows".to_owned()));
        }
        // Explicitly requested columns are used later, so check them now.
        let is_used = |k: &usize| *k == at || (is_kept[*k] && request.columns.is_some());
        let mixed = |k: usize| mixed_decimal_signs(&columns, &columns[k]);
        if let Some(message) = (0..columns.len()).filter(is_used).find_map(mixed) {
            return Err(bad(message));
        }
        let line_of = |row: usize| {
            let mut records = first_row.clone();
            let mut lines = std::iter::from_fn(|| records.next(&mut Vec::new()));
            lines.nth(row + usize::from(has_units)).unwrap_or_default().0
        };
        let mut times = std::mem::take(&mut values[at]);
        columns.iter_mut().zip(values).for_each(|(column, values)| column.values = values.into());
        is_kept.remove(at);
        let (time, mut is_kept) = (columns.remove(at), is_kept.into_iter());
        let (columns, others): (Vec<_>, Vec<_>) =
            columns.into_iter().partition(|_| is_kept.next() == Some(true));
        let (mut clock_change, has_dates) = (None, time.text.is_some());
        if let Some((line, text)) = &time.text {
            if dates.len() != n_rows {
                return Err(bad(format!(
                    "time '{text}' in line {line} is not a number, but the times in other lines are numbers or empty"
                )));
            }
            let stated = time.unit.as_deref().and_then(PairUnit::named);
            let pair = stated.or_else(|| PairUnit::of_column(&time.name));
            let found = date_seconds(&dates, pair, &request.context);
            (times, clock_change) = found.map_err(|error| match error {
                DateError::Cell(row, why) => bad(format!("time in line {}: {why}", line_of(row))),
                DateError::Cancelled => CalibrationError::Cancelled,
            })?;
            time_column.unit = Some((1.0, 1.0));
        }
        let place = |row| format!("line {}", line_of(row));
        let data =
            Self::in_column(source_name.to_owned(), (time.name, times.into()), time_column, columns, place)?;
        let data = data.with_dates(has_dates);
        let first_date =
            dates.first().filter(|date| has_dates && !is_duration(date)).map(|date| date.trim().to_owned());
        let data = data.with_first_date(first_date);
        Ok(data.left_out(others.into_iter().map(|column| column.name)).with_clock_change(clock_change))
    }
}

/// Returns a sentence on how to convert a sheet of a workbook to a CSV file.
pub(crate) fn how_to_convert(workbook: &str, sheet: Option<&str>) -> String {
    let name = sheet.map_or_else(String::new, |sheet| format!(", sheet_name={sheet:?}"));
    format!(
        "Save the sheet of a workbook as a CSV file, or convert it with Python: pandas.read_excel({workbook:?}{name}).to_csv(\"run.csv\", \
         index=False)"
    )
}

/// Returns the names in the header and the number of cells per row.
fn names_of(records: &mut Records<'_>, delimiter: u8) -> Result<(Vec<String>, usize), String> {
    let (names, expected, line) = header(records)?;
    match names.iter().all(|name| number(name, delimiter).is_some()) {
        _ if expected == 0 => Err("the file has no rows".to_owned()),
        true => Err(format!("the header is missing: line {line} contains only numbers")),
        false => Ok((names, expected)),
    }
}

fn no_memory(source_name: &str) -> CalibrationError {
    let source = io::Error::new(io::ErrorKind::OutOfMemory, "there is not enough memory for its columns");
    CalibrationError::DataFile { path: PathBuf::from(source_name), source }
}

/// True for each column whose numbers are kept: the times and the requested columns.
fn kept(names: &[String], at: usize, requested: Option<&[String]>) -> Vec<bool> {
    let mut is_kept = vec![requested.is_none(); names.len()];
    is_kept[at] = true;
    for name in requested.unwrap_or_default() {
        // Missing or ambiguous names cause an error when they are used.
        if let Ok(index) = find_column(names.iter().map(String::as_str), name) {
            is_kept[index] = true;
        }
    }
    is_kept
}

/// Returns the message about a line whose number of cells differs from the header.
fn uneven(line: usize, len: usize, expected: usize, delimiter: u8) -> String {
    let hint = match delimiter {
        b',' if len == 2 * expected => {
            ". Separate columns with semicolons or tabs if numbers have decimal commas"
        }
        _ => "",
    };
    format!("line {line} has {len} cells, but the header has {expected}{hint}")
}

/// Returns the names of the columns up to the last named one, the number of cells of the header, and its
/// line.
fn header(records: &mut Records<'_>) -> Result<(Vec<String>, usize, usize), String> {
    let mut names = Vec::new();
    let (line, expected) = records.next(&mut names).unwrap_or_default();
    if names.len() > MOST_COLUMNS {
        return Err(format!("the header in line {line} has more than {MOST_COLUMNS} columns with a name"));
    }
    if let Some(long) = names.iter().find(|name| name.len() > LONGEST_NAME) {
        let (length, shown) = (long.len(), shortened(long));
        return Err(format!(
            "the header in line {line} has a name of {length} bytes, more than {LONGEST_NAME}: '{shown}'"
        ));
    }
    Ok((names.into_iter().map(Cow::into_owned).collect(), expected, line))
}

/// Returns the units of the columns if the first line below the header contains units. In this case, the time
/// cell is a unit of time or empty, and no other cell is a number except the unit 1.
fn line_of_units(record: &[Cow<'_, str>], time: usize) -> Option<Vec<Option<String>>> {
    let bare = |cell: &Cow<'_, str>| {
        let inner = |(open, close)| cell.strip_prefix(open)?.strip_suffix(close).map(str::trim);
        [('[', ']'), ('(', ')')].into_iter().find_map(inner).unwrap_or(cell).to_owned()
    };
    let is_unit = |cell: &str| Unit::parse(cell).is_ok();
    let cells: Vec<String> = record.iter().map(bare).collect();
    let is_of_time = match cells.get(time).map_or("", String::as_str) {
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

/// Returns the number in a cell, NaN for a missing value, or `None` for text.
fn number(cell: &str, delimiter: u8) -> Option<f64> {
    // A decimal comma is unambiguous if the comma is not the delimiter.
    let with_comma = || {
        (delimiter != b',' && cell.contains(',')).then(|| cell.replacen(',', ".", 1).parse().ok()).flatten()
    };
    let missing = || MISSING.iter().any(|m| cell.eq_ignore_ascii_case(m)).then_some(f64::NAN);
    cell.parse().ok().or_else(missing).or_else(with_comma)
}

impl Column {
    /// Returns the value of a cell, or NaN if it has none. Records the first text and the first numbers with
    /// a comma and with a point.
    fn note(&mut self, cell: &str, line: usize, delimiter: u8) -> f64 {
        let number = number(cell, delimiter);
        let is_determined = self.point.is_some() && (delimiter == b',' || self.comma.is_some());
        if number.is_none() || !is_determined {
            let first = match number {
                None => &mut self.text,
                Some(_) if cell.contains(',') => &mut self.comma,
                _ => &mut self.point,
            };
            if first.is_none() && (number.is_none() || cell.contains([',', '.'])) {
                *first = Some((line, shortened(cell).into_owned()));
            }
        }
        number.unwrap_or(f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(text: &str) -> Result<Data, CalibrationError> {
        Data::from_csv_text(text.as_bytes(), "test.csv", None)
    }

    #[test]
    fn csv_reads_irregular_times_missing_values_and_text_columns() {
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
    fn csv_accepts_time_in_any_column_and_decimal_commas_with_semicolons() {
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
        assert!(e.contains("test.csv: column 'time' not found; available: 'k', 't', 'y'"), "{e}");
        let d = csv("# rig A, run 3\n\ntime;\"a,b,c\";y\n0;1;2\n").unwrap();
        assert_eq!(d.names().collect::<Vec<_>>(), ["a,b,c", "y"]);
    }

    #[test]
    fn csv_rejects_mixed_decimal_signs_when_the_column_is_used() {
        for (text, column) in [
            ("time;y\n0;1,234\n1;2.345\n", "y"),
            ("time;y;z\n0;1,234;1\n1;2,5;2.5\n", "y"),
            ("time;y;z\n0;1,234;1\n1;2,5;2.5\n", "z"),
        ] {
            let e = csv(text).unwrap().column(column).unwrap_err().to_string();
            assert!(e.contains("'1,234' in column 'y', line 2, has a comma, but '2."), "{e}");
        }
        let e = csv("time;y\n0.5;1,234\n1;2\n").unwrap_err().to_string();
        assert!(e.contains("'0.5' in column 'time', line 2, has a point"), "{e}");
        // Integers, text, and columns without any sign do not determine the decimal sign.
        let d = csv("time;y;n;note\n0;1,5;7;v1.2\n1;2;8;a.b\n").unwrap();
        assert_eq!((d.column("y").unwrap(), d.column("n").unwrap()), (&[1.5, 2.0][..], &[7.0, 8.0][..]));
    }

    #[test]
    fn csv_ignores_a_delimiter_at_the_end_of_a_row() {
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
    fn csv_reads_spreadsheet_files() {
        let d = csv("time,y,,\r\n0,1,,\r\n1,2,,\r\n").unwrap();
        assert_eq!(d.column("y").unwrap(), [1.0, 2.0]);
        assert!(d.column("").unwrap_err().to_string().contains("column '' not found; available: 'y'"));
        let d = Data::from_csv_text(b"time,\xb0C\n0,20\n", "latin.csv", None).unwrap();
        assert_eq!(d.column("\u{b0}C").unwrap(), [20.0]);
        let utf16: Vec<u8> = "\u{feff}time,y\n0,1\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert_eq!(Data::from_csv_text(&utf16, "utf16.csv", None).unwrap().column("y").unwrap(), [1.0]);
    }

    #[test]
    fn csv_reads_units_from_the_second_line() {
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
        // A row without numbers is not always a line of units.
        let d = csv("time,y\n0,\n1,2\n").unwrap();
        assert_eq!((d.time().len(), d.unit("y")), (2, None));
    }

    #[test]
    fn csv_rejects_a_column_with_two_units_when_it_is_used() {
        let message = csv("time [min],y\nms,K\n0,1\n1,2\n").unwrap_err().to_string();
        assert!(
            message.contains("test.csv")
                && message.contains("'time [min]' has two units, 'min' in its name and 'ms' in line 2"),
            "{message}"
        );
        let d = csv("# one\ntime,T [degC],x (mm),p [bar]\ns,K,Pa,bar\n0,1,2,3\n").unwrap();
        for (column, expected) in
            [("T", "'degC' in its name and 'K' in line 3"), ("x", "'mm' in its name and 'Pa' in line 3")]
        {
            let message = d.check_units(column).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        assert!(d.check_units("p").is_ok() && d.column("T").is_ok());
        // Spellings of one unit, brackets that do not contain a unit, and a dash in the line of units.
        let d = csv("time [s],P [J/s],E (kW.h),f [Hz],T [raw],x [mm]\nseconds,W,kWh,1/s,K,-\n0,1,2,3,4,5\n")
            .unwrap();
        for column in ["P", "E", "f", "T", "x"] {
            assert!(d.check_units(column).is_ok(), "{column}");
        }
        assert_eq!((d.unit("T"), d.unit("x")), (Some("K"), Some("mm")));
    }

    #[test]
    fn csv_converts_dates_to_seconds_since_the_first() {
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
    fn csv_keeps_durations_and_stores_no_date_for_them() {
        let d = csv("time,y\n0 days 00:00:02,1\n0 days 00:00:02.500000,2\n").unwrap();
        assert_eq!((d.time(), d.states_time_unit(), d.first_date()), (&[2.0, 2.5][..], true, None));
        let d = csv("time,y\n31-May-2024 10:00:02,1\n31-May-2024 10:00:03,2\n").unwrap();
        assert_eq!((d.time(), d.first_date()), (&[0.0, 1.0][..], Some("31-May-2024 10:00:02")));
    }

    /// Reads only these columns.
    fn some(text: &str, columns: &[&str]) -> Result<Data, CalibrationError> {
        let columns: Vec<String> = columns.iter().map(|name| (*name).to_owned()).collect();
        let request = CsvRequest { columns: Some(&columns), ..CsvRequest::default() };
        Data::read_csv_text(text.as_bytes(), "test.csv", request)
    }

    #[test]
    fn csv_allocates_no_memory_for_columns_without_a_name() {
        // A full table would have 4e9 cells.
        let rows: String = (0..20_000).map(|k| format!("{k},1\n")).collect();
        let d = csv(&format!("time,y{}\n{rows}", ",".repeat(200_000))).unwrap();
        assert_eq!((d.names().collect::<Vec<_>>(), d.time().len()), (vec!["y"], 20_000));
        let d = csv(&format!("time,y,,\n0,1,{}\n", "2,".repeat(3))).unwrap_err().to_string();
        assert!(d.contains("line 2 has 6 cells, but the header has 4"), "{d}");
        let e = csv(&format!("time{}\n0\n", ",a".repeat(MOST_COLUMNS))).unwrap_err().to_string();
        assert!(e.contains("more than 65536 columns with a name"), "{e}");
    }

    #[test]
    fn csv_keeps_only_requested_columns() {
        let d = some("time,a,y [mm],y [m]\n0,1,2,soon\n1,3,4,5\n", &["y [mm]", "b"]).unwrap();
        assert_eq!(
            (d.names().collect::<Vec<_>>(), d.column("y [mm]").unwrap()),
            (vec!["y [mm]"], &[2.0, 4.0][..])
        );
        let message = |name| d.column(name).unwrap_err().to_string();
        assert!(
            message("b").contains("column 'b' not found; available: 'y [mm]', 'a', 'y [m]'"),
            "{}",
            message("b")
        );
        assert!(message("a").contains("column 'a' was omitted"));
        assert!(message("y").contains("several columns are named 'y'"));
        // Another column may show the meaning of a comma.
        let text = "time;y;z\n0;1,234;1\n1;2,5;2.5\n";
        let e = some(text, &["y"]).unwrap_err().to_string();
        assert!(e.contains("has a comma, but '2.5' in column 'z', line 3, has a point"), "{e}");
        assert!(some("time;y;z\n0;1,234;1\n1;2,5;2\n", &["y"]).is_ok());
    }

    #[test]
    fn csv_shortens_long_cells_in_errors_and_stops_when_cancelled() {
        let long = "x".repeat(1 << 20);
        for text in [
            format!("time,y\n0,{long}\n"),
            format!("time,y\n{long},1\n"),
            format!("time,{long}\n0,1\n"),
            format!("{long}\n0\n"),
        ] {
            let e = some(&text, &["y"]).and_then(|d| d.column("y").map(|_| ())).unwrap_err().to_string();
            assert!(
                e.len() < 500 && e.contains("... (1048576 bytes)") || e.contains("name of 1048576 bytes"),
                "{e:.300}"
            );
        }
        let request = CsvRequest { context: RunContext::new().polling(&|| true), ..CsvRequest::default() };
        let cancelled = Data::read_csv_text(b"time,y\n0,1\n", "test.csv", request);
        assert!(matches!(cancelled, Err(CalibrationError::Cancelled)));
    }

    #[test]
    fn csv_reads_delimiters_quotes_and_line_ends_in_quoted_cells() {
        let d =
            csv("time,\"a \"\"b\"\", c\",\"two\nlines\",\ty\n0,\"1\",x, 2 \r\n# c\n1,3,\"y\n\",4\n").unwrap();
        assert_eq!(d.names().collect::<Vec<_>>(), ["a \"b\", c", "two\nlines", "y"]);
        assert_eq!((d.column("y").unwrap(), d.time()), (&[2.0, 4.0][..], &[0.0, 1.0][..]));
        let e = d.column("two\nlines").unwrap_err().to_string();
        assert!(e.contains("'x'") && e.contains("line 3"), "{e}");
        assert!(csv("time,y\r0,1\r1,2").unwrap().column("y").is_ok());
        let open = csv("time,y\n0,\"1\n1,2\n").unwrap();
        assert!(open.column("y").unwrap_err().to_string().contains("in column 'y', line 2, is not a number"));
    }

    #[test]
    fn csv_errors_report_the_line() {
        for (text, expected) in [
            ("", "no rows"),
            ("time,y\n", "no rows"),
            ("time,y\n0,1\n2,1\n1,1\n", "time 1 at line 4 follows 2"),
            (",y\n0,1\n1,2\n", "write index_label=\"time\" in to_csv"),
            ("time,y\n0,1\n0,1\n0,1\n", "all 3 rows have the time 0"),
            ("time,y\nzero,1\n", "line 2: 'zero' is neither a number nor a date"),
            (
                "time,y\n0,1\nlater,1\n",
                "time 'later' in line 3 is not a number, but the times in other lines are",
            ),
            ("time,y\n05/31/2024 10:00,1\n", "day and month are ambiguous"),
            ("time,y\n10:00:00,1\n09:00:00,1\n", "times must ascend"),
            ("time,y\n23:59:00,1\n00:00:00,1\n", "a clock passed midnight, write the date"),
            ("time,y\n00:00,1\n00:01,1\n", "'00:00' may be hours and minutes or minutes and seconds"),
            ("time,y\nkg,m\n0,1\n", "time 'kg' in line 2 is not a number"),
            ("time,y\n,1\n", "not finite"),
            ("time,y\ninf,1\n", "not finite"),
            ("time,y\n0,1\n1\n", "line 3 has 1 cells, but the header has 2"),
            ("0,1\n1,2\n", "the header is missing: line 1"),
            ("# time,y\n0,1\n1,2\n", "the header is missing: line 2"),
            ("time,y\n# c\n\nzero,1\n", "in line 4: 'zero'"),
        ] {
            let e = csv(text).unwrap_err().to_string();
            assert!(e.contains(expected) && e.contains("test.csv"), "{text:?}: {e}");
        }
        let e = Data::from_columns(vec![0.0, 1.0], [("y".to_owned(), vec![1.0])]).unwrap_err().to_string();
        assert!(e.contains("'y' has 1 values, but 'time' has 2"), "{e}");
    }

    #[test]
    fn csv_accepts_repeated_times() {
        let d = csv("time,u,y\n0,1,5\n1,1,6\n1,2,\n1,2,6.5\n2,2,7\n").unwrap();
        assert_eq!(d.measured("y", 0..5).unwrap()[3], 6.5);
        let d = csv("time,y\n0,\n1,nan\n").unwrap();
        assert!(d.measured("y", 0..2).unwrap_err().to_string().contains("all 2 values"));
        let d = csv("time,y\n0,inf\n1,2\n").unwrap();
        assert!(
            d.measured("y", 0..2).unwrap_err().to_string().contains("infinite or above 1.8e308 at time 0")
        );
    }
}
