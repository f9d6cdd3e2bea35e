//! Validations, cross-validations and prediction bands of fits, as dicts of what their Python classes hold.

use crate::calibration::experiment::ExperimentFields;
use crate::calibration::fit::PyFit;
use crate::calibration::native::PyCalibration;
use crate::convert::error;
use crate::convert::findings;
use crate::convert::record::PyRecord;
use crate::interrupt::watch::Watch;
use crate::model::inputs::Callbacks;
use crate::model::trajectory::Counts;
use calibration::{
    BandOptions, CalibrationError, CrossValidationOptions, Experiment, Fold, PredictionBand, ValidatedOutput,
    Validation, ValidationSet,
};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};

/// Recordings from the fields of their Python class; errors name the recording where there are several.
fn experiments(
    py: Python<'_>,
    calibration: &PyCalibration,
    given: Vec<ExperimentFields>,
    callbacks: &mut Callbacks,
) -> PyResult<Vec<Experiment>> {
    let is_one = given.len() == 1;
    let of = (calibration.inner.fmu(), &calibration.inner.problem().parameters[..]);
    let made = |(k, mut fields): (usize, ExperimentFields)| {
        let name = fields.name.clone().unwrap_or_else(|| Experiment::default_name(k));
        let resolved = fields.resolve(py, of, callbacks)?;
        let watch = Watch::without_handler(py);
        let made = watch.run_here(|context| fields.experiment(resolved, context));
        if let Err(CalibrationError::Cancelled) = made {
            return Err(watch.interrupted());
        }
        made.map_err(|e| {
            let named = if is_one { e } else { CalibrationError::Experiment { name, source: Box::new(e) } };
            error::calibration(py, &named)
        })
    };
    given.into_iter().enumerate().map(made).collect()
}

/// `Fit.validate`: on other recordings where there are some, else in these windows.
#[pyfunction]
pub(crate) fn validate<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    fit: &PyFit,
    windows: Vec<(f64, f64)>,
    experiments: Option<Vec<ExperimentFields>>,
) -> PyResult<Bound<'py, PyDict>> {
    let mut callbacks = Callbacks::default();
    let set = match experiments {
        Some(given) => ValidationSet::Experiments(self::experiments(py, calibration, given, &mut callbacks)?),
        None => ValidationSet::Windows(windows),
    };
    let fit = fit.inner.clone();
    let validation =
        calibration.compute(py, move |calibration, context| calibration.validate(&fit, &set, context));
    // An exception of an input function is why the simulation failed.
    if let Some(e) = callbacks.take_raised() {
        return Err(e);
    }
    to_python(py, &validation?)
}

/// The fields of `pydfo.Validation`.
pub(crate) fn to_python<'py>(py: Python<'py>, validation: &Validation) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    let values = PyDict::new(py);
    for (name, value) in validation.names.iter().zip(&validation.x) {
        values.set_item(name, value)?;
    }
    fields.set_item("parameters", values)?;
    fields.set_item("n", validation.n)?;
    fields.set_item("rms", validation.rms)?;
    fields.set_item("start_rms", validation.start_rms)?;
    fields.set_item("scaled_rms", validation.scaled_rms())?;
    fields.set_item("n_simulations", validation.n_simulations)?;
    fields.set_item("stats", Counts::new(&validation.stats))?;
    fields.set_item("text", validation.to_string())?;
    fields.set_item("findings", findings::fields(validation.findings.clone()))?;
    let outputs = validation.outputs.iter().map(|output| of_output(py, output));
    fields.set_item("outputs", outputs.collect::<PyResult<Vec<_>>>()?)?;
    Ok(fields)
}

