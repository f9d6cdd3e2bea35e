//! One instance of an FMU for direct control: the functions of FMI one by one, in any phase.

use crate::convert::dict::dict;
use crate::convert::fmu_error;
use crate::convert::values;
use crate::interrupt::interrupt_guard::InterruptGuard;
use crate::interrupt::lock::lock;
use crate::interrupt::logs;
use crate::model::description::Fmu;
use calibration::IsolatedInstance;
use fmi::worker::{Isolation, Launcher};
use fmi::{
    FmiError, InstanceAnswer as Answer, InstanceCall as Call, InstanceOptions, InstancePhase, InterfaceKind,
    Linearization,
};
use numpy::PyArray1;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex};

/// A saved state of an instance.
#[pyclass(frozen, module = "pydfo._core", name = "SavedState")]
pub(crate) struct PySavedState {
    number: u64,
    dropped: Arc<Mutex<Vec<u64>>>,
}

impl Drop for PySavedState {
    fn drop(&mut self) {
        lock(&self.dropped).push(self.number);
    }
}

/// An instance for direct control.
#[pyclass(frozen, module = "pydfo._core", name = "Instance")]
pub(crate) struct PyInstance {
    fmu: fmi::Fmu,
    kind: InterfaceKind,
    instance: Mutex<IsolatedInstance>,
    /// Numbers of saved states that Python has dropped.
    dropped: Arc<Mutex<Vec<u64>>>,
}

/// Extracts the value of an answer, which must have the form that belongs to the call.
macro_rules! answered {
    ($answer:expr, $pattern:pat => $out:expr) => {
        match $answer {
            $pattern => Ok($out),
            other => Err(unexpected(&other)),
        }
    };
}

impl PyInstance {
    /// Makes a call and returns the answer and the vector.
    fn ask(&self, py: Python<'_>, call: Call, given: &[f64]) -> PyResult<(Answer, Vec<f64>)> {
        let watch = InterruptGuard::without_handler(py);
        let mut vector = Vec::new();
        let answer = watch.run_here(|context| lock(&self.instance).call(call, given, &mut vector, context));
        logs::pass_on(py)?;
        if watch.stop().is_requested() {
            py.detach(|| lock(&self.instance).interrupt());
            return Err(watch.interrupted());
        }
        Ok((answer.map_err(|e| fmu_error::raise(py, &e))?, vector))
    }

    fn call(&self, py: Python<'_>, call: Call) -> PyResult<Answer> {
        Ok(self.ask(py, call, &[])?.0)
    }

    fn vector<'py>(&self, py: Python<'py>, call: Call, given: &[f64]) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(PyArray1::from_vec(py, self.ask(py, call, given)?.1))
    }

    /// Value references of variables of type Real.
    fn references(&self, py: Python<'_>, names: &[String]) -> PyResult<Vec<u32>> {
        let find = |name: &String| Ok(values::find(py, self.fmu.description(), name)?.0.value_reference);
        names.iter().map(find).collect()
    }
}

#[pymethods]
impl PyInstance {
    #[new]
    #[pyo3(signature = (fmu, kind, name=None, logging=false, log_categories=Vec::new(), visible=false, isolation=None))]
    #[expect(clippy::too_many_arguments, reason = "those of the instance in Python")]
    fn new(
        py: Python<'_>,
        fmu: &Fmu,
        kind: &str,
        name: Option<String>,
        logging: bool,
        log_categories: Vec<String>,
        visible: bool,
        isolation: Option<&str>,
    ) -> PyResult<Self> {
        let fmu = fmu.fmu.clone();
        let raise = |e: FmiError| fmu_error::raise(py, &e);
        let kind = kind.parse().and_then(|kind| fmu.check_runnable_as(kind)).map_err(raise)?;
        // If this program cannot start processes, only an explicit request for one is an error.
        let possible = if Launcher::is_set() { Isolation::Process } else { Isolation::None };
        let isolation = isolation.map_or(Ok(possible), str::parse).map_err(raise)?;
        let options =
            InstanceOptions { name, logging, log_categories, visible, ..InstanceOptions::default() };
        let watch = InterruptGuard::without_handler(py);
        let made = watch.run_here(|context| match isolation {
            Isolation::Process => IsolatedInstance::in_worker(&fmu, kind, &options, context),
            Isolation::None => IsolatedInstance::here(&fmu, kind, &options),
        });
        logs::pass_on(py)?;
        if watch.stop().is_requested() {
            py.detach(|| drop(made));
            return Err(watch.interrupted());
        }
        let instance = Mutex::new(made.map_err(raise)?);
        Ok(Self { fmu, kind, instance, dropped: Arc::default() })
    }

