//! A run that Python controls, point by point.

use crate::convert::error;
use crate::convert::record::PyRecord;
use crate::convert::report::{self, ResultKind};
use crate::interrupt::interrupt_guard::InterruptGuard;
use crate::interrupt::lock::lock;
use crate::interrupt::logs;
use crate::optimize::minimize::{PyConstraints, RunSetup, set_constraints};
use crate::optimize::objective;
use dfo::{Answer, MethodOptions, Outcome, RobustLoss, RunOptions};
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::{PyBaseException, PyTypeError};
use pyo3::prelude::*;
use std::sync::Mutex;

/// An optimiser with ask and tell; `pydfo.Optimizer` is its Python class.
#[pyclass(frozen, module = "pydfo._core", name = "Optimizer")]
pub(crate) struct PyOptimizer {
    inner: Mutex<dfo::Optimizer>,
    n: usize,
    /// True if the method needs residuals.
    of_residuals: bool,
}

/// Numbers, points (k, n), cutoffs.
type RequestedBatch<'py> = (Bound<'py, PyArray1<u64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>);

#[pymethods]
impl PyOptimizer {
    #[new]
    #[pyo3(signature = (x0, lower, upper, options, constraints=None))]
    fn new(
        py: Python<'_>,
        x0: Option<Vec<f64>>,
        lower: Vec<f64>,
        upper: Vec<f64>,
        options: PyRecord,
        constraints: Option<PyConstraints>,
    ) -> PyResult<Self> {
        let n = lower.len();
        let mut requested = options.run(py, RunOptions::default(), n)?;
        set_constraints(&mut requested, constraints);
        let of_residuals = requested.options.method.needs_residuals();
        let setup = RunSetup::new(x0, lower, upper, requested);
        let optimizer = py.detach(|| setup.describe(dfo::by_hand()).and_then(|run| run.optimizer()));
        logs::pass_on(py)?;
        let inner = Mutex::new(optimizer.map_err(|e| error::optimiser(py, &e))?);
        Ok(Self { inner, n, of_residuals })
    }

    fn ask<'py>(&self, py: Python<'py>, at_most: Option<usize>) -> PyResult<RequestedBatch<'py>> {
        let watch = InterruptGuard::without_handler(py);
        let at_most = at_most.unwrap_or(usize::MAX);
        let points = watch.run_here(|context| lock(&self.inner).ask_unless(at_most, context));
        if points.is_empty() && watch.stop().is_requested() {
            return Err(watch.interrupted());
        }
        let flat: Vec<f64> = points.iter().flat_map(|p| p.x.iter().copied()).collect();
        Ok((
            PyArray1::from_iter(py, points.iter().map(|p| p.id)),
            PyArray1::from_vec(py, flat).reshape([points.len(), self.n])?,
            PyArray1::from_iter(py, points.iter().map(|p| p.cutoff)),
        ))
    }

    /// Reports the value of a point: a number, or a vector of residuals if the method needs residuals. None
    /// or an exception means that the evaluation failed, and Ellipsis that the point is returned. With
    /// `above`, the cost exceeds the number. `constraints` are the values of the nonlinear constraints.
    #[pyo3(signature = (id, value, above, constraints=None))]
    fn tell(
        &self,
        py: Python<'_>,
        id: u64,
        value: &Bound<'_, PyAny>,
        above: bool,
        constraints: Option<Vec<f64>>,
    ) -> PyResult<()> {
        let mut answer = Answer::default();
        answer.constraints = constraints.unwrap_or_default();
        answer.outcome = if above {
            Outcome::Above(
                value.extract().map_err(|_| PyTypeError::new_err("the cutoff of Above must be a number"))?,
            )
        } else if value.is(py.Ellipsis()) {
            Outcome::Skipped
        } else if value.is_none() {
            Outcome::failed("no value")
        } else if value.is_instance_of::<PyBaseException>() {
            Outcome::failed(PyErr::from_value(value.clone()).to_string())
        } else if self.of_residuals {
            objective::residuals(value, &mut answer.residuals)?;
            RobustLoss::default().cost(&mut answer.residuals, f64::INFINITY)
        } else {
            Outcome::Value(objective::number(value, "the objective")?)
        };
        // This may write the checkpoint, and another thread waiting for this one may hold the interpreter
        // lock.
        let watch = InterruptGuard::without_handler(py);
        let reported = watch.run_here(|context| lock(&self.inner).tell_unless(id, answer, context));
        logs::pass_on(py)?;
        reported.map_err(|e| error::optimiser(py, &e))?;
        if watch.stop().is_requested() { Err(watch.interrupted()) } else { Ok(()) }
    }

    #[getter]
    fn best<'py>(&self, py: Python<'py>) -> Option<(Bound<'py, PyArray1<f64>>, f64)> {
        // The thread that holds the lock may wait for the interpreter lock.
        let best = py.detach(|| lock(&self.inner).best().map(|(x, fun)| (x.to_vec(), fun)));
        best.map(|(x, fun)| (PyArray1::from_vec(py, x), fun))
    }

    #[getter]
    fn n_pending(&self, py: Python<'_>) -> usize {
        py.detach(|| lock(&self.inner).n_pending())
    }

    /// Reason why the run has ended; None while it is running.
    #[getter]
    fn termination(&self, py: Python<'_>) -> Option<&'static str> {
        py.detach(|| lock(&self.inner).termination().map(|t| t.name()))
    }

    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let report = py.detach(|| lock(&self.inner).report());
        let kind = ResultKind::of(self.of_residuals);
        report::to_python(py, report.map_err(|e| error::optimiser(py, &e))?, kind, &|| false)
    }

    fn save(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| lock(&self.inner).save()).map_err(|e| error::optimiser(py, &e))
    }

    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| lock(&self.inner).stop()).map_err(|e| error::optimiser(py, &e))
    }
}
