//! Sources of the inputs of the model: a column of the recording, a constant, or a function of time.

use crate::data::{Data, sampling_interval};
use crate::error::CalibrationError;
use base::Number;
use fmi::{InputFunction, Inputs};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// Source of the values of an input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) enum InputSource {
    /// A column of the recording.
    Column(String),
    /// A column of the recording, whose values are held until the next row.
    Held(String),
    /// A constant value.
    Constant(f64),
    /// A function of time.
    Function(SignalFunction),
}

/// The column that drives an input.
#[derive(Debug, Default, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ColumnRecord {
    /// The column; default: the name of the input.
    pub(crate) column: Option<String>,
    /// Holds each value until the next row, instead of connecting the rows by straight lines.
    pub(crate) hold: bool,
}

/// A function of time. It is not stored with a problem and must be set again after loading. A worker process
/// requests its values from the main process.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(crate) struct SignalFunction {
    #[serde(default, skip_serializing_if = "is_stored")]
    pub(crate) function: Option<InputFunction>,
}

/// True if the value is serialised to storage, not in a message to a worker process.
fn is_stored(_: &Option<InputFunction>) -> bool {
    !fmi::worker::is_in_frame()
}

impl fmt::Debug for SignalFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.function.is_some() { "function" } else { "function that was not stored" })
    }
}

impl PartialEq for SignalFunction {
    fn eq(&self, other: &Self) -> bool {
        match (&self.function, &other.function) {
            (Some(one), Some(other)) => one.is_same(other),
            (one, other) => one.is_none() && other.is_none(),
        }
    }
}

/// An input and its signal, before delay and offset are applied.
#[derive(Debug, Clone)]
pub(crate) struct Signal {
    pub(crate) variable: String,
    source: SignalSource,
}

#[derive(Debug, Clone)]
enum SignalSource {
    Rows(Arc<[f64]>, Arc<[f64]>),
    Constant(f64),
    Function(SignalFunction),
}

/// Delay, factor and offset of a signal: `factor * u(t - delay) + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shift {
    /// In the time unit of the model.
    pub(crate) delay: f64,
    pub(crate) factor: f64,
    /// In the unit of the variable.
    pub(crate) offset: f64,
}

impl Shift {
    /// Returns a value with its factor and offset.
    pub(crate) fn of(&self, value: f64) -> f64 {
        self.factor * value + self.offset
    }
}

impl InputSource {
    /// Returns the column of the recording that provides the values, if there is one.
    pub(crate) fn column(&self) -> Option<&str> {
        match self {
            Self::Column(column) | Self::Held(column) => Some(column),
            Self::Constant(_) | Self::Function(_) => None,
        }
    }
}

/// Converts rows to the rows of a zero-order hold, in which a repeated time is a jump from the held to the
/// next value. If a time is repeated, its last value counts.
pub(crate) fn hold(times: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut held_times, mut held) = (Vec::new(), Vec::<f64>::new());
    let is_last = |(k, (time, _)): &(usize, (&f64, &f64))| times.get(k + 1) != Some(*time);
    for (_, (time, value)) in times.iter().zip(values).enumerate().filter(is_last) {
        if let Some(before) = held.last().copied().filter(|before| before != value) {
            held_times.push(*time);
            held.push(before);
        }
        held_times.push(*time);
        held.push(*value);
    }
    (held_times, held)
}

