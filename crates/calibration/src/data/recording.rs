//! Table of recorded series with a time column, irregular times and missing values.

use super::clock_change::{ClockChange, DAY};
use super::series::{Series, sampling_interval};
use super::time_column::{SECOND, TimeColumn, TimeUnit, find_column, is_contradiction, parts};
use super::units::UnitConversion;
use crate::error::CalibrationError;
use base::{Number, RunContext};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::Read;
use std::ops::Range;
use std::path::Path;

/// Table of recorded series with one time column.
///
/// Times ascend. A time may occur twice if an input jumps there, but not three times. A missing value is NaN.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Data {
    pub(super) source: String,
    pub(super) time_name: String,
    pub(super) time: Series,
    pub(super) columns: Vec<Column>,
    /// Names of unread columns.
    pub(super) left_out: Vec<String>,
    /// True if the recording states the unit of its times. Otherwise, they count as the model does.
    #[serde(default)]
    states_time_unit: bool,
    /// Unit of the times; `None` for s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    time_unit: Option<TimeUnit>,
    /// Times as written and the length of their unit, until they are in the unit of the model. A conversion
    /// to s and back would round them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) written: Option<(Series, (f64, f64))>,
    /// First date as text in the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    first_date: Option<String>,
    /// Missing hour in times without a zone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    clock_change: Option<ClockChange>,
    /// Length of the intervals if the rows are means over intervals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) resampled: Option<f64>,
    /// Source of the mask of measurements: a column, or a value for each row.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mask: Option<String>,
    /// SHA-256 of the source file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) file_hash: Option<String>,
}

/// New values by the bits of the time and of the old value.
pub(crate) type NewValues = BTreeMap<(u64, u64), f64>;

/// Description of a table without its numbers.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct DataSummary<'d> {
    /// Origin of the table.
    pub(crate) source: &'d str,
    /// SHA-256 of the source file.
    pub(crate) file_sha256: Option<&'d str>,
    /// SHA-256 of the compared names and values, after the mask and the means.
    pub(crate) fingerprint: String,
    pub(crate) n_rows: usize,
    /// Name of the time column. `from` and `to` are its first and last value.
    pub(crate) time: &'d str,
    pub(crate) from: Option<f64>,
    pub(crate) to: Option<f64>,
    pub(crate) columns: Vec<&'d str>,
    /// Source of the mask of measurements.
    pub(crate) mask: Option<&'d str>,
    /// Length of the intervals of the means.
    pub(crate) resample: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Column {
    pub(super) name: String,
    /// Unit of the values if it differs from the unit in the name. It comes from a line of units or a
    /// conversion.
    pub(super) unit: Option<String>,
    /// Unit in the line of units if it contradicts the unit in the name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    contradicting: Option<Cell>,
    pub(super) values: Series,
    /// Conversion of the values, and their original unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    converted: Option<(UnitConversion, Option<String>)>,
    /// First cell that is not a number.
    pub(super) text: Option<Cell>,
    /// First numbers with a comma and with a point.
    pub(super) comma: Option<Cell>,
    pub(super) point: Option<Cell>,
}

/// Maximum gap for interpolation, in sampling intervals.
const WIDEST_GAP: f64 = 10.0;

/// Number of bytes that are hashed between two checks for cancellation (1 ms).
const HASHED_AT_ONCE: usize = 1 << 20;

