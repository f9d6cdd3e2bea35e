//! A table of recorded series over one column of times: irregular times, missing values.

use super::clock_change::{ClockChange, DAY};
use super::series::{Series, sampling_interval};
use super::time_column::{TimeColumn, find_column, is_contradiction, parts};
use super::units::UnitConversion;
use crate::error::CalibrationError;
use base::{Number, RunContext};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io::Read;
use std::ops::Range;
use std::path::Path;

/// A table of recorded series over one time column.
///
/// Times ascend; a time may stand twice (an input jumps there), never three times. A missing value is NaN.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Data {
    pub(super) source: String,
    pub(super) time_name: String,
    pub(super) time: Series,
    pub(super) columns: Vec<Column>,
    /// Names of columns that were left out.
    pub(super) left_out: Vec<String>,
    /// The times were dates or durations: they have no other unit.
    #[serde(default)]
    has_dates: bool,
    /// The first of them, as it stands in the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    first_date: Option<String>,
    /// An hour that is missing in times without a zone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    clock_change: Option<ClockChange>,
    /// The rows are means over intervals of this length in s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) resampled: Option<f64>,
    /// What said in which rows measurements count: a column, or a value for each row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mask: Option<String>,
    /// SHA-256 of the file that it was read from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) file_hash: Option<String>,
}

/// What a table is, without its numbers.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct DataSummary<'d> {
    /// Where it comes from.
    pub(crate) source: &'d str,
    /// SHA-256 of the file that it was read from.
    pub(crate) file_sha256: Option<&'d str>,
    /// SHA-256 of the names and values that are compared, after mask and means.
    pub(crate) fingerprint: String,
    pub(crate) n_rows: usize,
    /// The column of times, and its first and last value in s.
    pub(crate) time: &'d str,
    pub(crate) from: Option<f64>,
    pub(crate) to: Option<f64>,
    pub(crate) columns: Vec<&'d str>,
    /// What said in which rows measurements count.
    pub(crate) mask: Option<&'d str>,
    /// The interval over which means were taken, in s.
    pub(crate) resample: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Column {
    pub(super) name: String,
    /// The unit of the values, where it is not the one in the name: from a line of units, or converted to.
    pub(super) unit: Option<String>,
    /// The line of units, if the unit in it is another one than that in the name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    contradicting: Option<Cell>,
    pub(super) values: Series,
    /// How the values were converted, and the unit that they had.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    converted: Option<(UnitConversion, Option<String>)>,
    /// The first cell that is no number.
    pub(super) text: Option<Cell>,
    /// The first numbers with a comma and with a point.
    pub(super) comma: Option<Cell>,
    pub(super) point: Option<Cell>,
}

/// Values so many usual distances apart are not joined by a line.
const WIDEST_GAP: f64 = 10.0;

/// So many bytes of a file are hashed between two looks at the context: 1 ms.
const HASHED_AT_ONCE: usize = 1 << 20;

