//! Stages of a fit, from the fields of their Python class.

use crate::settings::{Options, Settings};
use calibration::{FitOptions, Stage};
use pyo3::prelude::*;

/// `pydfo._stages.BuiltStage`, field by field.
#[derive(FromPyObject)]
pub(crate) struct StageFields {
    parameters: Vec<String>,
    windows: Vec<(f64, f64)>,
    options: Options,
}

impl StageFields {
    pub(crate) fn check(self, py: Python<'_>) -> PyResult<Stage> {
        let Settings { run, .. } = self.options.check(py, FitOptions::default_run().tolerances)?;
        Ok(Stage {
            parameters: self.parameters,
            windows: self.windows,
            method: Some(run.method),
            method_reason: run.method_reason,
            limits: run.limits,
            tolerances: Some(run.tolerances),
        })
    }
}
