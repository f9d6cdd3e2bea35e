//! Helper functions for all exported files: check of the fit, and writing.

use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use fmi::FmiError;
use fmi::platform::fill_atomically;
use std::io::Write;
use std::path::Path;

/// Returns an error if the fit does not belong to the calibration.
pub(super) fn check_belongs(fit: &Fit, calibration: &Calibration) -> Result<(), CalibrationError> {
    let names: Vec<&str> = calibration.parameters().iter().map(|p| p.name()).collect();
    let lists = [names.join(", "), fit.names.join(", ")];
    if names != fit.names {
        let [of_calibration, other] = lists;
        return Err(CalibrationError::Setup(format!(
            "the fit has the parameters {other}, but the calibration has {of_calibration}"
        )));
    }
    Ok(())
}

/// Writes a file atomically. Does not overwrite the model.
pub(super) fn write(path: &Path, calibration: &Calibration, bytes: &[u8]) -> Result<(), CalibrationError> {
    check_path(path, calibration)?;
    let fill = |mut file: &std::fs::File, _: &Path| {
        Ok(file.write_all(bytes).map_err(FmiError::io("write", path))?)
    };
    fill_atomically(path, fill)
}

/// Returns an error if the path is the model.
pub(super) fn check_path(path: &Path, calibration: &Calibration) -> Result<(), CalibrationError> {
    let model = calibration.fmu().path();
    match (path.canonicalize(), model.canonicalize()) {
        (Ok(one), Ok(two)) if one == two => {
            let place = path.display();
            Err(CalibrationError::Setup(format!("{place} is the model itself. Specify another path")))
        }
        _ => Ok(()),
    }
}

/// Returns an error if the path has a different suffix, because other tools identify files by it.
pub(super) fn check_suffix(path: &Path, suffix: &str) -> Result<(), CalibrationError> {
    let is_it = path.extension().is_some_and(|found| found.eq_ignore_ascii_case(suffix));
    if is_it && !path.is_dir() {
        return Ok(());
    }
    let what = if path.is_dir() { "is a folder" } else { "has another suffix" };
    let meant = path.with_extension(suffix);
    Err(CalibrationError::Setup(format!(
        "{} {what}. Specify a path that ends in .{suffix}, for example {}",
        path.display(),
        if path.is_dir() {
            path.join(format!("fitted.{suffix}")).display().to_string()
        } else {
            meant.display().to_string()
        }
    )))
}
