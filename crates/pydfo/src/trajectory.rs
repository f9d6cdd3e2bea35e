//! A recorded simulation for Python: its columns become NumPy arrays without being copied.

use crate::values;
use fmi::description::VariableKind;
use fmi::ode::{EventCause, Side, Stats, Termination};
use fmi::{ModelDescription, Trajectory, Value};
use numpy::PyArray1;
use pyo3::prelude::*;
use std::borrow::Cow;

/// What `pydfo._trajectory.SimulationResult` is made of.
#[derive(IntoPyObject)]
pub(crate) struct Record<'py> {
    time: Bound<'py, PyArray1<f64>>,
    /// Names of the variables, and of each its columns (arrays have one for each element) and its extents.
    names: Vec<String>,
    columns: Vec<Vec<Bound<'py, PyAny>>>,
    extents: Vec<Vec<usize>>,
    /// Type and unit of each variable.
    types: Vec<&'static str>,
    units: Vec<Option<String>>,
    /// Of each row: whether it is the limit from the left.
    left: Bound<'py, PyArray1<bool>>,
    event_times: Bound<'py, PyArray1<f64>>,
    event_kinds: Vec<Cow<'static, str>>,
    /// Of each tick of a clock: when and which.
    tick_times: Vec<f64>,
    tick_clocks: Vec<String>,
    stats: Counts,
    termination: &'static str,
    end_time: f64,
}

#[derive(IntoPyObject)]
pub(crate) struct Counts {
    accepted_steps: u64,
    rejected_steps: u64,
    right_hand_sides: u64,
    jacobians: u64,
    directional_derivatives: u64,
    decompositions: u64,
    newton_iterations: u64,
    event_indicators: u64,
    samples: u64,
    events: u64,
    state_events: u64,
    time_events: u64,
    step_events: u64,
    input_events: u64,
    restarts: u64,
    chattering: u64,
    seconds: f64,
    seconds_in_model: f64,
}

impl<'py> Record<'py> {
    pub(crate) fn new(
        py: Python<'py>,
        description: &ModelDescription,
        mut trajectory: Trajectory,
    ) -> PyResult<Self> {
        let recorded = std::mem::take(&mut trajectory.recorded);
        let mut columns = Vec::with_capacity(recorded.len());
        for variable in &recorded {
            columns.push(match variable.values.is_empty() {
                // Numbers are moved, not copied.
                true => trajectory.columns[variable.columns.clone()]
                    .iter_mut()
                    .map(|column| PyArray1::from_vec(py, std::mem::take(column)).into_any())
                    .collect(),
                false => trajectory.values[variable.values.clone()]
                    .iter_mut()
                    .map(|column| exactly(py, variable.kind, std::mem::take(&mut column.values)))
                    .collect::<PyResult<_>>()?,
            });
        }
        let unit = |name: &str| {
            let array = || name.rsplit_once('[').and_then(|(array, _)| description.variable(array));
            description.variable(name).or_else(array).and_then(|v| v.unit.clone())
        };
        let left: Vec<bool> = trajectory.sides.iter().map(|side| *side == Side::Left).collect();
        let event_times: Vec<f64> = trajectory.events.iter().map(|event| event.time).collect();
        Ok(Self {
            time: PyArray1::from_vec(py, trajectory.time),
            columns,
            extents: recorded.iter().map(|variable| variable.extents.clone()).collect(),
            types: recorded.iter().map(|variable| variable.kind.name()).collect(),
            units: recorded.iter().map(|variable| unit(&variable.name)).collect(),
            left: PyArray1::from_vec(py, left),
            event_times: PyArray1::from_vec(py, event_times),
            event_kinds: trajectory.events.iter().map(|event| causes(&event.cause)).collect(),
            tick_times: trajectory.ticks.iter().map(|tick| tick.time).collect(),
            tick_clocks: trajectory.ticks.iter().map(|tick| tick.clock.to_string()).collect(),
            stats: Counts::new(&trajectory.stats),
            termination: match trajectory.termination {
                Termination::Finished => "finished",
                Termination::StoppedByModel => "stopped-by-model",
                Termination::StoppedByObserver => "stopped-by-observer",
            },
            end_time: trajectory.end_time,
            names: recorded.into_iter().map(|variable| variable.name).collect(),
        })
    }
}

/// A column of 64-bit integers as an array of them, one of texts or bytes as an array of objects.
fn exactly<'py>(py: Python<'py>, kind: VariableKind, column: Vec<Value>) -> PyResult<Bound<'py, PyAny>> {
    let integer = |value: &Value| if let Value::Integer(i) = value { *i } else { 0 };
    Ok(match kind {
        VariableKind::Int64 => {
            PyArray1::from_iter(py, column.iter().map(|value| integer(value) as i64)).into_any()
        }
        VariableKind::UInt64 => {
            PyArray1::from_iter(py, column.iter().map(|value| integer(value) as u64)).into_any()
        }
        _ => {
            let objects =
                column.into_iter().map(|value| values::to_python(py, value, kind, &[]).map(Bound::unbind));
            PyArray1::from_vec(py, objects.collect::<PyResult<Vec<Py<PyAny>>>>()?).into_any()
        }
    })
}

impl Counts {
    pub(crate) fn new(stats: &Stats) -> Self {
        Self {
            accepted_steps: stats.accepted_steps,
            rejected_steps: stats.rejected_steps,
            right_hand_sides: stats.right_hand_sides,
            jacobians: stats.jacobians,
            directional_derivatives: stats.directional_derivatives,
            decompositions: stats.decompositions,
            newton_iterations: stats.newton_iterations,
            event_indicators: stats.event_indicators,
            samples: stats.samples,
            events: stats.events,
            state_events: stats.state_events,
            time_events: stats.time_events,
            step_events: stats.step_events,
            input_events: stats.input_events,
            restarts: stats.restarts,
            chattering: stats.chattering,
            seconds: stats.seconds.get(),
            seconds_in_model: stats.seconds_in_model.get(),
        }
    }
}

/// The causes of an event: "state", "time", "step", "input", or several with a plus between them.
fn causes(cause: &EventCause) -> Cow<'static, str> {
    let all = [(cause.state, "state"), (cause.time, "time"), (cause.step, "step"), (cause.input, "input")];
    let mut there = all.into_iter().filter(|(is, _)| *is).map(|(_, name)| name);
    let first = Cow::Borrowed(there.next().unwrap_or_default());
    there.fold(first, |names, name| Cow::Owned(format!("{names}+{name}")))
}
