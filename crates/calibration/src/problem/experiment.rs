//! One recording: which column measures which output, which drives which input, and which part of it counts.

use crate::data::{Data, ParameterSet, Series};
use crate::error::CalibrationError;
use crate::problem::input::{InputSource, SignalFunction};
use crate::problem::parameter::Parameter;
use fmi::description::{Causality, Variability};
use fmi::{InputFunction, ModelDescription, Value};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// A recording of the machine and how the model is to reproduce it.
///
/// ```
/// use calibration::{Data, Experiment};
/// let data = Data::from_columns(vec![0.0, 0.5, 1.0], [("phi".to_owned(), vec![0.0, 0.1, 0.3])])?;
/// let experiment = Experiment::new(data).output("armJoint.phi", "phi").window(0.0, 0.5);
/// # Ok::<(), calibration::CalibrationError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Experiment {
    pub(crate) name: Option<String>,
    pub(crate) data: Data,
    /// Interval in s over which means replace the rows, until the model is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) resample: Option<f64>,
    pub(crate) outputs: Vec<Measured>,
    pub(crate) inputs: Vec<(String, InputSource)>,
    pub(crate) start_values: Vec<(String, Value)>,
    /// Those of a file, until the model is known.
    #[serde(default)]
    pub(crate) parameter_set: Option<ParameterSet>,
    pub(crate) initial_states: Vec<(String, InitialState)>,
    pub(crate) windows: Vec<(f64, f64)>,
    pub(crate) warm_up: Option<f64>,
    pub(crate) start_time: Option<f64>,
    pub(crate) hold_inputs: bool,
    /// Of outputs that are compared and inputs, in s.
    pub(crate) delays: Vec<(String, f64)>,
}

/// Initial value of a state in an experiment. In model exchange a state that the initialization computes
/// (`initial="approx"` or `"calculated"`) is set after it. In co-simulation such a state is an error if it is
/// measured or fitted, and a finding if it is a number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum InitialState {
    /// This value, in the unit of the model.
    Value(f64),
    /// The recording of the column that is compared with the state, at the start of the simulation: linear
    /// between its rows, without the offset and the delay of the output. An error where it begins later or
    /// has a gap there.
    Measured,
    /// Fitted in this experiment, from the start and within the bounds of this parameter, whose name plays no
    /// part.
    Fitted(Box<Parameter>),
}

impl From<f64> for InitialState {
    fn from(value: f64) -> Self {
        Self::Value(value)
    }
}

impl From<Parameter> for InitialState {
    fn from(parameter: Parameter) -> Self {
        Self::Fitted(Box::new(parameter))
    }
}

/// Weight of the residuals of an output; 0: the measurement does not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Weight {
    /// All with this number.
    Constant(f64),
    /// Each with what stands in its row of this column.
    Column(String),
    /// Each with the number of its row of the recording.
    Rows(Series),
    /// All with the inverse of this scale of what was measured in the whole recording, whichever part of it
    /// counts: so that outputs of different units count alike.
    Inverse(OutputScale),
}

impl Weight {
    /// True if the weight can be taken for 1 over the standard deviation of the noise.
    pub(crate) fn states_noise(&self) -> bool {
        match self {
            Self::Constant(weight) => *weight != 1.0,
            Self::Inverse(_) => false,
            Self::Column(_) | Self::Rows(_) => true,
        }
    }
}

/// Scale of the measurements of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum OutputScale {
    /// The largest less the smallest.
    Range,
    /// The size of their mean.
    Mean,
    /// Their standard deviation.
    Sd,
}

impl OutputScale {
    /// The scale of a name.
    ///
    /// # Errors
    /// A name that is none.
    pub fn named(name: &str) -> Result<Self, CalibrationError> {
        let known = [Self::Range, Self::Mean, Self::Sd];
        known.into_iter().find(|scale| scale.name().eq_ignore_ascii_case(name)).ok_or_else(|| {
            let known = known.map(|scale| format!("'{}'", scale.name())).join(", ");
            CalibrationError::Setup(format!(
                "weights = '{name}' is none of {known}; give one of them, or numbers for the outputs"
            ))
        })
    }

