//! Errors of optimisers and calibrations as Python exceptions, and how a run ends for the user. `fmu_error`
//! converts the errors of models. `pydfo/_errors.py` defines and documents the exception classes.

use super::os_error::{os_error, reason};
use crate::convert::dict::dict;
use crate::convert::fmu_error;
use crate::interrupt::interrupt_guard::EndRequest;
use pyo3::exceptions::{
    PyKeyError, PyKeyboardInterrupt, PyMemoryError, PyOSError, PyTypeError, PyUserWarning, PyValueError,
};
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;
use std::io;
use std::path::Path;

pyo3::import_exception!(pydfo._errors, AllStartsFailed);
pyo3::import_exception!(pydfo._errors, BadCalibrationError);
pyo3::import_exception!(pydfo._errors, CalibrationError);
pyo3::import_exception!(pydfo._errors, CalibrationWarning);
pyo3::import_exception!(pydfo._errors, CheckpointError);
pyo3::import_exception!(pydfo._errors, Interrupted);
pyo3::import_exception!(pydfo._errors, NoResult);
pyo3::import_exception!(pydfo._errors, SimulationError);
pyo3::import_exception!(pydfo._errors, SimulationWarning);

/// Converts an error of the optimiser. Bad options become ValueErrors; the error of a run without a result
/// carries its observations.
pub(crate) fn optimiser(py: Python<'_>, error: &dfo::Error) -> PyErr {
    let message = calibration::visible_error(error);
    let (exception, found) = match error {
        dfo::Error::AllStartsFailed(found) => (AllStartsFailed::new_err(message), found),
        dfo::Error::EndedWithoutPoint { found, .. } => (NoResult::new_err(message), found),
        dfo::Error::CheckpointFile { kind, .. } => return io::Error::new(*kind, message).into(),
        dfo::Error::Checkpoint { .. } | dfo::Error::CheckpointMismatch { .. } => {
            return CheckpointError::new_err(message);
        }
        dfo::Error::NeedsResiduals { method } => {
            return PyValueError::new_err(format!(
                "{method} requires the vector of residuals. Use pydfo.least_squares(fun, x0) with a function \
                 that returns the residuals, or use another method"
            ));
        }
        dfo::Error::Record(e) => return refused(e, &message),
        dfo::Error::TooFewValues { .. } => return CalibrationError::new_err(message),
        dfo::Error::Memory { .. } => return PyMemoryError::new_err(message),
        dfo::Error::UnknownPoint { .. } => return PyKeyError::new_err(message),
        _ => return PyValueError::new_err(message),
    };
    let attributes = || {
        Ok(dict!(py;;
            "failures": found.failures.iter().map(|(reason, count)| (reason, count)).into_py_dict(py)?,
            "nfev": found.n_evaluations,
            "trace": crate::convert::report::trace(py, &found.trace)?,
        ))
    };
    fmu_error::with_attributes(py, exception, attributes())
}

/// Converts an error of a calibration.
pub(crate) fn calibration(py: Python<'_>, error: &calibration::CalibrationError) -> PyErr {
    use calibration::CalibrationError as E;
    let message = calibration::visible_error(error);
    match error {
        E::DataFile { path, source } => file(py, "cannot read", path, source),
        E::ReportFile { path, source } => file(py, "cannot write", path, source),
        E::Data { .. }
        | E::SavedFit { .. }
        | E::OtherModel { .. }
        | E::Parameter { .. }
        | E::Setup(_)
        | E::Length { .. }
        | E::OptimiserParameter { .. } => BadCalibrationError::new_err(message),
        E::Model(e) => fmu_error::raise(py, e),
        E::Simulation { source: None, .. } => SimulationError::new_err(message),
        // With the class and the numbers of the cause, but with the parameters or the experiment in the
        // message.
        E::Simulation { source: Some(e), .. } => reworded(py, fmu_error::raise(py, e), message),
        E::Experiment { source, .. } | E::Stage { source, .. } => {
            reworded(py, calibration(py, source), message)
        }
        E::Optimiser(e) => optimiser(py, e),
        E::Record(e) => refused(e, &message),
        _ => CalibrationError::new_err(message),
    }
}

