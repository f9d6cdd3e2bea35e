//! Validations, cross-validations and prediction bands of fits, as dicts with the fields of their Python
//! classes.

use crate::calibration::calibration_class::PyCalibration;
use crate::calibration::experiment::ExperimentFields;
use crate::calibration::fit::PyFit;
use crate::convert::dict::dict;
use crate::convert::error;
use crate::convert::object;
use crate::convert::record::PyRecord;
use crate::interrupt::interrupt_guard::InterruptGuard;
use crate::model::inputs::Callbacks;
use crate::model::trajectory::Counts;
use calibration::{
    BandOptions, Calibration, CalibrationError, CrossValidationOptions, Experiment, Fold, Validation,
    ValidationSet,
};
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict};

/// Creates experiments from the fields of their Python class. Errors contain the name of the recording if
/// there are several.
fn experiments(
    py: Python<'_>,
    calibration: &Calibration,
    given: Vec<ExperimentFields>,
    callbacks: &mut Callbacks,
) -> PyResult<Vec<Experiment>> {
    let is_one = given.len() == 1;
    let (fmu, parameters) = (calibration.fmu(), &calibration.problem().parameters);
    let made = |(k, mut fields): (usize, ExperimentFields)| {
        let name = fields.name.clone().unwrap_or_else(|| Experiment::default_name(k));
        let resolved = fields.resolve(py, fmu, parameters, callbacks)?;
        let watch = InterruptGuard::without_handler(py);
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

/// Implements `Fit.validate`: on other recordings if given, otherwise in these windows.
#[pyfunction]
pub(crate) fn validate<'py>(
    py: Python<'py>,
    fit: &PyFit,
    windows: Vec<(f64, f64)>,
    experiments: Option<Vec<ExperimentFields>>,
) -> PyResult<Bound<'py, PyDict>> {
    let mut callbacks = Callbacks::default();
    let set = match experiments {
        Some(given) => {
            ValidationSet::Experiments(self::experiments(py, &fit.calibration.inner, given, &mut callbacks)?)
        }
        None => ValidationSet::Windows(windows),
    };
    let validation =
        fit.compute(py, move |calibration, fit, context| calibration.validate(fit, &set, context));
    // An exception of an input function is the reason why the simulation failed.
    if let Some(e) = callbacks.take_raised() {
        return Err(e);
    }
    to_python(py, &validation?)
}

/// Returns the fields of `pydfo.Validation`.
fn to_python<'py>(py: Python<'py>, validation: &Validation) -> PyResult<Bound<'py, PyDict>> {
    let fields = object::with_text(py, validation)?;
    fields.update(dict!(py;; "stats": Counts::new(&validation.stats)).as_mapping())?;
    Ok(fields)
}

/// Implements `Calibration.cross_validate`.
#[pyfunction]
pub(crate) fn cross_validate<'py>(
    py: Python<'py>,
    calibration: &PyCalibration,
    requested: PyRecord,
) -> PyResult<Bound<'py, PyDict>> {
    let n_parameters = calibration.inner().parameters().len();
    let options = CrossValidationOptions::from_record(requested.values.clone(), n_parameters);
    let options = options.map_err(|e| requested.error(py, &e))?;
    let found = calibration.shared.compute(py, move |c, context| c.cross_validate(&options, context))?;
    let of_fold = |fold: &Fold| {
        Ok(dict!(py;
            fold => held_out, fit_rms;
            "parameters": fold.fit.names.iter().zip(&fold.fit.x).into_py_dict(py)?,
            "nfev": fold.fit.report.n_evaluations,
            "success": fold.fit.is_success(),
            "message": &fold.fit.report.message,
            "validation": to_python(py, &fold.validation)?,
        ))
    };
    let spread = found.parameters.iter().map(|(name, mean, spread)| (name, (*mean, *spread)));
    Ok(dict!(py;
        found => unfinished, rms;
        "folds": found.folds.iter().map(of_fold).collect::<PyResult<Vec<_>>>()?,
        "parameters": spread.into_py_dict(py)?,
        "stats": Counts::new(&found.stats),
        "text": found.to_string(),
    ))
}

/// Implements `Fit.prediction_band`, per experiment and output. `extent`: level, and correction for
/// autocorrelated residuals.
#[pyfunction]
pub(crate) fn prediction_bands<'py>(
    py: Python<'py>,
    fit: &PyFit,
    times: Option<Vec<f64>>,
    extent: (f64, bool),
    outputs: Option<Vec<String>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (level, is_corrected) = extent;
    let options = BandOptions { times, level, is_corrected, outputs, workers: None };
    let bands = fit
        .compute(py, move |calibration, fit, context| calibration.prediction_bands(fit, &options, context))?;
    object::to_python(py, &bands)
}