    /// "range", "mean" or "sd".
    pub fn name(self) -> &'static str {
        match self {
            Self::Range => "range",
            Self::Mean => "mean",
            Self::Sd => "sd",
        }
    }

    /// That of these measurements, without those that are missing.
    pub(crate) fn of(self, measured: &[f64]) -> f64 {
        let counted = || measured.iter().copied().filter(|m| !m.is_nan());
        let n = counted().count() as f64;
        let mean = counted().sum::<f64>() / n;
        match self {
            Self::Range => {
                counted().fold(f64::NEG_INFINITY, f64::max) - counted().fold(f64::INFINITY, f64::min)
            }
            Self::Mean => mean.abs(),
            Self::Sd => (counted().map(|m| (m - mean) * (m - mean)).sum::<f64>() / (n - 1.0)).sqrt(),
        }
    }
}

impl From<f64> for Weight {
    fn from(weight: f64) -> Self {
        Self::Constant(weight)
    }
}

/// An output of the model and the column that measured it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Measured {
    pub(crate) variable: String,
    pub(crate) column: String,
    pub(crate) weight: Weight,
}

impl Experiment {
    /// A recording; outputs are still to be named.
    pub fn new(data: Data) -> Self {
        Self { data, ..Self::default() }
    }

    /// Names it: in the names of [local](Parameter::local) parameters, in messages and reports; default:
    /// `run1`, `run2` and so on, by its position. Not empty, without brackets and line breaks.
    #[must_use]
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// The name of the experiment at a position, counted from 0, if it was given none.
    pub fn default_name(position: usize) -> String {
        format!("run{}", position + 1)
    }

    /// The recording.
    pub fn data(&self) -> &Data {
        &self.data
    }

    /// The outputs that are compared, each with its column, in the order of their residuals.
    pub fn outputs(&self) -> impl Iterator<Item = (&str, &str)> {
        self.outputs.iter().map(|o| (o.variable.as_str(), o.column.as_str()))
    }

    /// Intervals in which measurements count; none: they count everywhere.
    pub fn windows_of_measurements(&self) -> &[(f64, f64)] {
        &self.windows
    }

    /// Inputs with the columns that drive them.
    pub fn driving_columns(&self) -> impl Iterator<Item = (&str, &str)> {
        self.inputs.iter().filter_map(|(input, source)| match source {
            InputSource::Column(column) => Some((input.as_str(), column.as_str())),
            InputSource::Constant(_) | InputSource::Function(_) => None,
        })
    }

    /// Variables with the columns that measure or drive them.
    pub(crate) fn columns_in_use(&self) -> Vec<(String, String)> {
        let outputs = self.outputs.iter().map(|o| (o.variable.clone(), o.column.clone()));
        outputs
            .chain(self.driving_columns().map(|(input, column)| (input.to_owned(), column.to_owned())))
            .collect()
    }

    /// True if a start value is that of a local parameter.
    pub(crate) fn is_start_of_local(name: &str, parameters: &[Parameter]) -> bool {
        parameters.iter().any(|p| p.is_local() && p.is_called(name))
    }

    /// Replaces the rows of the recording by means over intervals of this length in s, beginning with the
    /// first time; each mean is placed at the mean of the times of its values. The noise falls with the root
    /// of the number of rows; signals faster than the interval are lost. Weights other than 1 are taken for 1
    /// over the standard deviation of a row: a measured column becomes the mean with their squares, and the
    /// mean has the root of the sum of these squares as its weight. Columns of Boolean and integer inputs are
    /// not averaged: they keep their values and the times where they change. A
    /// [`Calibration`](crate::Calibration) refuses an interval that is not positive, or shorter than the row
    /// spacing.
    #[must_use]
    pub fn resample(mut self, interval: f64) -> Self {
        self.resample = Some(interval);
        self
    }

    /// `column` of the data measured the model's `variable`. Residuals follow the order of these calls.
    #[must_use]
    pub fn output(self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.weighted_output(variable, column, 1.0)
    }

    /// As [`output`](Self::output); `weight` multiplies the residual (so its square multiplies the squared
    /// error): a number, or for each measurement one of its own, see [`Weight`].
    #[must_use]
    pub fn weighted_output(
        mut self,
        variable: impl Into<String>,
        column: impl Into<String>,
        weight: impl Into<Weight>,
    ) -> Self {
        self.outputs.push(Measured {
            variable: variable.into(),
            column: column.into(),
            weight: weight.into(),
        });
        self
    }