/// A hash in hexadecimal.
pub(super) fn hex(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A cell of a file: its line, counted from 1, and its text.
type Cell = (usize, String);

impl Data {
    /// A table from columns in memory, one of which holds the times: the column `time` as in a
    /// [CSV file](Self::from_csv), or the one that is named here.
    ///
    /// # Errors
    /// No column of times, columns of different length, times that are not finite or not ascending.
    pub fn from_table<S: Into<Series>>(
        columns: impl IntoIterator<Item = (String, S)>,
        time: Option<&str>,
    ) -> Result<Self, CalibrationError> {
        let columns = columns.into_iter().map(|(name, values)| (name, values.into()));
        let mut columns: Vec<(String, Series)> = columns.collect();
        let found = TimeColumn::find(columns.iter().map(|(name, _)| name.as_str()), time);
        let found =
            found.map_err(|message| CalibrationError::Data { source_name: "data".to_owned(), message })?;
        let (name, mut times) = columns.remove(found.index);
        times.to_mut().iter_mut().for_each(|t| *t = found.seconds(*t));
        let columns = columns.into_iter().map(|(name, values)| Column::new(name, values)).collect();
        Self::new("data".to_owned(), name, times, columns, |row| format!("row {row}"))
    }

    /// Checks what a table is checked for when it is made: what comes from a file may be something else.
    pub(crate) fn check(&self) -> Result<(), CalibrationError> {
        let Self { source, time_name, time, columns, .. } = self.clone();
        Self::new(source, time_name, time, columns, |row| format!("row {row}")).map(|_| ())
    }

    /// Names of columns that the recording has, and this table has not: a [warning](crate::SetupWarning) may
    /// concern them.
    #[must_use]
    pub fn left_out(mut self, names: impl IntoIterator<Item = String>) -> Self {
        self.left_out.extend(names);
        self
    }

    /// An hour that is missing in the times, which are those of a clock without a zone: a
    /// [warning](crate::SetupWarning) says so.
    #[must_use]
    pub fn with_clock_change(mut self, change: Option<ClockChange>) -> Self {
        self.clock_change = change;
        self
    }

    /// Where the table was read from, if that was no [CSV file](Self::read_csv): the path is its
    /// [source](Self::source), and a record of a fit has the hash of the file as it is now.
    ///
    /// # Errors
    /// [`CalibrationError::DataFile`]: the file cannot be read; [`CalibrationError::Cancelled`].
    pub fn of_file(mut self, path: &Path, context: &RunContext<'_>) -> Result<Self, CalibrationError> {
        let unread = |source| CalibrationError::DataFile { path: path.to_owned(), source };
        let mut file = base::files::open_regular(path).map_err(unread)?;
        let (mut hasher, mut part) = (Sha256::new(), vec![0; HASHED_AT_ONCE]);
        loop {
            if context.is_over() {
                return Err(CalibrationError::Cancelled);
            }
            match file.read(&mut part).map_err(unread)? {
                0 => break,
                n => hasher.update(&part[..n]),
            }
        }
        (self.source, self.file_hash) = (path.display().to_string(), Some(hex(hasher)));
        Ok(self)
    }

    /// The times were dates or durations, of which the unit is known.
    #[must_use]
    pub fn with_dates(self, has_dates: bool) -> Self {
        Self { has_dates, ..self }
    }

    /// True if the times were dates or durations.
    pub(crate) fn has_dates(&self) -> bool {
        self.has_dates
    }

    /// The first date, as it stands in the file.
    #[must_use]
    pub(super) fn with_first_date(self, first_date: Option<String>) -> Self {
        Self { first_date, ..self }
    }

    pub(crate) fn first_date(&self) -> Option<&str> {
        self.first_date.as_deref()
    }

    /// An hour that is missing in the times.
    pub(crate) fn clock_change(&self) -> Option<&ClockChange> {
        self.clock_change.as_ref()
    }

    /// Names of all columns beside the time, those left out last.
    pub fn all_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.names().chain(self.left_out.iter().map(String::as_str))
    }

    /// The distance of the times: the median.
    pub(crate) fn sampling_interval(&self) -> Option<f64> {
        sampling_interval(&self.time)
    }

    /// A table from columns in memory; all as long as `time`.
    ///
    /// # Errors
    /// Columns of another length, times that are not finite or not ascending.
    pub fn from_columns(
        time: Vec<f64>,
        columns: impl IntoIterator<Item = (String, Vec<f64>)>,
    ) -> Result<Self, CalibrationError> {
        let columns = columns.into_iter().map(|(name, values)| Column::new(name, values)).collect();
        Self::new("data".to_owned(), "time".to_owned(), time, columns, |row| format!("row {row}"))
    }

    pub(super) fn new(
        source: String,
        time_name: String,
        time: impl Into<Series>,
        columns: Vec<Column>,
        place: impl Fn(usize) -> String,
    ) -> Result<Self, CalibrationError> {
        let time = time.into();
        let bad = |message: String| Err(CalibrationError::Data { source_name: source.clone(), message });
        if time.is_empty() {
            return bad("there are no rows".to_owned());
        }
        for column in &columns {
            if column.values.len() != time.len() {
                return bad(format!(
                    "column '{}' has {} values, '{time_name}' has {}",
                    column.name,
                    column.values.len(),
                    time.len()
                ));
            }
        }
        for (i, t) in time.iter().enumerate() {
            if !t.is_finite() {
                return bad(format!("time {} at {} is not finite", Number(*t), place(i)));
            }
            if i > 0 && *t < time[i - 1] {
                // Back by nearly a day.
                let hint = match time[i - 1] - t {
                    back if (0.5..=1.0).contains(&(back / DAY)) => {
                        ". Where a clock passed midnight, write the date with each time, or add 24 h from there on"
                    }
                    _ => "",
                };
                return bad(format!(
                    "time {} at {} comes after {}: times must ascend{hint}",
                    Number(*t),
                    place(i),
                    Number(time[i - 1])
                ));
            }
            if i > 1 && *t == time[i - 2] {
                return bad(format!("time {} at {} stands there for the third time", Number(*t), place(i)));
            }
        }
        Ok(Self {
            source,
            time_name,
            time,
            columns,
            left_out: Vec::new(),
            has_dates: false,
            first_date: None,
            clock_change: None,
            resampled: None,
            mask: None,
            file_hash: None,
        })
    }

    /// Where the table comes from, as errors name it.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// A hash of the names and values: of the content, wherever it came from.
    pub(crate) fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        let columns = self.columns.iter().map(|c| (&c.name, c.unit.as_deref(), &c.values));
        for (name, unit, values) in std::iter::once((&self.time_name, None, &self.time)).chain(columns) {
            for text in std::iter::once(name.as_str()).chain(unit) {
                hasher.update((text.len() as u64).to_le_bytes());
                hasher.update(text);
            }
            hasher.update((values.len() as u64).to_le_bytes());
            values.iter().for_each(|v| hasher.update(v.to_bits().to_le_bytes()));
        }
        hex(hasher)
    }

    /// What it is, without its numbers.
    pub(crate) fn summary(&self) -> DataSummary<'_> {
        DataSummary {
            source: &self.source,
            file_sha256: self.file_hash.as_deref(),
            fingerprint: self.hash(),
            n_rows: self.time.len(),
            time: &self.time_name,
            from: self.time.first().copied(),
            to: self.time.last().copied(),
            columns: self.names().collect(),
            mask: self.mask.as_deref(),
            resample: self.resampled,
        }
    }

    /// The times.
    pub fn time(&self) -> &[f64] {
        &self.time
    }

    /// The times as they are shared.
    pub(crate) fn time_series(&self) -> &Series {
        &self.time
    }

    /// Names of the columns beside the time, in their order.
    pub fn names(&self) -> impl Iterator<Item = &str> + Clone {
        self.columns.iter().map(|c| c.name.as_str())
    }

    /// A column by name, with NaN for missing values. Its unit may be left out: `phi` finds `phi [deg]`.
    ///
    /// # Errors
    /// No such column (the message lists those there are), a cell that is no number, an infinite value.
    pub fn column(&self, name: &str) -> Result<&[f64], CalibrationError> {
        self.series(name).map(|values| &values[..])
    }

    /// As [`column`](Self::column), as it is shared.
    pub(crate) fn series(&self, name: &str) -> Result<&Series, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        let Some(index) = self.position(name)? else { return Ok(&self.time) };
        let column = &self.columns[index];
        let name = &column.name;
        if let Some((line, text)) = &column.text {
            return Err(bad(format!(
                "'{text}' in column '{name}', line {line}, is not a number; missing values are empty cells, NaN, NA, N/A \
                 or null"
            )));
        }
        if let Some(message) = mixed_decimal_signs(&self.columns, column) {
            return Err(bad(message));
        }
        if let Some(row) = column.values.iter().position(|v| v.is_infinite()) {
            return Err(bad(format!(
                "column '{name}' is infinite, or beyond the largest number 1.8e308, at time {}",
                self.time[row]
            )));
        }
        Ok(&column.values)
    }

    /// Position of a column; `None`: it is that of the times.
    fn position(&self, name: &str) -> Result<Option<usize>, CalibrationError> {
        if name == self.time_name {
            return Ok(None);
        }
        let message = match find_column(self.all_names(), name) {
            Ok(index) if index < self.columns.len() => return Ok(Some(index)),
            Ok(_) => format!("column '{name}' was left out"),
            Err(message) => message,
        };
        Err(CalibrationError::Data { source_name: self.source.clone(), message })
    }

    /// The unit of a column, where it is stated: behind its name in brackets or parentheses, or in a line of
    /// units; after [`Calibration::from_problem`](crate::Calibration::from_problem) that of the variable
    /// which it was converted to.
    pub fn unit(&self, column: &str) -> Option<&str> {
        let column = &self.columns[self.position(column).ok()??];
        column.unit.as_deref().or_else(|| parts(&column.name).1)
    }

    /// The name of a column with its unit in brackets where that stands beside the name, from a line of
    /// units.
    pub fn name_with_unit(&self, column: &str) -> Option<String> {
        let column = &self.columns[self.position(column).ok()??];
        let name = || parts(&column.name).0;
        Some(column.unit.as_ref().map_or_else(|| column.name.clone(), |unit| format!("{} [{unit}]", name())))
    }

    /// The unit of a column that does not stand in its name: from a line of units, or converted to.
    pub(crate) fn unit_beside_name(&self, column: &str) -> Option<&str> {
        self.columns[self.position(column).ok()??].unit.as_deref()
    }

    /// Refuses a column with one unit in its name and another one in the line of units.
    pub(crate) fn check_units(&self, column: &str) -> Result<(), CalibrationError> {
        let Some(index) = self.position(column)? else { return Ok(()) };
        let bad = |message| CalibrationError::Data { source_name: self.source.clone(), message };
        self.columns[index].contradiction().map_or(Ok(()), |message| Err(bad(message)))
    }

    /// Takes the values of these columns as missing in the rows where `keep` is false. Inputs are not meant:
    /// they go on between the rows that are left.
    ///
    /// # Errors
    /// No such column; `keep` has another length than the table, or is false throughout.
    pub fn masked(mut self, columns: &[&str], keep: &[bool]) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        if keep.len() != self.time.len() {
            return Err(bad(format!(
                "the mask has {} entries, the table {} rows",
                keep.len(),
                self.time.len()
            )));
        }
        if !keep.contains(&true) {
            return Err(bad("the mask keeps no row: it is true in the rows that count".to_owned()));
        }
        for name in columns {
            let Some(index) = self.position(name)? else { continue };
            let rows = self.columns[index].values.to_mut().iter_mut().zip(keep);
            rows.filter(|(_, keep)| !**keep).for_each(|(value, _)| *value = f64::NAN);
        }
        let n = keep.iter().filter(|keep| **keep).count();
        self.mask = Some(format!("{n} of {} rows", keep.len()));
        Ok(self)
    }

    /// As [`masked`](Self::masked); rows count where the column `by` is neither 0 nor missing.
    ///
    /// # Errors
    /// As [`masked`](Self::masked), and as [`column`](Self::column).
    pub fn masked_by(self, columns: &[&str], by: &str) -> Result<Self, CalibrationError> {
        let keep: Vec<bool> = self.column(by)?.iter().map(|v| !v.is_nan() && *v != 0.0).collect();
        let mut masked = self.masked(columns, &keep)?;
        masked.mask = masked.mask.map(|rows| format!("column '{by}': {rows}"));
        Ok(masked)
    }

    /// The name of a column in full, with its unit if it has one there.
    pub(crate) fn full_name(&self, column: &str) -> Option<&str> {
        Some(&self.columns[self.position(column).ok()??].name)
    }

    /// Converts a column; the unit of its values is `unit` from then on.
    pub(crate) fn convert(&mut self, column: &str, conversion: UnitConversion, unit: &str) {
        if let Ok(Some(index)) = self.position(column) {
            let column = &mut self.columns[index];
            column.values.to_mut().iter_mut().for_each(|value| *value = conversion.apply(*value));
            let given = column.unit.take().or_else(|| parts(&column.name).1.map(str::to_owned));
            column.converted = Some((conversion, given));
            column.unit = Some(unit.to_owned());
        }
    }

    /// A value of a column as it was before its conversion, but for rounding, and the unit that it had then.
    pub(crate) fn as_given(&self, column: &str, value: f64) -> (f64, &str) {
        let converted = self.position(column).ok().flatten().and_then(|k| self.columns[k].converted.as_ref());
        match converted {
            Some((conversion, unit)) => {
                let given = format!("{:.11e}", conversion.invert(value)).parse().unwrap_or(value);
                (given, unit.as_deref().unwrap_or_default())
            }
            None => (value, ""),
        }
    }

    /// The value of a column at a time, linear between the known values on both sides, which lie no farther
    /// apart than `WIDEST_GAP` usual distances of its known values.
    ///
    /// # Errors
    /// As [`column`](Self::column); no known value at this time, or on one side of it.
    pub(crate) fn value_at(&self, column: &str, time: f64) -> Result<f64, CalibrationError> {
        let values = self.column(column)?;
        let known: Vec<(f64, f64)> =
            self.time.iter().copied().zip(values.iter().copied()).filter(|(_, v)| !v.is_nan()).collect();
        let bad = |found: String| {
            let message = format!("column '{column}' has no value at {} s{found}", Number(time));
            Err(CalibrationError::Data { source_name: self.source.clone(), message })
        };
        let (Some(first), Some(last)) = (known.first(), known.last()) else {
            return bad(": all are missing".to_owned());
        };
        let tolerance = base::time_tolerance(first.0.min(time), last.0.max(time));
        if let Some((_, value)) = known.iter().find(|(t, _)| (t - time).abs() <= tolerance) {
            return Ok(*value);
        }
        let after = known.partition_point(|(t, _)| *t <= time);
        if after == 0 {
            return bad(format!(", the first one is at {} s", Number(first.0)));
        }
        let (Some((t0, v0)), Some((t1, v1))) = (known.get(after - 1), known.get(after)) else {
            return bad(format!(", the last one is at {} s", Number(last.0)));
        };
        let times: Vec<f64> = known.iter().map(|(t, _)| *t).collect();
        let rounding = (WIDEST_GAP + 1.0) * tolerance;
        if sampling_interval(&times).is_some_and(|usual| t1 - t0 > WIDEST_GAP * usual + rounding) {
            return bad(format!(", there are none from {} s to {} s", Number(*t0), Number(*t1)));
        }
        Ok(v0 + (v1 - v0) * (time - t0) / (t1 - t0))
    }

    /// A column that was measured: at least one value in these rows, and no time with two of them.
    ///
    /// # Errors
    /// As [`column`](Self::column), all values missing, two values at one time.
    ///
    /// # Panics
    /// If `rows` reaches beyond the table.
    pub(crate) fn measured(&self, name: &str, rows: Range<usize>) -> Result<&Series, CalibrationError> {
        let series = self.series(name)?;
        let values = &series[rows.clone()];
        let time = &self.time[rows];
        let bad = |message: String| Err(CalibrationError::Data { source_name: self.source.clone(), message });
        if values.iter().all(|v| v.is_nan()) {
            return bad(format!(
                "all {} values of column '{name}' from time {} to {} are missing",
                values.len(),
                time[0],
                time[time.len() - 1]
            ));
        }
        let is_twice = |i: &usize| time[*i] == time[i - 1] && !values[*i].is_nan() && !values[i - 1].is_nan();
        let mut twice = (1..values.len()).filter(is_twice);
        if let Some(i) = twice.next() {
            let more = match 1 + twice.count() {
                1 => String::new(),
                n => format!("; {n} times stand twice: are rows there twice?"),
            };
            return bad(format!(
                "column '{name}' has two measurements at time {}: {} and {}{more}",
                Number(time[i]),
                Number(values[i - 1]),
                Number(values[i])
            ));
        }
        Ok(series)
    }
}

