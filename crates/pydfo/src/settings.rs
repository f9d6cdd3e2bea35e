//! Options of a run as the user gave them, checked and converted to those of the optimiser.

use crate::methods;
use crate::words::{word, words};
use calibration::{Estimator, WorthOptions};
use dfo::{
    AnyMethod, Checkpoint, Code, Kind, Known, Limits, Minimize, RobustLoss, RunOptions, Tolerances, Transform,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::time::Duration;

/// `pydfo._options.Options`, field by field.
#[derive(FromPyObject)]
pub(crate) struct Options {
    method: String,
    method_options: Py<PyDict>,
    method_reason: Option<String>,
    x_tol: Option<f64>,
    f_tol: Option<f64>,
    stop: Option<String>,
    tolerances: Option<String>,
    max_evaluations: Option<usize>,
    max_iterations: Option<usize>,
    max_time: Option<f64>,
    target: Option<f64>,
    workers: Option<usize>,
    seed: Option<u64>,
    checkpoint: Option<PathBuf>,
    resume: String,
    checkpoint_interval: Option<f64>,
    cache: Option<usize>,
    trace_limit: Option<usize>,
    max_failed: Option<f64>,
    scale: Vec<String>,
    nominal: Vec<Option<f64>>,
    kinds: Vec<String>,
    known: Vec<(Vec<f64>, f64)>,
    known_problem: Option<String>,
    problem: Option<String>,
    code: Option<CodeFields>,
    unlimited: bool,
}

/// A hash of the code of a Python function, or why there is none; whether it is one.
pub(crate) type CodeFields = (String, bool);

/// The same for the optimiser.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    pub(crate) run: RunOptions<AnyMethod>,
    transforms: Vec<Transform>,
    sizes: Vec<Option<f64>>,
    kinds: Vec<Kind>,
}

/// Options of the covariance estimate, by the name of the estimator; none: there is no estimate.
pub(crate) fn worth(covariance: Option<&str>) -> PyResult<Option<WorthOptions>> {
    let options = |estimator| WorthOptions { estimator, ..WorthOptions::default() };
    covariance.map(|name| word::<Estimator>("covariance", name).map(options)).transpose()
}

/// Points and costs as points of a problem.
fn known(points: Vec<(Vec<f64>, f64)>, problem: Option<&String>) -> Vec<Known> {
    let known = |(x, cost)| Known { x, cost, residuals: Vec::new(), problem: problem.cloned() };
    points.into_iter().map(known).collect()
}

impl Options {
    /// `default`: the tolerances that hold where none are said.
    pub(crate) fn check(self, py: Python<'_>, default: Tolerances) -> PyResult<Settings> {
        let tolerances = Tolerances {
            x_tol: self.x_tol.unwrap_or(default.x_tol),
            f_tol: self.f_tol.unwrap_or(default.f_tol),
            measure: self.tolerances.map_or(Ok(default.measure), |given| word("tolerances", &given))?,
            stop: self.stop.map_or(Ok(default.stop), |given| word("stop", &given))?,
        };
        let max_time = time_limit("max_time", self.max_time)?;
        let resume = word("resume", &self.resume)?;
        let mut checkpoint = self.checkpoint.map(|path| Checkpoint::new(path).resume(resume));
        if let Some((text, is_hash)) = self.code {
            let code = if is_hash { Code::Hash(text) } else { Code::Unknown(text) };
            checkpoint = checkpoint.map(|c| c.code(code));
        }
        if let Some(seconds) = self.checkpoint_interval {
            let interval = Duration::try_from_secs_f64(seconds).map_err(|_| {
                PyValueError::new_err(format!(
                    "checkpoint_interval = {seconds} must be a number of seconds, at least 0"
                ))
            })?;
            checkpoint = checkpoint.map(|c| c.interval(interval));
        }
        let limits = Limits {
            max_evaluations: self.max_evaluations,
            max_iterations: self.max_iterations,
            max_time,
            target: self.target,
            max_failed: self.max_failed,
        };
        let run = RunOptions {
            method: methods::method(&self.method, self.method_options.bind(py))?,
            method_reason: self.method_reason,
            tolerances,
            limits,
            unlimited: self.unlimited,
            workers: self.workers,
            seed: self.seed,
            cache: self.cache,
            trace_limit: self.trace_limit,
            trace_residuals: false,
            checkpoint,
            known: known(self.known, self.known_problem.as_ref()),
            problem: self.problem,
        };
        Ok(Settings {
            run,
            transforms: words("scale", &self.scale)?,
            sizes: self.nominal,
            kinds: words("kinds", &self.kinds)?,
        })
    }
}

impl Settings {
    /// A minimisation with all of it.
    pub(crate) fn apply<M, D>(self, run: Minimize<'_, M, D>) -> Minimize<'_, AnyMethod, D> {
        let Self { run: options, transforms, sizes, kinds } = self;
        run.options(options).transforms(&transforms).known_scales(&sizes).kinds(&kinds)
    }
}

/// Name and scale of a loss.
pub(crate) type LossFields = (String, f64);

/// Loss function of the residuals; `None`: there are none.
pub(crate) fn loss(given: Option<LossFields>) -> PyResult<Option<RobustLoss>> {
    let Some((name, scale)) = given else { return Ok(None) };
    RobustLoss::new(word("loss", &name)?, scale).map(Some).map_err(|_| {
        PyValueError::new_err(format!("f_scale = {scale} must be positive and finite (1e-300 to 1e300)"))
    })
}

/// A limit of wall-clock time beyond this, in s, is none: 30 million years.
const ENDLESS: f64 = 1e15;

/// A limit of wall-clock time in s; None and infinity are no limit.
pub(crate) fn time_limit(name: &str, seconds: Option<f64>) -> PyResult<Option<Duration>> {
    match seconds {
        None => Ok(None),
        Some(seconds) if seconds > ENDLESS => Ok(None),
        Some(seconds) => match Duration::try_from_secs_f64(seconds) {
            Ok(limit) if seconds > 0.0 => Ok(Some(limit)),
            _ => {
                Err(PyValueError::new_err(format!("{name} = {seconds} must be a positive number of seconds")))
            }
        },
    }
}