    /// `column` of the data drives the model's input `variable`: linear between the rows for a continuous
    /// input, held for a discrete one; a time that stands twice is a jump. Rows where the value is missing
    /// are left out.
    #[must_use]
    pub fn input(mut self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.inputs.push((variable.into(), InputSource::Column(column.into())));
        self
    }

    /// The model's input `variable` has this value at all times.
    #[must_use]
    pub fn constant_input(mut self, variable: impl Into<String>, value: f64) -> Self {
        self.inputs.push((variable.into(), InputSource::Constant(value)));
        self
    }

    /// The model's continuous input `variable` is this function of time, which is smooth, always gives the
    /// same, and may be called from any thread. It is not stored with a [`Problem`](crate::Problem).
    #[must_use]
    pub fn function_input(
        mut self,
        variable: impl Into<String>,
        function: impl Fn(f64) -> f64 + Send + Sync + 'static,
    ) -> Self {
        let function = SignalFunction { function: Some(InputFunction::new(function)) };
        let variable = variable.into();
        let source = InputSource::Function(function);
        // That of a stored problem has lost its function.
        let lost = InputSource::Function(SignalFunction::default());
        match self.inputs.iter_mut().find(|(known, source)| *known == variable && *source == lost) {
            Some((_, known)) => *known = source,
            None => self.inputs.push((variable, source)),
        }
        self
    }

    /// The inputs that functions drove which were not stored: [`function_input`](Self::function_input) gives
    /// them again.
    pub fn lost_functions(&self) -> impl Iterator<Item = &str> {
        let lost = InputSource::Function(SignalFunction::default());
        self.inputs.iter().filter(move |(_, source)| *source == lost).map(|(name, _)| name.as_str())
    }

    /// Holds the recordings of inputs at their first and last values where the simulation goes on beyond
    /// them, if `hold` is true. Else more than one sampling interval without a recording is an error.
    #[must_use]
    pub fn hold_inputs(mut self, hold: bool) -> Self {
        self.hold_inputs = hold;
        self
    }

    /// A value set before the simulation starts, the same for all trial parameters; of a
    /// [local](Parameter::local) parameter, where its search starts in this experiment.
    #[must_use]
    pub fn start_value(mut self, variable: impl Into<String>, value: impl Into<Value>) -> Self {
        self.start_values.push((variable.into(), value.into()));
        self
    }

    /// Start values of variables from an SSP parameter file; not of those that are fitted or driven, nor of
    /// those that have another [start value](Self::start_value).
    #[must_use]
    pub fn parameter_set(mut self, set: ParameterSet) -> Self {
        self.parameter_set = Some(set);
        self
    }

    /// Takes the values of its parameter set as start values.
    ///
    /// # Errors
    /// As [`ParameterSet::values`].
    pub(crate) fn take_parameter_set(
        &mut self,
        description: &ModelDescription,
        parameters: &[Parameter],
    ) -> Result<(), CalibrationError> {
        let Some(set) = self.parameter_set.take() else { return Ok(()) };
        let reference = |name: &str| description.variable(name).map(|v| (v.kind, v.value_reference));
        let fitted = parameters.iter().flat_map(|parameter| parameter.variable_names());
        let others = (self.inputs.iter().map(|(name, _)| name))
            .chain(self.start_values.iter().map(|(name, _)| name))
            .chain(self.initial_states.iter().map(|(name, _)| name));
        let given: HashSet<&String> = fitted.chain(others).collect();
        let references: HashSet<_> = given.iter().filter_map(|name| reference(name)).collect();
        let is_given = |name: &String| {
            given.contains(name) || reference(name).is_some_and(|own| references.contains(&own))
        };
        let values = set.values(description)?;
        let values: Vec<_> = values.into_iter().filter(|(name, _)| !is_given(name)).collect();
        self.start_values.extend(values);
        Ok(())
    }

    /// Sets the initial value of a state of the model: a value, the first measurement, or a parameter of this
    /// experiment alone.
    #[must_use]
    pub fn initial_state(mut self, state: impl Into<String>, initial: impl Into<InitialState>) -> Self {
        self.initial_states.push((state.into(), initial.into()));
        self
    }

    /// Only measurements in `[from, to]` count, or in another window of this experiment; the simulation still
    /// starts at its start time.
    #[must_use]
    pub fn window(mut self, from: f64, to: f64) -> Self {
        self.windows.push((from, to));
        self
    }

