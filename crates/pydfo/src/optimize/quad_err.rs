//! `quad_err`: the sum of squared errors as the paper's tool computes it.

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Computes the sum. Rows are quantities; all arrays must be contiguous and of type float64.
#[pyfunction]
#[pyo3(signature = (t_meas, y_meas, t_sim, y_sim, w=None))]
pub(crate) fn quad_err(
    t_meas: PyReadonlyArray1<'_, f64>,
    y_meas: PyReadonlyArray2<'_, f64>,
    t_sim: PyReadonlyArray1<'_, f64>,
    y_sim: PyReadonlyArray2<'_, f64>,
    w: Option<PyReadonlyArray1<'_, f64>>,
) -> PyResult<f64> {
    let measured = rows(&y_meas)?;
    let simulated = rows(&y_sim)?;
    let weights = w.as_ref().map(|w| w.as_slice()).transpose()?;
    calibration::quad_err(t_meas.as_slice()?, &measured, t_sim.as_slice()?, &simulated, weights)
        .map_err(PyValueError::new_err)
}

fn rows<'a>(array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<Vec<&'a [f64]>> {
    let view = array.as_array();
    let (n_rows, n_columns) = view.dim();
    let all = array.as_slice()?;
    Ok((0..n_rows).map(|k| &all[k * n_columns..(k + 1) * n_columns]).collect())
}