/// The fields of `pydfo.ValidatedOutput`.
fn of_output<'py>(py: Python<'py>, output: &ValidatedOutput) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    fields.set_item("experiment", &output.fit.experiment)?;
    fields.set_item("variable", &output.fit.variable)?;
    fields.set_item("column", &output.fit.column)?;
    fields.set_item("unit", &output.fit.unit)?;
    fields.set_item("n", output.fit.n)?;
    fields.set_item("rms", output.fit.rms)?;
    fields.set_item("start_rms", output.fit.start_rms)?;
    fields.set_item("fit_percent", output.fit.fit_percent)?;
    fields.set_item("time", PyArray1::from_slice(py, &output.times))?;
    fields.set_item("measured", PyArray1::from_slice(py, &output.measured))?;
    fields.set_item("simulated", PyArray1::from_vec(py, output.simulated()))?;
    fields.set_item("residuals", PyArray1::from_slice(py, &output.residuals))?;
    let at_start = output.start_residuals.as_deref().map(|r| PyArray1::from_slice(py, r));
    fields.set_item("start_residuals", at_start)?;
    Ok(fields)
}

/// `Calibration.cross_validate`.
#[pyfunction]
pub(crate) fn cross_validate<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    asked: PyRecord,
) -> PyResult<Bound<'py, PyDict>> {
    let n_parameters = calibration.inner.parameters().len();
    let options = CrossValidationOptions::asked(asked.values.clone(), n_parameters);
    let options = options.map_err(|e| asked.error(py, &e))?;
    let found =
        calibration.compute(py, move |calibration, context| calibration.cross_validate(&options, context))?;
    let fields = PyDict::new(py);
    let of_fold = |fold: &Fold| {
        let fields = PyDict::new(py);
        let values = fold.fit.names.iter().zip(&fold.fit.x);
        fields.set_item("held_out", &fold.held_out)?;
        fields.set_item("parameters", values.into_py_dict(py)?)?;
        fields.set_item("fit_rms", fold.fit_rms)?;
        fields.set_item("nfev", fold.fit.report.n_evaluations)?;
        fields.set_item("success", fold.fit.report.is_success())?;
        fields.set_item("message", &fold.fit.report.message)?;
        fields.set_item("validation", to_python(py, &fold.validation)?)?;
        Ok(fields)
    };
    fields.set_item("folds", found.folds.iter().map(of_fold).collect::<PyResult<Vec<_>>>()?)?;
    fields.set_item("unfinished", &found.unfinished)?;
    fields.set_item("rms", found.rms)?;
    let spread = found.parameters.iter().map(|(name, mean, spread)| (name, (*mean, *spread)));
    fields.set_item("parameters", spread.into_py_dict(py)?)?;
    fields.set_item("stats", Counts::new(&found.stats))?;
    fields.set_item("text", found.to_string())?;
    Ok(fields)
}

/// `Fit.prediction_band`: per experiment and output, to an extent of a level and whether it is corrected for
/// autocorrelated residuals.
#[pyfunction]
pub(crate) fn prediction_bands<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    fit: &PyFit,
    times: Option<Vec<f64>>,
    extent: (f64, bool),
    outputs: Option<Vec<String>>,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let fit = fit.inner.clone();
    let (level, is_corrected) = extent;
    let options = BandOptions { times, level, is_corrected, outputs, workers: None };
    let bands = calibration
        .compute(py, move |calibration, context| calibration.prediction_bands(&fit, &options, context))?;
    let to_python = |band: PredictionBand| {
        let fields = PyDict::new(py);
        fields.set_item("experiment", band.experiment)?;
        fields.set_item("variable", band.variable)?;
        fields.set_item("unit", band.unit)?;
        fields.set_item("noise", band.noise)?;
        for (name, values) in [
            ("time", band.times),
            ("value", band.values),
            ("standard_error", band.standard_errors),
            ("lower", band.lower),
            ("upper", band.upper),
            ("measured_lower", band.measured_lower),
            ("measured_upper", band.measured_upper),
        ] {
            fields.set_item(name, PyArray1::from_vec(py, values))?;
        }
        Ok(fields)
    };
    bands.into_iter().map(to_python).collect()
}