/// Returns a hash in hexadecimal.
pub(super) fn hex(hasher: Sha256) -> String {
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Cell of a file: its line, counted from 1, and its text.
type Cell = (usize, String);

impl Data {
    /// Creates a table from columns in memory. The time column is `time` as in a [CSV file](Self::from_csv),
    /// or the column with the given name.
    ///
    /// # Errors
    /// Returns an error if there is no time column, the columns differ in length, or times are not finite or
    /// not ascending.
    pub fn from_table<S: Into<Series>>(
        columns: impl IntoIterator<Item = (String, S)>,
        time: Option<&str>,
    ) -> Result<Self, CalibrationError> {
        let columns = columns.into_iter().map(|(name, values)| (name, values.into()));
        let mut columns: Vec<(String, Series)> = columns.collect();
        let found = TimeColumn::find(columns.iter().map(|(name, _)| name.as_str()), time);
        let found =
            found.map_err(|message| CalibrationError::Data { source_name: "data".to_owned(), message })?;
        let times = columns.remove(found.index);
        let columns = columns.into_iter().map(|(name, values)| Column::new(name, values)).collect();
        Self::in_column("data".to_owned(), times, found, columns, |row| format!("row {row}"))
    }

    /// Creates a table from the name and the numbers of its time column. Times with a stated unit are
    /// converted to s.
    pub(super) fn in_column(
        source: String,
        (name, written): (String, Series),
        column: TimeColumn,
        columns: Vec<Column>,
        place: impl Fn(usize) -> String,
    ) -> Result<Self, CalibrationError> {
        let length = column.unit.filter(|(numerator, denominator)| numerator != denominator);
        let times = match length {
            Some(_) => written.iter().map(|t| column.seconds(*t)).collect(),
            None => written.clone(),
        };
        let data = Self::new(source, name, times, columns, place)?;
        let states_time_unit = column.unit.is_some();
        Ok(Self { states_time_unit, written: length.map(|length| (written, length)), ..data })
    }

    /// Returns the unit of the times: s, or the time unit of the model after
    /// [`Calibration::from_problem`](crate::Calibration::from_problem).
    pub fn time_unit(&self) -> &str {
        self.time_unit.as_ref().map_or(SECOND, |unit| &unit.name)
    }

    /// True if the unit of the times is stated, or if they are dates or durations.
    pub(crate) fn states_time_unit(&self) -> bool {
        self.states_time_unit
    }

    /// Converts the times to the time unit of the model. Times without a stated unit already are in this
    /// unit.
    ///
    /// # Errors
    /// Returns an error if the times state a unit, but the unit of the model is not a unit of time.
    pub(crate) fn convert_times(&mut self, unit: &TimeUnit) -> Result<(), CalibrationError> {
        let own = self.time_unit.take().unwrap_or_else(TimeUnit::second);
        if self.states_time_unit && own != *unit {
            let Some((from, to)) = own.length.zip(unit.length) else {
                return Err(CalibrationError::Data {
                    source_name: self.source.clone(),
                    message: format!(
                        "the times are in {}, but the model counts its independent variable in '{}', which is not a unit of time. Set \
                         time_unit to the time unit of the model, or remove the unit from the column '{}'",
                        own.name, unit.name, self.time_name
                    ),
                });
            };
            let (written, from) = self.written.take().unwrap_or_else(|| (self.time.clone(), from));
            let (numerator, denominator) = (from.0 * to.1, from.1 * to.0);
            self.time = match numerator == denominator {
                true => written,
                false => written.iter().map(|t| t * numerator / denominator).collect(),
            };
        }
        self.written = None;
        self.time_unit = Some(unit.clone()).filter(|unit| unit.name != SECOND);
        Ok(())
    }

    /// Returns the table as if the recording stated that its times are in this unit.
    pub(crate) fn with_times_in(self, unit: TimeUnit) -> Self {
        Self { states_time_unit: true, time_unit: Some(unit), ..self }
    }

    /// Repeats the checks of the constructor, because deserialized data may be invalid.
    pub(crate) fn check(&self) -> Result<(), CalibrationError> {
        let Self { source, time_name, time, columns, .. } = self.clone();
        Self::new(source, time_name, time, columns, |row| format!("row {row}")).map(|_| ())
    }

    /// Adds the names of columns of the recording that this table does not contain. A
    /// [warning](crate::SetupWarning) may refer to them.
    #[must_use]
    pub fn left_out(mut self, names: impl IntoIterator<Item = String>) -> Self {
        self.left_out.extend(names);
        self
    }

    /// Sets the missing hour in the times of a clock without a zone, which a [warning](crate::SetupWarning)
    /// reports.
    #[must_use]
    pub fn with_clock_change(mut self, change: Option<ClockChange>) -> Self {
        self.clock_change = change;
        self
    }

    /// Sets the file that the table was read from, if it was not a [CSV file](Self::read_csv). The path
    /// becomes its [source](Self::source), and a record of a fit contains the current hash of the file.
    ///
    /// # Errors
    /// Returns [`CalibrationError::DataFile`] if the file cannot be read, or [`CalibrationError::Cancelled`].
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

    /// Sets whether the times were dates or durations, which have been converted to s.
    #[must_use]
    pub fn with_dates(self, has_dates: bool) -> Self {
        Self { states_time_unit: self.states_time_unit || has_dates, ..self }
    }

    /// Sets the first date as text in the file.
    #[must_use]
    pub(super) fn with_first_date(self, first_date: Option<String>) -> Self {
        Self { first_date, ..self }
    }

    pub(crate) fn first_date(&self) -> Option<&str> {
        self.first_date.as_deref()
    }

    /// Returns the missing hour in the times.
    pub(crate) fn clock_change(&self) -> Option<&ClockChange> {
        self.clock_change.as_ref()
    }

    /// Returns the names of all columns except the time. Unread columns come last.
    pub fn all_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.names().chain(self.left_out.iter().map(String::as_str))
    }

    /// Returns the median spacing of the times.
    pub(crate) fn sampling_interval(&self) -> Option<f64> {
        sampling_interval(&self.time)
    }

    /// Creates a table from columns in memory, all with the length of `time`.
    ///
    /// # Errors
    /// Returns an error if the columns differ in length, or if times are not finite or not ascending.
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
            return bad("the recording has no rows".to_owned());
        }
        for column in &columns {
            if column.values.len() != time.len() {
                return bad(format!(
                    "column '{}' has {} values, but '{time_name}' has {}",
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
                // The time goes back by nearly a day.
                let hint = match time[i - 1] - t {
                    back if (0.5..=1.0).contains(&(back / DAY)) => {
                        ". If a clock passed midnight, write the date with each time, or add 24 h after it"
                    }
                    _ => "",
                };
                return bad(format!(
                    "time {} at {} follows {}, but times must ascend{hint}",
                    Number(*t),
                    place(i),
                    Number(time[i - 1])
                ));
            }
        }
        if time.len() > 1 && time[0] == time[time.len() - 1] {
            return bad(format!(
                "all {} rows have the time {} in '{time_name}'. Choose the column of the times; for replicates at a single time, add a \
                 row with the start time and empty cells",
                time.len(),
                Number(time[0])
            ));
        }
        Ok(Self {
            source,
            time_name,
            time,
            columns,
            left_out: Vec::new(),
            states_time_unit: false,
            time_unit: None,
            written: None,
            first_date: None,
            clock_change: None,
            resampled: None,
            mask: None,
            file_hash: None,
        })
    }

    /// Returns the source of the table, as shown in errors.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// Returns a hash of the names and values, independent of their source.
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

    /// Returns a description without the numbers.
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

    /// Returns the times.
    pub fn time(&self) -> &[f64] {
        &self.time
    }

    /// Returns the shared times.
    pub(crate) fn time_series(&self) -> &Series {
        &self.time
    }

    /// Returns the names of the columns except the time, in their order.
    pub fn names(&self) -> impl Iterator<Item = &str> + Clone {
        self.columns.iter().map(|c| c.name.as_str())
    }

    /// Returns a column by name, with NaN for missing values. The name may omit the unit, so `phi` finds
    /// `phi [deg]`.
    ///
    /// # Errors
    /// Returns an error if there is no such column, a cell is not a number, or a value is infinite. If there
    /// is no such column, the message lists the columns.
    pub fn column(&self, name: &str) -> Result<&[f64], CalibrationError> {
        self.series(name).map(|values| &values[..])
    }

    /// Returns the shared values of a [`column`](Self::column).
    pub(crate) fn series(&self, name: &str) -> Result<&Series, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        let Some(index) = self.position(name)? else { return Ok(&self.time) };
        let column = &self.columns[index];
        let name = &column.name;
        if let Some((line, text)) = &column.text {
            return Err(bad(format!(
                "'{text}' in column '{name}', line {line}, is not a number. Write missing values as empty cells, NaN, NA, N/A or null"
            )));
        }
        if let Some(message) = mixed_decimal_signs(&self.columns, column) {
            return Err(bad(message));
        }
        if let Some(row) = column.values.iter().position(|v| v.is_infinite()) {
            return Err(bad(format!(
                "column '{name}' is infinite or above 1.8e308 at time {}",
                self.time[row]
            )));
        }
        Ok(&column.values)
    }

    /// Returns the index of a column, or `None` for the time column.
    fn position(&self, name: &str) -> Result<Option<usize>, CalibrationError> {
        if name == self.time_name {
            return Ok(None);
        }
        let message = match find_column(self.all_names(), name) {
            Ok(index) if index < self.columns.len() => return Ok(Some(index)),
            Ok(_) => format!("column '{name}' was omitted"),
            Err(message) => message,
        };
        Err(CalibrationError::Data { source_name: self.source.clone(), message })
    }

    /// Returns the unit of a column, if it is declared in brackets or parentheses after its name or in a line
    /// of units. After [`Calibration::from_problem`](crate::Calibration::from_problem), it is the unit of the
    /// variable to which the column was converted.
    pub fn unit(&self, column: &str) -> Option<&str> {
        let column = &self.columns[self.position(column).ok()??];
        column.unit.as_deref().or_else(|| parts(&column.name).1)
    }

    /// Returns the name of a column. If the unit comes from a line of units, it is appended in brackets.
    pub fn name_with_unit(&self, column: &str) -> Option<String> {
        let column = &self.columns[self.position(column).ok()??];
        let name = || parts(&column.name).0;
        Some(column.unit.as_ref().map_or_else(|| column.name.clone(), |unit| format!("{} [{unit}]", name())))
    }

    /// Returns the unit of a column if it is not part of its name: from a line of units, or after a
    /// conversion.
    pub(crate) fn unit_beside_name(&self, column: &str) -> Option<&str> {
        self.columns[self.position(column).ok()??].unit.as_deref()
    }

    /// Returns an error if the name of a column and the line of units declare different units.
    pub(crate) fn check_units(&self, column: &str) -> Result<(), CalibrationError> {
        let Some(index) = self.position(column)? else { return Ok(()) };
        let bad = |message| CalibrationError::Data { source_name: self.source.clone(), message };
        self.columns[index].contradiction().map_or(Ok(()), |message| Err(bad(message)))
    }

    /// Marks the values of these columns as missing in the rows where `keep` is false. Do not use it for
    /// inputs, which are interpolated between the remaining rows.
    ///
    /// # Errors
    /// Returns an error if there is no such column, or if `keep` differs in length from the table or is false
    /// throughout.
    pub fn masked(mut self, columns: &[&str], keep: &[bool]) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        if keep.len() != self.time.len() {
            return Err(bad(format!(
                "the mask has {} entries, but the table has {} rows",
                keep.len(),
                self.time.len()
            )));
        }
        if !keep.contains(&true) {
            return Err(
                bad("the mask excludes all rows. It must be true for the rows that count".to_owned()),
            );
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

    /// Masks columns as [`masked`](Self::masked) does. A row counts if the column `by` is neither 0 nor
    /// missing.
    ///
    /// # Errors
    /// Returns the errors of [`masked`](Self::masked) and [`column`](Self::column).
    pub fn masked_by(self, columns: &[&str], by: &str) -> Result<Self, CalibrationError> {
        let keep: Vec<bool> = self.column(by)?.iter().map(|v| !v.is_nan() && *v != 0.0).collect();
        let mut masked = self.masked(columns, &keep)?;
        masked.mask = masked.mask.map(|rows| format!("column '{by}': {rows}"));
        Ok(masked)
    }

    /// Returns the full name of a column, including a unit that is part of it.
    pub(crate) fn full_name(&self, column: &str) -> Option<&str> {
        Some(&self.columns[self.position(column).ok()??].name)
    }

    /// Replaces the values of a column at these times and old values, given by their bits.
    pub(crate) fn replace(&mut self, column: &str, values: &NewValues) {
        if let Ok(Some(index)) = self.position(column) {
            let rows = self.columns[index].values.to_mut().iter_mut().zip(self.time.iter());
            for (value, time) in rows {
                if let Some(new) = values.get(&(time.to_bits(), value.to_bits())) {
                    *value = *new;
                }
            }
        }
    }

    /// Converts a column to `unit`.
    pub(crate) fn convert(&mut self, column: &str, conversion: UnitConversion, unit: &str) {
        if let Ok(Some(index)) = self.position(column) {
            let column = &mut self.columns[index];
            column.values.to_mut().iter_mut().for_each(|value| *value = conversion.apply(*value));
            let given = column.unit.take().or_else(|| parts(&column.name).1.map(str::to_owned));
            column.converted = Some((conversion, given));
            column.unit = Some(unit.to_owned());
        }
    }

    /// Returns a value of a column before its conversion, up to rounding, and its original unit.
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

    /// Returns the value of a column at a time, by linear interpolation between the known values on both
    /// sides. They must be at most `WIDEST_GAP` sampling intervals of the known values apart.
    ///
    /// # Errors
    /// Returns the errors of [`column`](Self::column). Also returns an error if the time is outside the known
    /// values or in a wider gap.
    pub(crate) fn value_at(&self, column: &str, time: f64) -> Result<f64, CalibrationError> {
        let values = self.column(column)?;
        let samples: Vec<(f64, f64)> =
            self.time.iter().copied().zip(values.iter().copied()).filter(|(_, v)| !v.is_nan()).collect();
        let unit = self.time_unit();
        let bad = |found: String| {
            let message = format!("column '{column}' has no value at {} {unit}{found}", Number(time));
            Err(CalibrationError::Data { source_name: self.source.clone(), message })
        };
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return bad(": all are missing".to_owned());
        };
        let tolerance = base::time_tolerance(first.0.min(time), last.0.max(time));
        if let Some((_, value)) = samples.iter().find(|(t, _)| (t - time).abs() <= tolerance) {
            return Ok(*value);
        }
        let after = samples.partition_point(|(t, _)| *t <= time);
        if after == 0 {
            return bad(format!(". The first value is at {} {unit}", Number(first.0)));
        }
        let (Some((t0, v0)), Some((t1, v1))) = (samples.get(after - 1), samples.get(after)) else {
            return bad(format!(". The last value is at {} {unit}", Number(last.0)));
        };
        let times: Vec<f64> = samples.iter().map(|(t, _)| *t).collect();
        let rounding = (WIDEST_GAP + 1.0) * tolerance;
        if sampling_interval(&times).is_some_and(|usual| t1 - t0 > WIDEST_GAP * usual + rounding) {
            return bad(format!(
                ". Values are missing from {} {unit} to {} {unit}",
                Number(*t0),
                Number(*t1)
            ));
        }
        Ok(v0 + (v1 - v0) * (time - t0) / (t1 - t0))
    }

    /// Returns a measured column, which has at least one value in these rows. Several values at one time are
    /// replicates.
    ///
    /// # Errors
    /// Returns the errors of [`column`](Self::column). Also returns an error if all values are missing.
    ///
    /// # Panics
    /// Panics if `rows` exceeds the table.
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

    /// Sets the unit from a line of units. A dash keeps the unit in the name.
    pub(super) fn state_unit(&mut self, unit: Option<String>, line: usize) {
        let named = parts(&self.name).1;
        let unit = unit.filter(|unit| unit != "-" || named.is_none());
        let other = unit.as_ref().filter(|unit| named.is_some_and(|named| is_contradiction(named, unit)));
        self.contradicting = other.map(|unit| (line, unit.clone()));
        self.unit = unit;
    }

    /// Returns the message about different units in the name and in the line of units.
    pub(super) fn contradiction(&self) -> Option<String> {
        let ((line, below), named) = (self.contradicting.as_ref()?, parts(&self.name).1?);
        Some(format!(
            "column '{}' has two units, '{named}' in its name and '{below}' in line {line}. Correct or remove one of them",
            self.name
        ))
    }
}