impl Signal {
    /// Creates the signal of an input. Rows of a column with missing values are dropped.
    pub(crate) fn new(variable: &str, source: &InputSource, data: &Data) -> Result<Self, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        let source = match source {
            InputSource::Column(column) | InputSource::Held(column) => {
                let values = data.series(column)?;
                // Of several rows at one time, the first and the last are the limits from both sides.
                let time = data.time();
                let present: Vec<usize> = (0..time.len()).filter(|row| !values[*row].is_nan()).collect();
                let is_between =
                    |k: usize| k > 0 && k + 1 < present.len() && time[present[k - 1]] == time[present[k + 1]];
                let limits = || (0..present.len()).filter(|k| !is_between(*k)).map(|k| present[k]);
                let rows = || limits().map(|row| (time[row], values[row]));
                let is_held = matches!(source, InputSource::Held(_));
                match rows().count() {
                    0 => return setup(format!("all values of input column '{column}' are missing")),
                    n if n == values.len() && !is_held => {
                        SignalSource::Rows(data.time_series().shared(), values.shared())
                    }
                    _ => {
                        let (mut times, mut values): (Vec<f64>, Vec<f64>) = rows().unzip();
                        if is_held {
                            (times, values) = hold(&times, &values);
                        }
                        SignalSource::Rows(times.into(), values.into())
                    }
                }
            }
            InputSource::Constant(value) if !value.is_finite() => {
                return setup(format!("input '{variable}' = {} must be finite", Number(*value)));
            }
            InputSource::Constant(value) => SignalSource::Constant(*value),
            InputSource::Function(SignalFunction { function: None }) => {
                return setup(format!(
                    "input '{variable}' is a function of time, which a problem does not store. Specify it again"
                ));
            }
            InputSource::Function(function) => SignalSource::Function(function.clone()),
        };
        Ok(Self { variable: variable.to_owned(), source })
    }

    /// Adds the signal to the inputs of a simulation.
    pub(crate) fn add_to(&self, inputs: Inputs, shift: Shift) -> Inputs {
        match &self.source {
            SignalSource::Rows(times, values) => {
                let moved = match shift.delay {
                    0.0 => Arc::clone(times),
                    delay => times.iter().map(|time| time + delay).collect(),
                };
                let scaled = match (shift.factor, shift.offset) {
                    (1.0, 0.0) => Arc::clone(values),
                    _ => values.iter().map(|value| shift.of(*value)).collect(),
                };
                inputs.series(&self.variable, moved, scaled)
            }
            // A table with one row is constant in time.
            SignalSource::Constant(value) => inputs.series(&self.variable, [0.0], [shift.of(*value)]),
            SignalSource::Function(SignalFunction { function: Some(function) }) => {
                let function = function.clone();
                inputs.function(&self.variable, move |t| shift.of(function.value(t - shift.delay)))
            }
            SignalSource::Function(SignalFunction { function: None }) => inputs,
        }
    }

    /// Rejects a recording that leaves more than one of its sampling intervals of the simulation uncovered.
    /// `span` is the range of times in which the simulation evaluates the signal.
    pub(crate) fn check_covers(&self, data: &Data, span: (f64, f64)) -> Result<(), CalibrationError> {
        let SignalSource::Rows(times, _) = &self.source else { return Ok(()) };
        let recorded = (times[0], times[times.len() - 1]);
        let gap = (recorded.0 - span.0).max(span.1 - recorded.1);
        if gap <= sampling_interval(times).unwrap_or(0.0) + base::time_tolerance(span.0, span.1) {
            return Ok(());
        }
        let unit = data.time_unit();
        let [r0, r1, s0, s1] = [recorded.0, recorded.1, span.0, span.1].map(Number);
        Err(CalibrationError::Setup(format!(
            "{}: input '{}' is recorded from {r0} {unit} to {r1} {unit}, but the simulation needs it from {s0} {unit} to {s1} {unit}. \
             Set hold_inputs to hold its first and last values, or a window or start_time inside its recording",
            data.source(),
            self.variable
        )))
    }

    /// Returns values of the signal that identify it: the rows, the constant, or the function at `times`.
    pub(crate) fn samples(&self, times: &[f64]) -> Vec<f64> {
        match &self.source {
            SignalSource::Rows(_, values) => values.to_vec(),
            SignalSource::Constant(value) => vec![*value],
            SignalSource::Function(SignalFunction { function }) => {
                function.iter().flat_map(|function| times.iter().map(|t| function.value(*t))).collect()
            }
        }
    }
}

impl fmt::Display for InputSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Column(column) => write!(f, "column '{column}'"),
            Self::Held(column) => write!(f, "the held column '{column}'"),
            Self::Constant(value) => write!(f, "the constant {}", Number(*value)),
            Self::Function(_) => f.write_str("a function of time"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hold_adds_rows_only_at_changes_between_different_times() {
        let (times, values) = hold(&[0.0, 1.0, 2.0, 3.0, 3.0], &[0.0, 5.0, 5.0, 2.0, 4.0]);
        assert_eq!(times, [0.0, 1.0, 1.0, 2.0, 3.0, 3.0]);
        assert_eq!(values, [0.0, 0.0, 5.0, 5.0, 5.0, 4.0]);
    }
}
