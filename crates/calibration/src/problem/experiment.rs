//! One recording: the columns that measure outputs or drive inputs, and the part of the recording that
//! counts.

use crate::data::{Data, ParameterSet, Series};
use crate::error::CalibrationError;
use crate::problem::error_model::{Coefficient, ErrorModel};
use crate::problem::input::{InputSource, SignalFunction};
use crate::problem::parameter::Parameter;
use fmi::description::{Causality, Variability};
use fmi::{InputFunction, ModelDescription, SteadyStart, Value};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// A recording of the machine and its mapping to the model. All times and durations are in the [time
/// unit](fmi::ModelDescription::time_unit) of the model, usually s.
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
    /// Interval over which means replace the rows; `None` after the means have been computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) resample: Option<f64>,
    pub(crate) outputs: Vec<Measured>,
    pub(crate) inputs: Vec<(String, InputSource)>,
    pub(crate) start_values: Vec<(String, Value)>,
    /// Start values from a file, until the model is known.
    #[serde(default)]
    pub(crate) parameter_set: Option<ParameterSet>,
    pub(crate) initial_states: Vec<(String, InitialState)>,
    /// Start from steady state, except the states with initial values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) steady: Option<SteadyStart>,
    pub(crate) windows: Vec<(f64, f64)>,
    pub(crate) warm_up: Option<f64>,
    pub(crate) start_time: Option<f64>,
    /// End of the simulation if no output is compared with a column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) final_time: Option<f64>,
    /// Factor of the goals in this scenario.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) weight: Option<f64>,
    pub(crate) hold_inputs: bool,
    /// Delays of compared outputs and of inputs.
    pub(crate) delays: Vec<(String, f64)>,
}

/// Initial value of a state in an experiment. In model exchange, a state that the initialization computes
/// (`initial="approx"` or `"calculated"`) is set after the initialization. In co-simulation, measuring or
/// fitting such a state is an error, and giving it a number is a finding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum InitialState {
    /// A value in the unit of the model.
    Value(f64),
    /// The value of the column that is compared with the state, at the start of the simulation. It is
    /// interpolated linearly between the rows, without the offset and the delay of the output. It is an error
    /// if the column starts later or has a gap there.
    Measured,
    /// The value of the column that is compared with this output, at the start of the simulation, as for
    /// [`Measured`](Self::Measured). Use it for the parameter of the model that is the start value of the
    /// output. It must have the unit of the output.
    MeasuredBy(String),
    /// A value fitted in this experiment, with the start and bounds of this parameter. The name of the
    /// parameter is ignored.
    Fitted(Box<Parameter>),
}

impl InitialState {
    /// Returns the initial state of a word: `measured`, or `measured:` and the name of an output.
    ///
    /// # Errors
    /// Returns an error for any other word.
    pub fn named(state: &str, word: &str) -> Result<Self, CalibrationError> {
        let (keyword, output) =
            word.split_once(':').map_or((word, None), |(word, of)| (word, Some(of.trim())));
        match output {
            _ if !keyword.trim().eq_ignore_ascii_case("measured") => {}
            None => return Ok(Self::Measured),
            Some("") => {}
            Some(output) => return Ok(Self::MeasuredBy(output.to_owned())),
        }
        Err(CalibrationError::Setup(format!(
            "initial_states: '{state}' = '{word}' must be a number, 'measured', 'measured:' and the name of an output, or a parameter \
             with start, lower and upper; only '*' (all other states) may be 'steady'"
        )))
    }

    /// Returns the output whose column has the value of this variable.
    pub(crate) fn measured_output<'a>(&'a self, variable: &'a str) -> Option<&'a str> {
        match self {
            Self::Measured => Some(variable),
            Self::MeasuredBy(output) => Some(output),
            Self::Value(_) | Self::Fitted(_) => None,
        }
    }
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

/// Weight of the residuals of an output. A measurement with weight 0 does not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Weight {
    /// One number for all measurements.
    Constant(f64),
    /// The value of this column in the row of the measurement.
    Column(String),
    /// One number for each row of the recording.
    Rows(Series),
    /// The inverse of this scale for all measurements, so that outputs in different units have comparable
    /// weight. The scale is computed from the whole recording, even if only a part of it counts.
    Inverse(OutputScale),
    /// The inverse of a known standard deviation. Standard errors, intervals, profiles and bands are then
    /// absolute: the size of the residuals does not change them.
    Sigma(Sigma),
    /// This factor of the difference of the logarithms, `ln(simulated) - ln(measured)`, for log-normal noise.
    /// The standard deviation is unknown, as with [`Constant`](Self::Constant). A measurement must be
    /// positive, and a simulated value that is not positive fails the simulation.
    Log(f64),
}