/// Returns the reason why the numbers of a column are ambiguous. In this case, some numbers of the file
/// contain a comma and others a point, and one of them may separate thousands.
pub(super) fn mixed_decimal_signs(all: &[Column], column: &Column) -> Option<String> {
    let first = |mark: fn(&Column) -> Option<&Cell>| {
        let columns = std::iter::once(column).chain(all.iter().filter(|c| c.text.is_none()));
        columns.into_iter().find_map(|c| mark(c).map(|cell| (&c.name, cell)))
    };
    let (commas, (line, comma)) = first(|c| c.comma.as_ref())?;
    let (points, (other, point)) = first(|c| c.point.as_ref())?;
    (column.comma.is_some() || column.point.is_some()).then(|| {
        format!(
            "'{comma}' in column '{commas}', line {line}, has a comma, but '{point}' in column '{points}', line {other}, has a \
             point. Write all numbers with one decimal sign and without thousands separators"
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
    fn masks_remove_values() {
        let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let keep = [true, true, false, true, false, true, true];
        let one = table().masked(&["y"], &keep).unwrap();
        let other = table().masked_by(&["y"], "valid").unwrap();
        let expected = [0.0, 1.0, f64::NAN, f64::NAN, f64::NAN, f64::NAN, 6.0];
        assert_eq!(bits(one.column("y").unwrap()), bits(&expected));
        assert_eq!(bits(other.column("y").unwrap()), bits(&expected));
        for (result, expected) in [
            (table().masked(&["y"], &keep[1..]), "the mask has 6 entries, but the table has 7 rows"),
            (table().masked(&["y"], &[false; 7]), "excludes all rows"),
            (table().masked_by(&["y"], "z"), "column 'z' not found"),
        ] {
            assert!(result.unwrap_err().to_string().contains(expected), "{expected}");
        }
    }
}