    /// Only measurements in one of these windows count, which take the place of those that were given before.
    #[must_use]
    pub fn windows(mut self, windows: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.windows = windows.into_iter().collect();
        self
    }

    /// For so many seconds from its start the simulation is not compared: it forgets its initial states. With
    /// windows and without a [start time](Self::start_time) it starts so much before the first measurement in
    /// them; else where it does without warm-up, and measurements before the end of the warm-up do not count.
    #[must_use]
    pub fn warm_up(mut self, seconds: f64) -> Self {
        self.warm_up = Some(seconds);
        self
    }

    /// An output that is compared, or an input, is late by so many seconds: `y(t - delay)` is compared with
    /// what was measured at t, and the model is driven by `u(t - delay)`. A delay that is fitted is a
    /// [parameter](Parameter::delay_of).
    #[must_use]
    pub fn delay(mut self, variable: impl Into<String>, seconds: f64) -> Self {
        self.delays.push((variable.into(), seconds));
        self
    }

    /// Where the simulation starts; default: the model's default experiment, else 0.
    #[must_use]
    pub fn start_time(mut self, start_time: f64) -> Self {
        self.start_time = Some(start_time);
        self
    }

    /// Refuses a value for something that is fitted or driven.
    pub(crate) fn check_start_values(
        &self,
        description: &ModelDescription,
        parameters: &[Parameter],
    ) -> Result<(), CalibrationError> {
        let reference = |name: &str| description.variable(name).map(|v| (v.kind, v.value_reference));
        for (given, value) in &self.start_values {
            if Self::is_start_of_local(given, parameters) {
                continue;
            }
            let is_it = |p: &&Parameter| {
                let of = reference(given);
                (p.variable_names().iter()).any(|v| v == given || (of.is_some() && reference(v) == of))
            };
            if let Some(parameter) = parameters.iter().find(is_it) {
                let name = parameter.name().to_owned();
                let alias = if *given == name { String::new() } else { format!(" (as '{given}')") };
                let message = format!(
                    "it is fitted, and start_values gives it the value {value}{alias}: one of both counts"
                );
                return Err(CalibrationError::Parameter { name, message });
            }
            let is_driven = |(input, _): &&(String, InputSource)| {
                input == given || reference(given).is_some_and(|of| reference(input) == Some(of))
            };
            if let Some((input, source)) = self.inputs.iter().find(is_driven) {
                return Err(CalibrationError::Setup(format!(
                    "input '{input}' is driven by {source}, and start_values gives it the value {value}: one of both counts"
                )));
            }
        }
        Ok(())
    }

    /// Refuses outputs that are no results of the simulation.
    pub(crate) fn check_outputs(
        &self,
        description: &ModelDescription,
        parameters: &[String],
    ) -> Result<(), CalibrationError> {
        let reference = |name: &str| description.variable(name).map(|v| (v.kind, v.value_reference));
        for (index, Measured { variable, column, .. }) in self.outputs.iter().enumerate() {
            if self.outputs[..index].iter().any(|o| (&o.variable, &o.column) == (variable, column)) {
                return Err(CalibrationError::Setup(format!(
                    "output '{variable}' is compared with column '{column}' twice; a weight makes it count more"
                )));
            }
            let Some(declared) = description.variable(variable) else {
                match variable.as_str() {
                    "time" => return Err(no_result(variable, column, "the time")),
                    // What else has no name of its own is an element of an array.
                    name if name.contains(['*', '?']) => {
                        return Err(CalibrationError::Setup(format!(
                            "output '{name}': a measured column is compared with one variable; patterns name several"
                        )));
                    }
                    _ => continue,
                }
            };
            let own = Some((declared.kind, declared.value_reference));
            let is_fitted = parameters.iter().any(|p| reference(p) == own);
            let what = match declared.causality {
                Causality::Parameter if is_fitted => "a parameter that is fitted",
                Causality::Parameter | Causality::StructuralParameter => "a parameter",
                Causality::Input => "an input",
                Causality::Independent => "the time",
                _ if declared.variability == Variability::Constant => "a constant",
                _ => continue,
            };
            return Err(no_result(variable, column, what));
        }
        Ok(())
    }
}

fn no_result(variable: &str, column: &str, what: &str) -> CalibrationError {
    CalibrationError::Setup(format!(
        "output '{variable}' is compared with column '{column}', but it is {what}, not a result of the simulation"
    ))
}
