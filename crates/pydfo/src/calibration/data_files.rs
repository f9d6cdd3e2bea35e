//! Recordings: what Python asks of the native code while it reads them.

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

/// Local times before and after, and whether an hour is doubled: see [`ClockChange`].
type Change = (String, String, bool);

/// Position of the column of times among columns of these names, and the length of its unit in s as a
/// fraction.
#[pyfunction]
#[pyo3(signature = (names, time=None))]
pub(crate) fn find_time(names: Vec<String>, time: Option<&str>) -> PyResult<(usize, (f64, f64))> {
    let found = TimeColumn::find(names.iter().map(String::as_str), time);
    found.map(|column| (column.index, column.unit)).map_err(PyValueError::new_err)
}

/// Position of a column that is named in full or without its unit.
#[pyfunction]
pub(crate) fn find_column(names: Vec<String>, wanted: &str) -> PyResult<usize> {
    calibration::find_column(names.iter().map(String::as_str), wanted).map_err(PyValueError::new_err)
}

/// Dates and times of day in s since the first, and what is said about an hour that is missing in them; the
/// name of the column may say what two numbers (`10:02`) are.
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

/// Change of clocks (an hour that is missing or doubled) in times without a zone, in s, of which the first is
/// `start` in s since 1970; `None` if there is none.
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

/// Refuses what is no regular file: the libraries that read it would wait for a named pipe.
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
    /// Columns (an iterator of names and arrays, each of which is needed no longer than the next one) of
    /// which one, `time`, holds the times; the names of others; an hour that is missing in the times; whether
    /// these were dates or durations.
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

    /// The times and those columns of a CSV text that are needed; the names of others that it was made
    /// without.
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

    /// The same, as read from this file, whose hash goes into records.
    fn of_file(&self, py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let watch = InterruptGuard::without_handler(py);
        match watch.run_here(|context| self.inner.clone().of_file(&path, context)) {
            Ok(inner) => Ok(Self { inner }),
            Err(CalibrationError::Cancelled) => Err(watch.interrupted()),
            Err(e) => Err(error::calibration(py, &e)),
        }
    }

    /// One that was pickled.
    #[staticmethod]
    fn restore(state: &[u8]) -> PyResult<Self> {
        let inner = ciborium::from_reader(state).map_err(|e| PyValueError::new_err(e.to_string()))?;
        Ok(Self { inner })
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let state = object::to_bytes(&slf.get().inner)?;
        Ok((slf.get_type().getattr("restore")?, (PyBytes::new(slf.py(), &state),)))
    }

    /// Names of the columns beside the times, also of those that were left out.
    fn names(&self) -> Vec<&str> {
        self.inner.all_names().collect()
    }

    /// Its rows.
    fn __len__(&self) -> usize {
        self.inner.time().len()
    }
}
