//! What the user chose about a run, checked and in the words of the optimiser.

use dfo::{BatchPlan, Limits, Measure, NelderMead, Stop, Tolerances};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::time::Duration;

/// `pydfo._options.Options`, field by field.
#[derive(FromPyObject)]
pub(crate) struct Options {
    x_tol: f64,
    f_tol: f64,
    stop: String,
    batch: String,
    max_evaluations: Option<usize>,
    max_iterations: Option<usize>,
    max_time: Option<f64>,
    target: Option<f64>,
    workers: Option<usize>,
    vertices: Option<Vec<Vec<f64>>>,
    steps: Option<Vec<f64>>,
}

/// The same for the optimiser.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(crate) method: NelderMead,
    pub(crate) tolerances: Tolerances,
    pub(crate) limits: Limits,
    pub(crate) workers: Option<usize>,
}

impl Options {
    pub(crate) fn check(self, measure: Measure) -> PyResult<Settings> {
        let Self { x_tol, f_tol, max_evaluations, max_iterations, target, workers, .. } = self;
        let stop = match self.stop.as_str() {
            "any" => Stop::Any,
            "all" => Stop::All,
            other => return Err(unknown("stop", other, "'any', 'all'")),
        };
        let plan = match self.batch.as_str() {
            "auto" => BatchPlan::Auto,
            "serial" => BatchPlan::Serial,
            "two" => BatchPlan::Two,
            "four" => BatchPlan::Four,
            other => return Err(unknown("batch", other, "'auto', 'serial', 'two', 'four'")),
        };
        let method = NelderMead::default().batch(plan);
        let method = match (self.vertices, self.steps) {
            (Some(vertices), _) => method.initial_simplex(vertices),
            (None, Some(steps)) => method.initial_steps(&steps),
            (None, None) => method,
        };
        let max_time = match self.max_time {
            None => None,
            Some(f64::INFINITY) => None,
            Some(seconds) => Some(Duration::try_from_secs_f64(seconds).map_err(|_| {
                PyValueError::new_err(format!("max_time = {seconds} must be a number of seconds, at least 0"))
            })?),
        };
        Ok(Settings {
            method,
            tolerances: Tolerances { x_tol, f_tol, measure, stop },
            limits: Limits { max_evaluations, max_iterations, max_time, target },
            workers,
        })
    }
}

fn unknown(name: &str, value: &str, known: &str) -> PyErr {
    PyValueError::new_err(format!("{name} = '{value}' is none of {known}"))
}