impl Column {
    pub(super) fn new(name: String, values: impl Into<Series>) -> Self {
        Self {
            name,
            unit: None,
            contradicting: None,
            values: values.into(),
            converted: None,
            text: None,
            comma: None,
            point: None,
        }
    }

    /// Takes the unit that a line of units states; a dash there leaves the one in the name.
    pub(super) fn state_unit(&mut self, unit: Option<String>, line: usize) {
        let named = parts(&self.name).1;
        let unit = unit.filter(|unit| unit != "-" || named.is_none());
        let other = unit.as_ref().filter(|unit| named.is_some_and(|named| is_contradiction(named, unit)));
        self.contradicting = other.map(|unit| (line, unit.clone()));
        self.unit = unit;
    }

    /// Message about two units, one in the name and one in the line of units.
    pub(super) fn contradiction(&self) -> Option<String> {
        let ((line, below), named) = (self.contradicting.as_ref()?, parts(&self.name).1?);
        Some(format!(
            "column '{}' has two units: '{named}' in its name and '{below}' in line {line}; correct or remove one of them",
            self.name
        ))
    }
}

/// Why the numbers of a column are ambiguous: some in the file have a comma, others a point, and one of the
/// two may separate thousands.
pub(super) fn mixed_decimal_signs(all: &[Column], column: &Column) -> Option<String> {
    let first = |mark: fn(&Column) -> Option<&Cell>| {
        let own = std::iter::once(column).chain(all.iter().filter(|c| c.text.is_none()));
        own.into_iter().find_map(|c| mark(c).map(|cell| (&c.name, cell)))
    };
    let (commas, (line, comma)) = first(|c| c.comma.as_ref())?;
    let (points, (other, point)) = first(|c| c.point.as_ref())?;
    (column.comma.is_some() || column.point.is_some()).then(|| {
        format!(
            "'{comma}' in column '{commas}', line {line}, has a comma and '{point}' in column '{points}', line {other}, a \
             point: write all numbers with one decimal sign and without separators of thousands"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Data {
        let time: Vec<f64> = (0..7).map(|k| 0.1 * f64::from(k)).collect();
        let y = vec![0.0, 1.0, 2.0, f64::NAN, 4.0, f64::NAN, 6.0];
        let valid = vec![1.0, 1.0, 0.0, 1.0, f64::NAN, 1.0, 1.0];
        Data::from_columns(time, [("y [mm]".to_owned(), y), ("valid".to_owned(), valid)]).unwrap()
    }

    #[test]
    fn masks_take_values_away() {
        let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let keep = [true, true, false, true, false, true, true];
        let one = table().masked(&["y"], &keep).unwrap();
        let other = table().masked_by(&["y"], "valid").unwrap();
        let expected = [0.0, 1.0, f64::NAN, f64::NAN, f64::NAN, f64::NAN, 6.0];
        assert_eq!(bits(one.column("y").unwrap()), bits(&expected));
        assert_eq!(bits(other.column("y").unwrap()), bits(&expected));
        for (result, expected) in [
            (table().masked(&["y"], &keep[1..]), "the mask has 6 entries, the table 7 rows"),
            (table().masked(&["y"], &[false; 7]), "keeps no row"),
            (table().masked_by(&["y"], "z"), "no column 'z'"),
        ] {
            assert!(result.unwrap_err().to_string().contains(expected), "{expected}");
        }
    }
}
