//! Functions for reading recordings that Python calls.

use crate::convert::error;
use crate::convert::object;
use crate::interrupt::interrupt_guard::InterruptGuard;
use calibration::RunContext;
use calibration::{CalibrationError, ClockChange, CsvRequest, Data, DateError, PairUnit, Series, TimeColumn};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;

/// Local times before and after the change, and whether an hour is repeated: see [`ClockChange`].
type Change = (String, String, bool);

/// Returns the position of the time column among columns of these names, and the length of its unit in s as a
/// fraction, if it states one.
#[pyfunction]
#[pyo3(signature = (names, time=None))]
pub(crate) fn find_time(names: Vec<String>, time: Option<&str>) -> PyResult<(usize, Option<(f64, f64)>)> {
    let found = TimeColumn::find(names.iter().map(String::as_str), time);
    found.map(|column| (column.index, column.unit)).map_err(PyValueError::new_err)
}

/// Returns the position of a column by its full name or by its name without the unit.
#[pyfunction]
pub(crate) fn find_column(names: Vec<String>, wanted: &str) -> PyResult<usize> {
    calibration::find_column(names.iter().map(String::as_str), wanted).map_err(PyValueError::new_err)
}

/// Converts dates and times of day to s since the first one. Also returns the clock change (a missing hour),
/// if any. The name of the column can determine the meaning of two numbers (`10:02`).
#[pyfunction]
pub(crate) fn date_seconds<'py>(
    py: Python<'py>,
    texts: Vec<String>,
    column: &str,
) -> PyResult<(Bound<'py, PyArray1<f64>>, Option<Change>)> {
    let pair = PairUnit::of_column(column);
    let watch = InterruptGuard::without_handler(py);
    match watch.run_here(|context| calibration::date_seconds(&texts, pair, context)) {
        Ok((seconds, change)) => Ok((PyArray1::from_vec(py, seconds), change.map(fields))),
        Err(DateError::Cell(row, message)) => Err(at_row(row, &message)),
        Err(DateError::Cancelled) => Err(watch.interrupted()),
    }
}

/// Finds a clock change (a missing or repeated hour) in times without a zone. The times are in s, and the
/// first is `start` in s since 1970. Returns `None` if there is no change.
#[pyfunction]
pub(crate) fn clock_change(start: f64, times: PyReadonlyArray1<'_, f64>) -> PyResult<Option<Change>> {
    match calibration::clock_change(start, times.as_slice()?) {
        Ok(change) => Ok(change.map(fields)),
        Err((row, change)) => Err(at_row(row, &change.to_string())),
    }
}

fn fields(change: ClockChange) -> Change {
    (change.from, change.to, change.is_doubled)
}

fn at_row(row: usize, message: &str) -> PyErr {
    PyValueError::new_err(format!("row {row}: {message}"))
}

/// Raises an error if the path is not a regular file, because the reading libraries would wait for a named
/// pipe.
#[pyfunction]
pub(crate) fn check_regular(py: Python<'_>, path: PathBuf) -> PyResult<()> {
    match py.detach(|| base::files::open_regular(&path)) {
        Ok(_) => Ok(()),
        Err(source) => Err(error::calibration(py, &CalibrationError::DataFile { path, source })),
    }
}

/// A recording in memory.
#[pyclass(frozen, eq, module = "pydfo._core", name = "Table")]
#[derive(PartialEq)]
pub(crate) struct PyTable {
    pub(crate) inner: Data,
}

#[pymethods]
impl PyTable {
    /// Creates a recording. `columns` is an iterator of names and arrays; each array is needed only until the
    /// next one is requested. `time` is the name of the time column and `left_out` contains the names of
    /// other columns. `clock_change`: a missing hour in the times. `has_dates`: true if the times were dates
    /// or durations.
    #[new]
    fn new(
        py: Python<'_>,
        columns: &Bound<'_, PyAny>,
        time: &str,
        left_out: Vec<String>,
        clock_change: Option<Change>,
        has_dates: bool,
    ) -> PyResult<Self> {
        let column = |item: PyResult<Bound<'_, PyAny>>| {
            py.check_signals()?;
            let (name, values): (String, PyReadonlyArray1<'_, f64>) = item?.extract()?;
            Ok((name, Series::from(values.as_slice()?)))
        };
        let columns = columns.try_iter()?.map(column).collect::<PyResult<Vec<_>>>()?;
        let change = clock_change.map(|(from, to, is_doubled)| ClockChange { from, to, is_doubled });
        let made = py.detach(|| Data::from_table(columns, Some(time)));
        let inner = made.map_err(|e| error::calibration(py, &e))?;
        Ok(Self { inner: inner.left_out(left_out).with_clock_change(change).with_dates(has_dates) })
    }

    /// Creates a recording from the times and the needed columns of a CSV text. `left_out` contains the names
    /// of the columns that it omits.
    #[staticmethod]
    fn from_csv(
        py: Python<'_>,
        text: &[u8],
        source: &str,
        time: Option<&str>,
        needed: Vec<String>,
        left_out: Vec<String>,
    ) -> PyResult<Self> {
        let watch = InterruptGuard::without_handler(py);
        let read = |context: &RunContext<'_>| {
            Data::read_csv_text(text, source, CsvRequest { time, columns: Some(&needed), context: *context })
        };
        match watch.run_here(read) {
            Ok(inner) => Ok(Self { inner: inner.left_out(left_out) }),
            Err(CalibrationError::Cancelled) => Err(watch.interrupted()),
            Err(e) => Err(error::calibration(py, &e)),
        }
    }

    /// Returns a copy of this recording, read from a file. Records then contain the hash of the file.
    fn of_file(&self, py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let watch = InterruptGuard::without_handler(py);
        match watch.run_here(|context| self.inner.clone().of_file(&path, context)) {
            Ok(inner) => Ok(Self { inner }),
            Err(CalibrationError::Cancelled) => Err(watch.interrupted()),
            Err(e) => Err(error::calibration(py, &e)),
        }
    }

    /// Restores a pickled recording.
    #[staticmethod]
    fn restore(state: &[u8]) -> PyResult<Self> {
        let inner = ciborium::from_reader(state).map_err(|e| PyValueError::new_err(e.to_string()))?;
        Ok(Self { inner })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let state = object::to_bytes(&slf.get().inner)?;
        Ok((slf.get_type().getattr("restore")?, (PyBytes::new(slf.py(), &state),)))
    }

    /// Names of the columns other than the times, including the omitted ones.
    fn names(&self) -> Vec<&str> {
        self.inner.all_names().collect()
    }

    /// Number of rows.
    fn __len__(&self) -> usize {
        self.inner.time().len()
    }
}