    #[getter]
    fn kind(&self) -> &'static str {
        match self.kind {
            InterfaceKind::ModelExchange => "ME",
            InterfaceKind::CoSimulation => "CS",
        }
    }

    #[getter]
    fn phase(&self, py: Python<'_>) -> PyResult<&'static str> {
        answered!(self.call(py, Call::Phase)?, Answer::Phase(phase) => InstancePhase::name(phase))
    }

    #[getter]
    fn next_event(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        answered!(self.call(py, Call::NextEvent)?, Answer::Time(time) => time)
    }

    fn get<'py>(&self, py: Python<'py>, names: Vec<String>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let description = self.fmu.description();
        let found = answered!(self.call(py, Call::Get(names.clone()))?, Answer::Values(found) => found)?;
        let shown = names.iter().zip(found).map(|(name, value)| {
            let variable = values::find(py, description, name)?.0;
            values::to_python(py, value, variable.kind, &description.extents(variable))
        });
        shown.collect()
    }

    fn set(&self, py: Python<'_>, names: Vec<String>, given: Vec<Bound<'_, PyAny>>) -> PyResult<()> {
        let pairs = values::all_from_python(py, self.fmu.description(), names.into_iter().zip(given))?;
        self.call(py, Call::Set(pairs)).map(drop)
    }

    fn enter_initialization(
        &self,
        py: Python<'_>,
        start_time: f64,
        stop_time: Option<f64>,
        tolerance: Option<f64>,
    ) -> PyResult<()> {
        self.call(py, Call::EnterInitialization { start_time, stop_time, tolerance }).map(drop)
    }

    fn exit_initialization(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, Call::ExitInitialization).map(drop)
    }

    /// Returns the fields of `pydfo.fmi.EventInfo`.
    fn update_discrete_states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let outcome =
            answered!(self.call(py, Call::UpdateDiscreteStates)?, Answer::Events(outcome) => outcome)?;
        Ok(dict!(py; outcome => states_changed, nominals_changed, terminate, next_time))
    }

    fn enter_continuous_time(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, Call::EnterContinuousTime).map(drop)
    }

    fn enter_event_mode(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, Call::EnterEventMode).map(drop)
    }

    fn set_time(&self, py: Python<'_>, time: f64) -> PyResult<()> {
        self.call(py, Call::SetTime(time)).map(drop)
    }

    fn set_states(&self, py: Python<'_>, states: Vec<f64>) -> PyResult<()> {
        self.ask(py, Call::SetStates, &states).map(drop)
    }

    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, Call::States, &[])
    }

    fn derivatives<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, Call::Derivatives, &[])
    }

    fn nominals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, Call::Nominals, &[])
    }

    fn event_indicators<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, Call::EventIndicators, &[])
    }

    fn state_names(&self, py: Python<'_>) -> PyResult<Vec<Option<String>>> {
        answered!(self.call(py, Call::StateNames)?, Answer::Names(names) => names)
    }

    fn completed_integrator_step(&self, py: Python<'_>) -> PyResult<(bool, bool)> {
        let answer = self.call(py, Call::CompletedIntegratorStep)?;
        answered!(answer, Answer::StepEnd(event, terminate) => (event, terminate))
    }

    /// Integrates to `end`, for model exchange. Returns the time reached and whether the model has ended the
    /// simulation.
    fn integrate(
        &self,
        py: Python<'_>,
        start: f64,
        end: f64,
        solver: &str,
        tolerance: f64,
        step_size: Option<f64>,
    ) -> PyResult<(f64, bool)> {
        let method = solver.parse().map_err(|e: ode::OptionsError| fmu_error::raise(py, &e.into()))?;
        let call = Call::Integrate { start, end, method, relative_tolerance: tolerance, step_size };
        answered!(self.call(py, call)?, Answer::Reached(time, is_over) => (time, is_over))
    }

    /// Returns the fields of `pydfo.fmi.StepInfo`.
    fn do_step<'py>(&self, py: Python<'py>, time: f64, step: f64) -> PyResult<Bound<'py, PyDict>> {
        let outcome =
            answered!(self.call(py, Call::DoStep { time, step })?, Answer::Step(outcome) => outcome)?;
        Ok(dict!(py; outcome => complete, reached, early, terminate, event))
    }

    fn handle_events<'py>(&self, py: Python<'py>, time: f64) -> PyResult<Bound<'py, PyDict>> {
        let outcome =
            answered!(self.call(py, Call::HandleEvents(time))?, Answer::Events(outcome) => outcome)?;
        Ok(dict!(py; outcome => states_changed, nominals_changed, terminate, next_time))
    }

    fn set_input_derivatives(&self, py: Python<'_>, names: Vec<String>, values: Vec<f64>) -> PyResult<()> {
        let references = self.references(py, &names)?;
        self.ask(py, Call::SetInputDerivatives(references), &values).map(drop)
    }

    fn directional_derivative<'py>(
        &self,
        py: Python<'py>,
        unknowns: Vec<String>,
        knowns: Vec<String>,
        seed: Vec<f64>,
        is_adjoint: bool,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let model = self.fmu.description();
        let (of, by) = (self.references(py, &unknowns)?, self.references(py, &knowns)?);
        let length = |names: &[String]| -> usize {
            let extents = names.iter().filter_map(|name| model.variable(name)).map(|v| model.extents(v));
            extents.map(|extents| extents.iter().product::<usize>()).sum()
        };
        let n = length(if is_adjoint { &knowns } else { &unknowns });
        self.vector(py, Call::Derivative { unknowns: of, knowns: by, n, is_adjoint }, &seed)
    }

    /// Returns the names of states, inputs and outputs, and the four matrices by rows.
    fn linearize<'py>(&self, py: Python<'py>, differences: bool) -> PyResult<Bound<'py, PyDict>> {
        let answer = self.call(py, Call::Linearize(differences))?;
        let linear = answered!(answer, Answer::Linearization(linear) => linear)?;
        let Linearization { states, inputs, outputs, a, b, c, d } = linear;
        let array = |values| PyArray1::from_vec(py, values);
        Ok(dict!(py;;
            "states": states, "inputs": inputs, "outputs": outputs,
            "A": array(a), "B": array(b), "C": array(c), "D": array(d),
        ))
    }

    fn save_state(&self, py: Python<'_>) -> PyResult<PySavedState> {
        let dropped = std::mem::take(&mut *lock(&self.dropped));
        let number = answered!(self.call(py, Call::SaveState(dropped))?, Answer::State(number) => number)?;
        Ok(PySavedState { number, dropped: Arc::clone(&self.dropped) })
    }

    fn restore_state(&self, py: Python<'_>, saved: &PySavedState) -> PyResult<()> {
        if !Arc::ptr_eq(&saved.dropped, &self.dropped) {
            return Err(fmu_error::raise(py, &FmiError::ForeignState));
        }
        self.call(py, Call::RestoreState(saved.number)).map(drop)
    }

    fn set_logging(&self, py: Python<'_>, on: bool, categories: Vec<String>) -> PyResult<()> {
        self.call(py, Call::SetLogging(on, categories)).map(drop)
    }

    fn log(&self, py: Python<'_>) -> PyResult<(Vec<String>, u64)> {
        answered!(self.call(py, Call::Log)?, Answer::Log(lines, left_out) => (lines, left_out))
    }

    fn terminate(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, Call::Terminate).map(drop)
    }

    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.call(py, Call::Reset).map(drop)
    }

    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let watch = InterruptGuard::without_handler(py);
        watch.run_here(|context| lock(&self.instance).close(context));
        logs::pass_on(py)?;
        if watch.stop().is_requested() { Err(watch.interrupted()) } else { Ok(()) }
    }
}

/// Creates the error for an answer that belongs to another call.
fn unexpected(answer: &Answer) -> PyErr {
    PyRuntimeError::new_err(format!("the worker process returned an unexpected answer: {answer:?}"))
}
