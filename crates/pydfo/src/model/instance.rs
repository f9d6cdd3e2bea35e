//! One instance of an FMU, driven by hand: the functions of FMI one by one, in whichever phase it is.

use crate::convert::dict::dict;
use crate::convert::fmu_error;
use crate::convert::values;
use crate::interrupt::interrupt_guard::{CallingThread, InterruptGuard};
use crate::interrupt::logs;
use crate::interrupt::threads::lock;
use crate::model::description::Fmu;
use fmi::{
    CoSimulation, ContinuousTime, EventMode, FmiError, Initialization, InstanceOptions, Instantiated,
    Integrated, InterfaceKind, Linearization, MAX_EVENT_ITERATIONS, ModelExchange, SavedState, StepMode,
    Terminated, Value,
};
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex};

/// An instance with its phase.
enum Phase {
    Made(fmi::Instance<Instantiated>),
    Initialization(fmi::Instance<Initialization>),
    Event(fmi::Instance<EventMode>),
    Continuous(fmi::Instance<ContinuousTime>),
    Terminated(fmi::Instance<Terminated>),
    SlaveMade(fmi::Instance<Instantiated, CoSimulation>),
    SlaveInitialization(fmi::Instance<Initialization, CoSimulation>),
    Step(fmi::Instance<StepMode, CoSimulation>),
    SlaveTerminated(fmi::Instance<Terminated, CoSimulation>),
    /// Freed, with the reason.
    Freed(&'static str),
}

const CLOSED: &str = "the instance has been closed";
const LOST: &str = "the instance was freed when a call into it failed: make another one";

impl Phase {
    fn name(&self) -> &'static str {
        match self {
            Phase::Made(_) | Phase::SlaveMade(_) => "instantiated",
            Phase::Initialization(_) | Phase::SlaveInitialization(_) => "initialization",
            Phase::Event(_) => "event",
            Phase::Continuous(_) => "continuous",
            Phase::Step(_) => "step",
            Phase::Terminated(_) | Phase::SlaveTerminated(_) => "terminated",
            Phase::Freed(_) => "closed",
        }
    }
}

/// What a call finds wrong.
enum Refusal {
    Fmi(FmiError),
    /// The call is not one of the phase.
    Phase {
        call: &'static str,
        phase: &'static str,
        needed: &'static str,
    },
    Freed(&'static str),
}

impl From<FmiError> for Refusal {
    fn from(error: FmiError) -> Self {
        Refusal::Fmi(error)
    }
}

impl Refusal {
    fn raise(&self, py: Python<'_>) -> PyErr {
        match self {
            Refusal::Fmi(error) => fmu_error::raise(py, error),
            Refusal::Phase { call, phase, needed } => PyValueError::new_err(format!(
                "{call} is called in the phase {needed}; the instance is in the phase {phase}"
            )),
            Refusal::Freed(reason) => PyValueError::new_err(*reason),
        }
    }
}

type Outcome<T> = Result<T, Refusal>;

/// Works with the instance in the phases named; in others the call is refused.
macro_rules! within {
    ($state:expr, $call:literal, $needed:literal, [$($phase:ident),+], $instance:ident => $body:expr) => {
        match &mut *$state {
            $(Phase::$phase($instance) => Ok($body?),)+
            Phase::Freed(reason) => Err(Refusal::Freed(reason)),
            other => Err(Refusal::Phase { call: $call, phase: other.name(), needed: $needed }),
        }
    };
}

/// Leads the instance from one phase to another; where that fails, the instance is freed.
macro_rules! lead {
    ($state:expr, $call:literal, $needed:literal, {$($from:ident => $to:ident),+}, $instance:ident => $body:expr) => {
        match std::mem::replace(&mut *$state, Phase::Freed(LOST)) {
            $(Phase::$from($instance) => {
                *$state = Phase::$to($body?);
                Ok(())
            })+
            other => {
                let refusal = match &other {
                    Phase::Freed(reason) => Refusal::Freed(reason),
                    other => Refusal::Phase { call: $call, phase: other.name(), needed: $needed },
                };
                *$state = other;
                Err(refusal)
            }
        }
    };
}

/// Works with the instance in any phase.
macro_rules! anywhere {
    ($state:expr, $instance:ident => $body:expr) => {
        anywhere!(@ $state, $instance => $body, [
            Made, Initialization, Event, Continuous, Terminated, SlaveMade, SlaveInitialization, Step, SlaveTerminated
        ])
    };
    (@ $state:expr, $instance:ident => $body:expr, [$($phase:ident),+]) => {
        match &mut *$state {
            $(Phase::$phase($instance) => Ok($body?),)+
            Phase::Freed(reason) => Err(Refusal::Freed(reason)),
        }
    };
}

/// Works with the instance where values can be read.
macro_rules! readable {
    ($state:expr, $call:literal, $instance:ident => $body:expr) => {
        within!($state, $call, "initialization or a later one", [
            Initialization, Event, Continuous, Terminated, SlaveInitialization, Step, SlaveTerminated
        ], $instance => $body)
    };
}

/// A saved state of an instance.
#[pyclass(frozen, module = "pydfo._core", name = "SavedState")]
pub(crate) struct PySavedState {
    state: Mutex<SavedState>,
}

/// An instance that is driven by hand.
#[pyclass(frozen, module = "pydfo._core", name = "Instance")]
pub(crate) struct PyInstance {
    fmu: fmi::Fmu,
    kind: InterfaceKind,
    state: Arc<Mutex<Phase>>,
}

impl PyInstance {
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Phase) -> Outcome<T> + Send,
    ) -> PyResult<T> {
        let outcome = py.detach(|| work(&mut lock(&self.state)));
        logs::pass_on(py)?;
        outcome.map_err(|refusal| refusal.raise(py))
    }

    /// Value references of variables of type Real.
    fn references(&self, py: Python<'_>, names: &[String]) -> PyResult<Vec<u32>> {
        let find = |name: &String| Ok(values::find(py, self.fmu.description(), name)?.0.value_reference);
        names.iter().map(find).collect()
    }

    fn n_states(&self) -> usize {
        self.fmu.description().n_states()
    }

    /// A vector that a function of the instance fills.
    fn vector<'py>(
        &self,
        py: Python<'py>,
        n: usize,
        fill: impl FnOnce(&mut Phase, &mut [f64]) -> Outcome<()> + Send,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let mut values = vec![0.0; n];
        self.with(py, |state| fill(state, &mut values))?;
        Ok(PyArray1::from_vec(py, values))
    }
}

