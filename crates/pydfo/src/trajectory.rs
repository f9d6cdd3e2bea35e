//! A recorded simulation for Python: its columns become NumPy arrays without being copied.

use crate::values;
use fmi::ode::{EventCause, Side, Stats, Termination};
use fmi::{ModelDescription, Trajectory};
use numpy::PyArray1;
use pyo3::prelude::*;

/// What `pydfo._trajectory.SimulationResult` is made of.
#[derive(IntoPyObject)]
pub(crate) struct Record<'py> {
    time: Bound<'py, PyArray1<f64>>,
    names: Vec<String>,
    columns: Vec<Bound<'py, PyArray1<f64>>>,
    /// Type, NumPy's type and unit of each column.
    types: Vec<&'static str>,
    dtypes: Vec<&'static str>,
    units: Vec<Option<String>>,
    /// Name, first column and extents of each array.
    arrays: Vec<(String, usize, Vec<usize>)>,
    /// Of each row: whether it is the limit from the left.
    left: Bound<'py, PyArray1<bool>>,
    event_times: Bound<'py, PyArray1<f64>>,
    event_kinds: Vec<String>,
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
}

impl<'py> Record<'py> {
    pub(crate) fn new(py: Python<'py>, description: &ModelDescription, trajectory: Trajectory) -> Self {
        let variables = || trajectory.variables.iter().map(|position| &description.variables[*position]);
        let types = variables().map(|v| v.kind.name()).collect();
        let dtypes = variables().map(|v| values::dtype_of(v.kind)).collect();
        let units = variables().map(|v| v.unit.clone()).collect();
        let arrays = trajectory.arrays.into_iter().map(|a| (a.name, a.first, a.extents)).collect();
        let left: Vec<bool> = trajectory.sides.iter().map(|side| *side == Side::Left).collect();
        let event_times: Vec<f64> = trajectory.events.iter().map(|event| event.time).collect();
        Self {
            time: PyArray1::from_vec(py, trajectory.time),
            columns: trajectory.columns.into_iter().map(|column| PyArray1::from_vec(py, column)).collect(),
            types,
            dtypes,
            units,
            arrays,
            left: PyArray1::from_vec(py, left),
            event_times: PyArray1::from_vec(py, event_times),
            event_kinds: trajectory.events.iter().map(|event| causes(&event.cause)).collect(),
            stats: Counts::new(&trajectory.stats),
            termination: match trajectory.termination {
                Termination::Finished => "finished",
                Termination::StoppedByModel => "stopped-by-model",
                Termination::StoppedByObserver => "stopped-by-observer",
            },
            end_time: trajectory.end_time,
            names: trajectory.names,
        }
    }
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
        }
    }
}

/// The causes of an event: "state", "time", "step", "input", or several with a plus between them.
fn causes(cause: &EventCause) -> String {
    let all = [(cause.state, "state"), (cause.time, "time"), (cause.step, "step"), (cause.input, "input")];
    let there: Vec<&str> = all.into_iter().filter(|(is, _)| *is).map(|(_, name)| name).collect();
    there.join("+")
}