/// Text that selects a [steady start](Experiment::steady_start).
pub(crate) const STEADY: &str = "steady";

/// Text that selects [`Weight::Log`].
const LOGARITHM: &str = "log";

/// Known standard deviation of the noise of an output, in the unit of its column. A measurement with an
/// infinite standard deviation does not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Sigma {
    /// One number for all measurements.
    Constant(f64),
    /// The value of this column in the row of the measurement.
    Column(String),
    /// One number for each row of the recording.
    Rows(Series),
    /// A function of the simulated value. A fit alternates with the standard deviations until they settle.
    Model(ErrorModel),
}

impl Sigma {
    /// Returns the standard deviations that belong to these weights.
    pub(crate) fn of_weights(weights: &[f64]) -> Self {
        Self::Rows(weights.iter().map(|weight| 1.0 / weight).collect())
    }
}

impl Weight {
    /// Returns the weight of a text that describes the noise of a measured column: `log` (in upper or lower
    /// case) for the [logarithm](Self::Log), an [`ErrorModel`] such as `0.1 + 0.05*abs(y)`, otherwise the
    /// values of the column with this name.
    ///
    /// # Errors
    /// Returns an error with the name of the measured `column` if the text contains `abs(` but is not an
    /// error model.
    pub fn of_sigma(text: &str, column: &str) -> Result<Self, CalibrationError> {
        if !Self::is_sigma(text) {
            return Ok(Sigma::Column(text.to_owned()).into());
        }
        if text.eq_ignore_ascii_case(LOGARITHM) {
            return Ok(Self::Log(1.0));
        }
        match text.parse::<ErrorModel>() {
            Ok(ErrorModel {
                constant: Coefficient::Stated(sigma),
                proportional: Coefficient::Stated(0.0),
            }) => Ok(Sigma::Constant(sigma).into()),
            Ok(model) => Ok(Sigma::Model(model).into()),
            Err(reason) => Err(CalibrationError::Setup(format!("sigma of column '{column}': {reason}"))),
        }
    }

    /// True if a text given as sigma is not the name of a column.
    pub fn is_sigma(text: &str) -> bool {
        text.eq_ignore_ascii_case(LOGARITHM) || ErrorModel::is_meant(text)
    }

    /// Returns the column with the weights or standard deviations, if any.
    pub(crate) fn column(&self) -> Option<&str> {
        match self {
            Self::Column(column) | Self::Sigma(Sigma::Column(column)) => Some(column),
            _ => None,
        }
    }

    /// True if the weight is the inverse of a known standard deviation.
    pub(crate) fn is_known_noise(&self) -> bool {
        matches!(self, Self::Sigma(_)) && !self.error_model().is_some_and(ErrorModel::is_fitted)
    }

    /// Returns the error model, if any.
    pub(crate) fn error_model(&self) -> Option<&ErrorModel> {
        match self {
            Self::Sigma(Sigma::Model(model)) => Some(model),
            _ => None,
        }
    }

    /// Returns the inverse of the [scale](OutputScale::named) with this name, otherwise the values of the
    /// column with this name.
    pub fn named(name: &str) -> Self {
        OutputScale::named(name).map_or_else(|_| Self::Column(name.to_owned()), Self::Inverse)
    }

    /// True if the weight can be interpreted as 1 over the standard deviation of the noise.
    pub(crate) fn states_noise(&self) -> bool {
        match self {
            Self::Constant(weight) => *weight != 1.0,
            Self::Inverse(_) => false,
            Self::Log(weight) => *weight != 1.0,
            Self::Column(_) | Self::Rows(_) | Self::Sigma(_) => true,
        }
    }

    /// True if the weight only divides by the scale of the measurements.
    pub(crate) fn is_scale(&self) -> bool {
        matches!(self, Self::Inverse(_))
    }
}