#[pymethods]
impl PyInstance {
    #[new]
    #[pyo3(signature = (fmu, kind, name=None, logging=false, log_categories=Vec::new(), visible=false))]
    fn new(
        py: Python<'_>,
        fmu: &Fmu,
        kind: &str,
        name: Option<String>,
        logging: bool,
        log_categories: Vec<String>,
        visible: bool,
    ) -> PyResult<Self> {
        let fmu = fmu.fmu.clone();
        let chosen = kind.parse().and_then(|kind| fmu.check_runnable_as(kind));
        let kind = chosen.map_err(|e| fmu_error::raise(py, &e))?;
        let options =
            InstanceOptions { name, logging, log_categories, visible, ..InstanceOptions::default() };
        let made = py.detach(|| match kind {
            InterfaceKind::ModelExchange => fmu.instantiate_with(&options).map(Phase::Made),
            InterfaceKind::CoSimulation => fmu.instantiate_co_simulation(&options).map(Phase::SlaveMade),
        });
        logs::pass_on(py)?;
        let phase = made.map_err(|e| fmu_error::raise(py, &e))?;
        let state = Arc::new(Mutex::new(phase));
        Ok(Self { fmu, kind, state })
    }

    #[getter]
    fn kind(&self) -> &'static str {
        match self.kind {
            InterfaceKind::ModelExchange => "ME",
            InterfaceKind::CoSimulation => "CS",
        }
    }

    #[getter]
    fn phase(&self, py: Python<'_>) -> &'static str {
        py.detach(|| lock(&self.state).name())
    }

    #[getter]
    fn next_event(&self, py: Python<'_>) -> Option<f64> {
        let next = |state: &mut Phase| anywhere!(state, instance => Ok::<_, FmiError>(instance.next_event()));
        py.detach(|| next(&mut lock(&self.state)).unwrap_or(None))
    }

    fn get<'py>(&self, py: Python<'py>, names: Vec<String>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let description = self.fmu.description();
        let found: Vec<Value> = self.with(py, |state| {
            let get = |name: &String| readable!(state, "get", instance => instance.get(name));
            names.iter().map(get).collect()
        })?;
        let shown = names.iter().zip(found).map(|(name, value)| {
            let variable = values::find(py, description, name)?.0;
            values::to_python(py, value, variable.kind, &description.extents(variable))
        });
        shown.collect()
    }

    fn set(&self, py: Python<'_>, names: Vec<String>, given: Vec<Bound<'_, PyAny>>) -> PyResult<()> {
        let pairs = values::all_from_python(py, self.fmu.description(), names.into_iter().zip(given))?;
        self.with(py, |state| {
            pairs
                .into_iter()
                .try_for_each(|(name, value)| anywhere!(state, instance => instance.set(&name, value)))
        })
    }

    fn enter_initialization(
        &self,
        py: Python<'_>,
        start_time: f64,
        stop_time: Option<f64>,
        tolerance: Option<f64>,
    ) -> PyResult<()> {
        self.with(py, |state| {
            lead!(state, "enter_initialization", "instantiated", {
                Made => Initialization, SlaveMade => SlaveInitialization
            }, instance => instance.enter_initialization(start_time, stop_time, tolerance))
        })
    }

    fn exit_initialization(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |state| {
            lead!(state, "exit_initialization", "initialization", {
                Initialization => Event, SlaveInitialization => Step
            }, instance => instance.exit_initialization())
        })
    }

    /// The fields of `pydfo.fmi.EventInfo`.
    fn update_discrete_states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let outcome = self.with(py, |state| {
            within!(state, "update_discrete_states", "event", [Event], instance =>
                instance.update_discrete_states(MAX_EVENT_ITERATIONS))
        })?;
        Ok(dict!(py; outcome => states_changed, nominals_changed, terminate, next_time))
    }

    fn enter_continuous_time(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |state| {
            lead!(state, "enter_continuous_time", "event", { Event => Continuous },
                instance => instance.enter_continuous_time())
        })
    }

    fn enter_event_mode(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |state| {
            lead!(state, "enter_event_mode", "continuous", { Continuous => Event },
                instance => instance.enter_event_mode())
        })
    }

    fn set_time(&self, py: Python<'_>, time: f64) -> PyResult<()> {
        self.with(
            py,
            |state| within!(state, "set_time", "continuous", [Continuous], instance => instance.set_time(time)),
        )
    }

    fn set_states(&self, py: Python<'_>, states: Vec<f64>) -> PyResult<()> {
        self.with(py, |state| {
            within!(state, "setting the states", "continuous", [Continuous],
                instance => instance.set_continuous_states(&states))
        })
    }

    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, self.n_states(), |state, x| {
            within!(state, "reading the states", "event or continuous", [Event, Continuous],
                instance => instance.get_continuous_states(x))
        })
    }

    fn derivatives<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, self.n_states(), |state, dx| {
            within!(state, "derivatives", "event or continuous", [Event, Continuous],
                instance => instance.get_derivatives(dx))
        })
    }

    fn nominals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, self.n_states(), |state, nominals| {
            within!(state, "nominals", "event or continuous", [Event, Continuous],
                instance => instance.get_nominals(nominals))
        })
    }

    fn event_indicators<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.vector(py, self.fmu.description().n_event_indicators, |state, z| {
            within!(state, "event_indicators", "event or continuous", [Event, Continuous],
                instance => instance.get_event_indicators(z))
        })
    }

    fn state_names(&self, py: Python<'_>) -> PyResult<Vec<Option<String>>> {
        self.with(py, |state| {
            within!(state, "state_names", "initialization or a later one",
                [Initialization, Event, Continuous, Terminated], instance => instance.state_names())
        })
    }

    fn completed_integrator_step(&self, py: Python<'_>) -> PyResult<(bool, bool)> {
        self.with(py, |state| {
            within!(state, "completed_integrator_step", "continuous", [Continuous],
                instance => instance.completed_integrator_step())
        })
    }

    /// Integrates to `end`, in model exchange. The time that is reached, and whether the model has ended the
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
        let watch = InterruptGuard::new(py)?;
        let options = ode::Options {
            method,
            relative_tolerance: tolerance,
            step_size,
            cancel: Some(watch.stop().flag()),
            ..ode::Options::default()
        };
        // Before the instance is taken: a wrong argument must not free it.
        options.check().map_err(|e| fmu_error::raise(py, &e.into()))?;
        let state = Arc::clone(&self.state);
        let work = move |_: &CallingThread| integrate(&mut lock(&state), start, end, options);
        let outcome = watch.run(work)?;
        logs::pass_on(py)?;
        if let Some(raised) = watch.stop().take_raised() {
            return Err(raised);
        }
        match outcome {
            Some(outcome) if !watch.stop().is_asked() => outcome.map_err(|refusal| refusal.raise(py)),
            _ => Err(watch.interrupted()),
        }
    }

    /// The fields of `pydfo.fmi.StepInfo`.
    fn do_step<'py>(&self, py: Python<'py>, time: f64, step: f64) -> PyResult<Bound<'py, PyDict>> {
        let outcome = self.with(
            py,
            |state| within!(state, "do_step", "step", [Step], instance => instance.do_step(time, step)),
        )?;
        Ok(dict!(py; outcome => complete, reached, early, terminate, event))
    }

    fn handle_events<'py>(&self, py: Python<'py>, time: f64) -> PyResult<Bound<'py, PyDict>> {
        let outcome = self.with(
            py,
            |state| within!(state, "handle_events", "step", [Step], instance => instance.handle_events(time)),
        )?;
        Ok(dict!(py; outcome => states_changed, nominals_changed, terminate, next_time))
    }

    fn set_input_derivatives(&self, py: Python<'_>, names: Vec<String>, values: Vec<f64>) -> PyResult<()> {
        let references = self.references(py, &names)?;
        self.with(py, |state| {
            within!(state, "set_input_derivatives", "step", [Step],
                instance => instance.set_input_derivatives(&references, &values))
        })
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
        self.vector(py, n, |state, out| match is_adjoint {
            true => readable!(state, "adjoint_derivative",
                instance => instance.adjoint_derivative(&of, &by, &seed, out)),
            false => readable!(state, "directional_derivative",
                instance => instance.directional_derivative(&of, &by, &seed, out)),
        })
    }

    /// Names of states, inputs and outputs, and the four matrices by rows.
    fn linearize<'py>(&self, py: Python<'py>, differences: bool) -> PyResult<Bound<'py, PyDict>> {
        let linear = self.with(py, |state| {
            within!(state, "linearize", "continuous", [Continuous], instance => instance.linearize(differences))
        })?;
        let Linearization { states, inputs, outputs, a, b, c, d } = linear;
        let array = |values| PyArray1::from_vec(py, values);
        Ok(dict!(py;;
            "states": states, "inputs": inputs, "outputs": outputs,
            "A": array(a), "B": array(b), "C": array(c), "D": array(d),
        ))
    }

    fn save_state(&self, py: Python<'_>) -> PyResult<PySavedState> {
        let state = self.with(py, |state| anywhere!(state, instance => instance.save_state()))?;
        Ok(PySavedState { state: Mutex::new(state) })
    }

    fn restore_state(&self, py: Python<'_>, saved: &PySavedState) -> PyResult<()> {
        self.with(py, |state| {
            let saved = lock(&saved.state);
            anywhere!(state, instance => instance.restore_state(&saved))
        })
    }

    fn set_logging(&self, py: Python<'_>, on: bool, categories: Vec<String>) -> PyResult<()> {
        self.with(py, |state| {
            anywhere!(state, instance => match categories.is_empty() {
                true => instance.set_logging(on),
                false => instance.log_categories(&categories),
            })
        })
    }

    fn log(&self, py: Python<'_>) -> PyResult<(Vec<String>, u64)> {
        self.with(py, |state| {
            let (lines, left_out) = anywhere!(state, instance => Ok::<_, FmiError>(instance.log()))?;
            Ok((lines.iter().map(ToString::to_string).collect(), left_out))
        })
    }

    fn terminate(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |state| {
            lead!(state, "terminate", "event, continuous or step", {
                Event => Terminated, Continuous => Terminated, Step => SlaveTerminated
            }, instance => instance.terminate())
        })
    }

    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |state| {
            lead!(state, "reset", "", {
                Made => Made, Initialization => Made, Event => Made, Continuous => Made, Terminated => Made,
                SlaveMade => SlaveMade, SlaveInitialization => SlaveMade, Step => SlaveMade,
                SlaveTerminated => SlaveMade
            }, instance => instance.reset())
        })
    }

    fn close(&self, py: Python<'_>) {
        py.detach(|| {
            let left = std::mem::replace(&mut *lock(&self.state), Phase::Freed(CLOSED));
            drop(left);
        });
    }
}

/// Integrates an instance in continuous-time mode; the time that is reached, and whether the model has ended
/// the simulation.
fn integrate(state: &mut Phase, start: f64, end: f64, options: ode::Options) -> Outcome<(f64, bool)> {
    let instance: fmi::Instance<ContinuousTime, ModelExchange> =
        match std::mem::replace(&mut *state, Phase::Freed(LOST)) {
            Phase::Continuous(instance) => instance,
            other => {
                let refusal = match &other {
                    Phase::Freed(reason) => Refusal::Freed(reason),
                    other => Refusal::Phase { call: "do_step", phase: other.name(), needed: "continuous" },
                };
                *state = other;
                return Err(refusal);
            }
        };
    match instance.integrate(start, end, options)? {
        Integrated::Reached { instance } => {
            *state = Phase::Continuous(instance);
            Ok((end, false))
        }
        Integrated::Ended { instance, time } => {
            *state = Phase::Event(instance);
            Ok((time, true))
        }
    }
}