/// Converts an invalid value: a TypeError if its type is wrong, otherwise a ValueError.
pub(crate) fn refused(error: &dfo::RecordError, message: &str) -> PyErr {
    match error.is_type() {
        true => PyTypeError::new_err(message.to_owned()),
        false => PyValueError::new_err(message.to_owned()),
    }
}

/// Replaces the message of an exception.
pub(crate) fn reworded(py: Python<'_>, exception: PyErr, message: String) -> PyErr {
    let done = exception.value(py).setattr("args", (message,));
    done.err().unwrap_or(exception)
}

/// Warns the user through Python's `warnings`, at the call of the `pydfo` function.
pub(crate) fn warn(py: Python<'_>, message: &str) -> PyResult<()> {
    warn_as(py, &py.get_type::<PyUserWarning>(), message)
}

/// Warns the user with a warning of this class.
pub(crate) fn warn_as(py: Python<'_>, class: &Bound<'_, PyAny>, message: &str) -> PyResult<()> {
    let text = std::ffi::CString::new(&*calibration::visible_line(message)).unwrap_or_default();
    // From this frame, through the functions of the package, to the line that called the first of them.
    let (mut frame, mut level) = (py.import("sys")?.call_method1("_getframe", (0,))?, 1);
    while frame.getattr("f_globals")?.get_item("__name__")?.extract::<String>()?.starts_with("pydfo.") {
        frame = frame.getattr("f_back")?;
        level += 1;
    }
    PyErr::warn(py, class, &text, level)
}

/// Converts an error of the operating system. Python selects the subclass, such as FileNotFoundError, from
/// the number.
fn file(py: Python<'_>, action: &str, path: &Path, error: &io::Error) -> PyErr {
    match error.raw_os_error() {
        _ if error.kind() == io::ErrorKind::OutOfMemory => {
            PyMemoryError::new_err(format!("{action} {}: {error}", path.display()))
        }
        Some(number) => os_error(py, number, &format!("{action}: {}", reason(error)), path),
        None => PyOSError::new_err(format!("{action} {}: {error}", path.display())),
    }
}

/// Creates `Interrupted` with the best point so far.
pub(crate) fn interrupted(py: Python<'_>, result: Option<&Bound<'_, PyAny>>, cause: Option<PyErr>) -> PyErr {
    let exception = Interrupted::new_err(match result {
        Some(_) => "interrupted; the result so far is in .result",
        None => "interrupted; there is no result yet",
    });
    exception.set_cause(py, cause);
    match exception.value(py).setattr("result", result) {
        Ok(()) => exception,
        Err(e) => e,
    }
}

/// Returns the result of a run, or the exception that ends it. An interrupt takes precedence over an
/// exception, and an exception over a result. Both carry the result.
pub(crate) fn ended<'py>(
    py: Python<'py>,
    stop: &EndRequest,
    raised: Option<PyErr>,
    result: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let raised = raised.or_else(|| stop.take_raised());
    match (raised, result) {
        (Some(e), result) if e.is_instance_of::<PyKeyboardInterrupt>(py) => {
            Err(interrupted(py, result.as_ref(), Some(e)))
        }
        (Some(e), result) => {
            // An exception that rejects attributes is raised without them.
            let _ = e.value(py).setattr("partial_result", result);
            Err(e)
        }
        (None, result) if stop.is_requested() => Err(interrupted(py, result.as_ref(), None)),
        (None, Some(result)) => Ok(result),
        (None, None) => Err(NoResult::new_err("the run ended without a result")),
    }
}

/// Replaces hidden characters of a name or of another one-line string by their numbers, for example `\u{a}`
/// for a line break.
#[pyfunction]
pub(crate) fn visible_line(text: &str) -> std::borrow::Cow<'_, str> {
    calibration::visible_line(text)
}