impl From<Sigma> for Weight {
    fn from(sigma: Sigma) -> Self {
        Self::Sigma(sigma)
    }
}

/// Scale of the measurements of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum OutputScale {
    /// The largest minus the smallest measurement.
    Range,
    /// Absolute value of the mean.
    Mean,
    /// Standard deviation.
    Sd,
}

impl OutputScale {
    /// Returns the scale with this name.
    ///
    /// # Errors
    /// Returns an error if no scale has this name.
    pub fn named(name: &str) -> Result<Self, CalibrationError> {
        let scales = [Self::Range, Self::Mean, Self::Sd];
        scales.into_iter().find(|scale| scale.name().eq_ignore_ascii_case(name)).ok_or_else(|| {
            let listed = scales.map(|scale| format!("'{}'", scale.name())).join(", ");
            CalibrationError::Setup(format!(
                "weights = '{name}' is unknown; expected {listed}, or numbers for the outputs"
            ))
        })
    }

    /// Returns "range", "mean" or "sd".
    pub fn name(self) -> &'static str {
        match self {
            Self::Range => "range",
            Self::Mean => "mean",
            Self::Sd => "sd",
        }
    }

    /// Returns the scale of these measurements, without the missing ones.
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
    /// Creates an experiment from a recording, without outputs.
    pub fn new(data: Data) -> Self {
        Self { data, ..Self::default() }
    }

    /// Sets the end of the simulation of a [scenario](crate::Design). Default: the last row of its data,
    /// otherwise the stop time of the model.
    #[must_use]
    pub fn final_time(mut self, time: f64) -> Self {
        self.final_time = Some(time);
        self
    }

    /// Sets the factor of the goals in this [scenario](crate::Design). Default: 1.
    #[must_use]
    pub fn scenario_weight(mut self, weight: f64) -> Self {
        self.weight = Some(weight);
        self
    }

    /// Sets the name used in [local](Parameter::local) parameters, messages and reports. Default: `run1`,
    /// `run2` and so on, by position. The name must not be empty and must not contain brackets or line
    /// breaks.
    #[must_use]
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// Returns the default name of the experiment at a position, counted from 0.
    pub fn default_name(position: usize) -> String {
        format!("run{}", position + 1)
    }

    /// Returns the recording.
    pub fn data(&self) -> &Data {
        &self.data
    }

    /// Returns the compared outputs, each with its column, in the order of their residuals.
    pub fn outputs(&self) -> impl Iterator<Item = (&str, &str)> {
        self.outputs.iter().map(|o| (o.variable.as_str(), o.column.as_str()))
    }

    /// Returns the intervals in which measurements count. If it is empty, all measurements count.
    pub fn windows_of_measurements(&self) -> &[(f64, f64)] {
        &self.windows
    }

    /// Returns the inputs with the columns that drive them.
    pub fn driving_columns(&self) -> impl Iterator<Item = (&str, &str)> {
        self.inputs.iter().filter_map(|(input, source)| Some((input.as_str(), source.column()?)))
    }

    /// True if the values of this input are held between the rows of its column.
    pub(crate) fn holds(&self, input: &str) -> bool {
        self.inputs.iter().any(|(name, source)| name == input && matches!(source, InputSource::Held(_)))
    }

    /// Returns the variables with the columns that measure or drive them.
    pub(crate) fn columns_in_use(&self) -> Vec<(String, String)> {
        let outputs = self.outputs.iter().map(|o| (o.variable.clone(), o.column.clone()));
        outputs
            .chain(self.driving_columns().map(|(input, column)| (input.to_owned(), column.to_owned())))
            .collect()
    }

    /// True if a start value belongs to a local parameter.
    pub(crate) fn is_start_of_local(name: &str, parameters: &[Parameter]) -> bool {
        parameters.iter().any(|p| p.is_local() && p.is_called(name))
    }

    /// Replaces the rows of the recording by means over intervals of this length, beginning with the
    /// first time. Each mean is placed at the mean of the times of its values. The noise decreases with the
    /// square root of the number of rows. Signals faster than the interval are lost.
    ///
    /// Weights other than 1 are interpreted as 1 over the standard deviation of a row. The mean of a measured
    /// column is then weighted with the squares of its weights. The weight of the mean is the square root of
    /// the sum of these squares. Columns of Boolean and integer inputs are not averaged: they keep their
    /// values and the times of their changes.
    ///
    /// A [`Calibration`](crate::Calibration) rejects an interval that is not positive or is shorter than the
    /// row spacing.
    #[must_use]
    pub fn resample(mut self, interval: f64) -> Self {
        self.resample = Some(interval);
        self
    }

    /// Compares the variable `variable` of the model with the column `column` of the data. Residuals follow
    /// the order of these calls.
    #[must_use]
    pub fn output(self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.weighted_output(variable, column, 1.0)
    }

    /// Compares like [`output`](Self::output), with a weight. The `weight` multiplies the residual, so its
    /// square multiplies the squared error. It is one number, or a separate number for each measurement; see
    /// [`Weight`].
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

    /// Drives the input `variable` of the model with the column `column` of the data. The values are
    /// interpolated linearly between rows for a continuous input and held for a discrete input. A repeated
    /// time is a jump. Rows with a missing value are skipped.
    #[must_use]
    pub fn input(mut self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.inputs.push((variable.into(), InputSource::Column(column.into())));
        self
    }

    /// Drives the input `variable` as [`input`](Self::input) does, but holds each value until the next row
    /// (zero-order hold). Each change is an event. [`resample`](Self::resample) keeps the values and the
    /// times of their changes.
    #[must_use]
    pub fn held_input(mut self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.inputs.push((variable.into(), InputSource::Held(column.into())));
        self
    }

    /// Sets the input `variable` of the model to this value at all times.
    #[must_use]
    pub fn constant_input(mut self, variable: impl Into<String>, value: f64) -> Self {
        self.inputs.push((variable.into(), InputSource::Constant(value)));
        self
    }

    /// Sets the continuous input `variable` of the model to this function of time. The function must be
    /// smooth and deterministic, and callable from any thread. It is not stored with a
    /// [`Problem`](crate::Problem).
    #[must_use]
    pub fn function_input(
        mut self,
        variable: impl Into<String>,
        function: impl Fn(f64) -> f64 + Send + Sync + 'static,
    ) -> Self {
        let function = SignalFunction { function: Some(InputFunction::new(function)) };
        let variable = variable.into();
        let source = InputSource::Function(function);
        // An input of a stored problem has lost its function.
        let lost = InputSource::Function(SignalFunction::default());
        match self.inputs.iter_mut().find(|(name, source)| *name == variable && *source == lost) {
            Some((_, entry)) => *entry = source,
            None => self.inputs.push((variable, source)),
        }
        self
    }

    /// Returns the inputs whose functions were not stored. Set these functions again with
    /// [`function_input`](Self::function_input).
    pub fn lost_functions(&self) -> impl Iterator<Item = &str> {
        let lost = InputSource::Function(SignalFunction::default());
        self.inputs.iter().filter(move |(_, source)| *source == lost).map(|(name, _)| name.as_str())
    }

    /// Sets whether inputs keep the first and last values of their recordings outside the recorded times. If
    /// `hold` is false, more than one sampling interval without a recording is an error.
    #[must_use]
    pub fn hold_inputs(mut self, hold: bool) -> Self {
        self.hold_inputs = hold;
        self
    }

    /// Sets a value before the simulation starts, the same for all trial parameters. For a
    /// [local](Parameter::local) parameter, the value is the start of its search in this experiment.
    #[must_use]
    pub fn start_value(mut self, variable: impl Into<String>, value: impl Into<Value>) -> Self {
        self.start_values.push((variable.into(), value.into()));
        self
    }

    /// Sets start values of variables from an SSP parameter file. Variables that are fitted, driven, or have
    /// another [start value](Self::start_value) are skipped.
    #[must_use]
    pub fn parameter_set(mut self, set: ParameterSet) -> Self {
        self.parameter_set = Some(set);
        self
    }

    /// Adds the values of the parameter set to the start values.
    ///
    /// # Errors
    /// Returns the errors of [`ParameterSet::values`].
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
            given.contains(name)
                || reference(name).is_some_and(|of_variable| references.contains(&of_variable))
        };
        let values = set.values(description)?;
        let values: Vec<_> = values.into_iter().filter(|(name, _)| !is_given(name)).collect();
        self.start_values.extend(values);
        Ok(())
    }

    /// Sets the initial value of a state of the model: a number, the first measurement, or a parameter of
    /// this experiment only.
    #[must_use]
    pub fn initial_state(mut self, state: impl Into<String>, initial: impl Into<InitialState>) -> Self {
        self.initial_states.push((state.into(), initial.into()));
        self
    }

    /// Brings the model to rest at the first values of its inputs before the recording, for each trial
    /// parameter set (model exchange). States with an [initial state](Self::initial_state) keep it. A model
    /// that does not come to rest within the limit is a failed evaluation. See [`SteadyStart`].
    #[must_use]
    pub fn steady_start(mut self, steady: SteadyStart) -> Self {
        self.steady = Some(steady);
        self
    }

    /// Adds a window: only measurements in `[from, to]` or in another window of this experiment count. The
    /// start time of the simulation does not change, except with [`warm_up`](Self::warm_up).
    #[must_use]
    pub fn window(mut self, from: f64, to: f64) -> Self {
        self.windows.push((from, to));
        self
    }

    /// Replaces all windows: only measurements in one of these windows count.
    #[must_use]
    pub fn windows(mut self, windows: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.windows = windows.into_iter().collect();
        self
    }

    /// Sets a warm-up after the start of the simulation, in which the simulation is not compared.
    /// Meanwhile the model forgets its initial states. With windows and without a [start
    /// time](Self::start_time), the simulation starts this long before the first measurement in the windows.
    /// Otherwise the start does not change, and measurements before the end of the warm-up do not count.
    #[must_use]
    pub fn warm_up(mut self, seconds: f64) -> Self {
        self.warm_up = Some(seconds);
        self
    }

    /// Sets the delay of a compared output or of an input. An output `y(t - delay)` is compared with the
    /// measurement at t. An input drives the model with `u(t - delay)`. Use a
    /// [parameter](Parameter::delay_of) to fit a delay.
    #[must_use]
    pub fn delay(mut self, variable: impl Into<String>, seconds: f64) -> Self {
        self.delays.push((variable.into(), seconds));
        self
    }

    /// Sets the start time of the simulation. Default: the start of the model's default experiment,
    /// otherwise 0.
    #[must_use]
    pub fn start_time(mut self, start_time: f64) -> Self {
        self.start_time = Some(start_time);
        self
    }

    /// Rejects start values of variables that are fitted or driven.
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
                let message =
                    format!("it is fitted, but start_values sets it to {value}{alias}. Remove one of them");
                return Err(CalibrationError::Parameter { name, message });
            }
            let is_driven = |(input, _): &&(String, InputSource)| {
                input == given || reference(given).is_some_and(|of| reference(input) == Some(of))
            };
            if let Some((input, source)) = self.inputs.iter().find(is_driven) {
                return Err(CalibrationError::Setup(format!(
                    "input '{input}' is driven by {source}, but start_values sets it to {value}. Remove one of them"
                )));
            }
        }
        Ok(())
    }

    /// Rejects outputs that are not results of the simulation.
    pub(crate) fn check_outputs(
        &self,
        description: &ModelDescription,
        parameters: &[String],
    ) -> Result<(), CalibrationError> {
        let reference = |name: &str| description.variable(name).map(|v| (v.kind, v.value_reference));
        for (index, Measured { variable, column, .. }) in self.outputs.iter().enumerate() {
            if self.outputs[..index].iter().any(|o| (&o.variable, &o.column) == (variable, column)) {
                return Err(CalibrationError::Setup(format!(
                    "output '{variable}' is compared with column '{column}' twice. Set a weight to increase its influence"
                )));
            }
            let Some(declared) = description.variable(variable) else {
                match variable.as_str() {
                    "time" => return Err(no_result(variable, column, "the time")),
                    // Any other name that is not declared is an element of an array.
                    name if name.contains(['*', '?']) => {
                        return Err(CalibrationError::Setup(format!(
                            "output '{name}' is a pattern, but a measured column is compared with one variable. Specify one variable"
                        )));
                    }
                    _ => continue,
                }
            };
            let identity = Some((declared.kind, declared.value_reference));
            let is_fitted = parameters.iter().any(|p| reference(p) == identity);
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
