//! A recorded simulation for Python. Its columns become NumPy arrays without copying.

use crate::convert::dict::dict;
use crate::convert::values;
use fmi::description::VariableKind;
use fmi::ode::{EventCause, Side, Stats, Termination};
use fmi::{ModelDescription, Trajectory, Value, ValueColumn};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::borrow::Cow;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Counts of one or several simulations.
pub(crate) struct Counts(Stats);

impl Counts {
    pub(crate) fn new(stats: &Stats) -> Self {
        Self(*stats)
    }
}

impl<'py> IntoPyObject<'py> for Counts {
    type Target = PyDict;
    type Output = Bound<'py, PyDict>;
    type Error = PyErr;

    fn into_pyobject(self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let stats = &self.0;
        Ok(dict!(py; stats =>
            runs, accepted_steps, rejected_steps, right_hand_sides, jacobians, directional_derivatives, decompositions,
            newton_iterations, event_indicators, samples, events, state_events, time_events, step_events, input_events,
            restarts, chattering;
            "check_runs": stats.checks.runs,
            "check_steps": stats.checks.steps,
            "check_right_hand_sides": stats.checks.right_hand_sides,
            "seconds": stats.seconds.get(),
            "seconds_in_model": stats.seconds_in_model.get(),
        ))
    }
}

/// Returns the fields of `pydfo._model.trajectory.SimulationResult`. For each variable: type, unit, columns
/// (arrays have one per element) and extents. For each row: a flag for the limit from the left. For each tick
/// of a clock: time and clock.
pub(crate) fn record<'py>(
    py: Python<'py>,
    description: &ModelDescription,
    mut trajectory: Trajectory,
) -> PyResult<Bound<'py, PyDict>> {
    let recorded = std::mem::take(&mut trajectory.recorded);
    let mut columns: Vec<Vec<Bound<'py, PyAny>>> = Vec::with_capacity(recorded.len());
    for variable in &recorded {
        columns.push(match variable.values.is_empty() {
            // Numbers are moved, not copied.
            true => trajectory.columns[variable.columns.clone()]
                .iter_mut()
                .map(|column| PyArray1::from_vec(py, std::mem::take(column)).into_any())
                .collect(),
            false => trajectory.values[variable.values.clone()]
                .iter()
                .map(|column| exactly(py, variable.kind, column))
                .collect::<PyResult<_>>()?,
        });
    }
    let unit = |name: &str| {
        let array = || name.rsplit_once('[').and_then(|(array, _)| description.variable(array));
        description.variable(name).or_else(array).and_then(|v| v.unit.clone())
    };
    let left: Vec<bool> = trajectory.sides.iter().map(|side| *side == Side::Left).collect();
    let event_times: Vec<f64> = trajectory.events.iter().map(|event| event.time).collect();
    Ok(dict!(py;;
        "time": PyArray1::from_vec(py, trajectory.time),
        "columns": columns,
        "extents": recorded.iter().map(|variable| variable.extents.clone()).collect::<Vec<_>>(),
        "types": recorded.iter().map(|variable| variable.kind.name()).collect::<Vec<_>>(),
        "units": recorded.iter().map(|variable| unit(&variable.name)).collect::<Vec<_>>(),
        "time_unit": description.time_unit(),
        "left": PyArray1::from_vec(py, left),
        "event_times": PyArray1::from_vec(py, event_times),
        "event_kinds": trajectory.events.iter().map(|event| causes(&event.cause)).collect::<Vec<_>>(),
        "tick_times": trajectory.ticks.iter().map(|tick| tick.time).collect::<Vec<_>>(),
        "tick_clocks": trajectory.ticks.iter().map(|tick| tick.clock.to_string()).collect::<Vec<_>>(),
        "stats": Counts::new(&trajectory.stats),
        "termination": match trajectory.termination {
            Termination::Finished => "finished",
            Termination::StoppedByModel => "stopped-by-model",
            Termination::StoppedByObserver => "stopped-by-observer",
        },
        "end_time": trajectory.end_time,
        "names": recorded.into_iter().map(|variable| variable.name).collect::<Vec<_>>(),
    ))
}

/// Converts a column of 64-bit integers to an array of such integers. Converts a column of strings or bytes
/// to an array of objects, with one object per distinct value.
fn exactly<'py>(py: Python<'py>, kind: VariableKind, column: &ValueColumn) -> PyResult<Bound<'py, PyAny>> {
    let integer = |value: &Value| if let Value::Integer(i) = value { *i } else { 0 };
    Ok(match kind {
        VariableKind::Int64 => {
            PyArray1::from_iter(py, column.iter().map(|value| integer(value) as i64)).into_any()
        }
        VariableKind::UInt64 => {
            PyArray1::from_iter(py, column.iter().map(|value| integer(value) as u64)).into_any()
        }
        _ => {
            let mut made: HashMap<usize, Py<PyAny>> = HashMap::new();
            let object = |place: &usize| -> PyResult<Py<PyAny>> {
                Ok(match made.entry(*place) {
                    Entry::Occupied(entry) => entry.get().clone_ref(py),
                    Entry::Vacant(new) => {
                        let value = column.distinct()[*place].clone();
                        new.insert(values::to_python(py, value, kind, &[])?.unbind()).clone_ref(py)
                    }
                })
            };
            let objects = column.places().iter().map(object).collect::<PyResult<Vec<Py<PyAny>>>>()?;
            PyArray1::from_vec(py, objects).into_any()
        }
    })
}

/// Causes of an event: "state", "time", "step", "input", or several joined by plus signs.
fn causes(cause: &EventCause) -> Cow<'static, str> {
    let all = [(cause.state, "state"), (cause.time, "time"), (cause.step, "step"), (cause.input, "input")];
    let mut there = all.into_iter().filter(|(is, _)| *is).map(|(_, name)| name);
    let first = Cow::Borrowed(there.next().unwrap_or_default());
    there.fold(first, |names, name| Cow::Owned(format!("{names}+{name}")))
}

/// Returns the largest difference of two numbers that count as equal times, in a span from `start` to `end`.
#[pyfunction]
pub(crate) fn time_tolerance(start: f64, end: f64) -> f64 {
    base::time_tolerance(start, end)
}
