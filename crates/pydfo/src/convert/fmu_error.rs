//! Errors of models as Python exceptions: a class for each kind of mistake, with numbers if there are any.

use super::os_error::{os_error, reason};
use crate::convert::dict::dict;
use calibration::visible_error;
use fmi::FmiError;
use fmi::error::{ReportedError, ReportedErrorKind};
use pyo3::exceptions::{PyFileNotFoundError, PyMemoryError, PyOSError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};
use std::io;
use std::path::Path;

pyo3::import_exception!(pydfo._errors, BadModelValueError);
pyo3::import_exception!(pydfo._errors, FmuError);
pyo3::import_exception!(pydfo._errors, Interrupted);
pyo3::import_exception!(pydfo._errors, ModelTypeError);
pyo3::import_exception!(pydfo._errors, SimulationError);
pyo3::import_exception!(pydfo._errors, UnknownVariableError);

/// Converts an error of a model. The exception does not depend on where the model ran.
pub(crate) fn raise(py: Python<'_>, error: &FmiError) -> PyErr {
    let message = visible_error(error);
    if let FmiError::Io { path, source, .. } = error {
        return file_error(py, path, source, message);
    }
    let reported = error.reported();
    match reported.kind {
        ReportedErrorKind::Cancelled => Interrupted::new_err("interrupted"),
        ReportedErrorKind::Memory => PyMemoryError::new_err(message),
        ReportedErrorKind::NoFile => PyFileNotFoundError::new_err(message),
        ReportedErrorKind::UnknownVariable => UnknownVariableError::new_err(message),
        ReportedErrorKind::WrongType => ModelTypeError::new_err(message),
        ReportedErrorKind::Setting => BadModelValueError::new_err(message),
        ReportedErrorKind::Simulation => simulation(py, reported, message),
        // A call failed outside a simulation.
        _ if reported.status.is_some() => simulation(py, reported, message),
        _ => FmuError::new_err(message),
    }
}

/// Creates the exception for a model that can no longer be simulated.
pub(crate) fn unusable(reason: &str) -> PyErr {
    FmuError::new_err(reason.to_owned())
}

/// Creates `FileNotFoundError` or another OSError, with number and path as Python's functions do.
fn file_error(py: Python<'_>, path: &Path, source: &io::Error, message: String) -> PyErr {
    // Errors that passed through other libraries have lost their number.
    let number = match (source.raw_os_error(), source.kind()) {
        (Some(number), _) => number,
        // ENOENT and ERROR_FILE_NOT_FOUND; ERROR_ACCESS_DENIED and EACCES.
        (None, io::ErrorKind::NotFound) => 2,
        (None, io::ErrorKind::PermissionDenied) => {
            if cfg!(windows) {
                5
            } else {
                13
            }
        }
        _ => return PyOSError::new_err(message),
    };
    os_error(py, number, &reason(&io::Error::from_raw_os_error(number)), path)
}

fn simulation(py: Python<'_>, reported: ReportedError, message: String) -> PyErr {
    let attributes = || Ok(dict!(py; reported => status, time, log));
    with_attributes(py, SimulationError::new_err(message), attributes())
}

/// Adds these attributes to the exception. Returns the error instead if the attributes could not be created.
pub(crate) fn with_attributes(
    py: Python<'_>,
    exception: PyErr,
    attributes: PyResult<Bound<'_, PyDict>>,
) -> PyErr {
    let attach = |attributes: Bound<'_, PyDict>| {
        attributes
            .iter()
            .try_for_each(|(name, value)| exception.value(py).setattr(name.cast::<PyString>()?, value))
    };
    attributes.and_then(attach).err().unwrap_or(exception)
}
