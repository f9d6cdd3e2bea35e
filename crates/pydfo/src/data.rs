//! Recordings: what Python asks of the native code while it reads them.

use crate::error;
use calibration::{Data, PairUnit, TimeColumn};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Columns by name, and the names of others.
type Columns = (Vec<(String, Vec<f64>)>, Vec<String>);

/// Position of the column of times among columns of these names, and the length of its unit in s as a fraction.
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

/// Dates and times of day in s since the first; the name of the column may say what two numbers (`10:02`) are.
#[pyfunction]
pub(crate) fn date_seconds(texts: Vec<String>, column: &str) -> PyResult<Vec<f64>> {
    let place = |(row, message): (usize, String)| PyValueError::new_err(format!("row {row}: {message}"));
    calibration::date_seconds(&texts, PairUnit::of_column(column)).map_err(place)
}

/// The times and those columns of a CSV text that are needed, with their units in their names, and the names of the others.
#[pyfunction]
pub(crate) fn read_csv(
    py: Python<'_>,
    text: &[u8],
    source: &str,
    time: Option<&str>,
    needed: Vec<String>,
) -> PyResult<Columns> {
    let bad = |e| error::calibration(py, &e);
    let data = Data::from_csv_text(text, source, time).map_err(bad)?;
    let names: Vec<&str> = data.names().collect();
    let mut columns = vec![("time".to_owned(), data.time().to_vec())];
    let mut taken = Vec::new();
    for wanted in &needed {
        let values = data.column(wanted).map_err(bad)?;
        let Ok(index) = calibration::find_column(names.iter().copied(), wanted) else { continue };
        if !taken.contains(&index) {
            taken.push(index);
            let name = data.name_with_unit(names[index]).unwrap_or_else(|| names[index].to_owned());
            columns.push((name, values.to_vec()));
        }
    }
    let others = names.iter().enumerate().filter(|(index, _)| !taken.contains(index));
    Ok((columns, others.map(|(_, name)| (*name).to_owned()).collect()))
}
