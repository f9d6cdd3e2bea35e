//! One recording: which column measures which output, which drives which input, and which part of it counts.

use crate::data::Data;
use crate::error::CalibrationError;
use crate::parameter::Parameter;
use fmi::description::{Causality, Variability};
use fmi::{Inputs, ModelDescription, Value};
use ode::Number;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Where no start time is given, a recording may begin so many of its sampling intervals after the model's.
const MOST_BEFORE: f64 = 10.0;

/// A recording of the machine and how the model is to reproduce it.
///
/// ```
/// use calibration::{Data, Experiment};
/// let data = Data::from_columns(vec![0.0, 0.5, 1.0], [("phi".to_owned(), vec![0.0, 0.1, 0.3])])?;
/// let experiment = Experiment::new(data).output("armJoint.phi", "phi").window(0.0, 0.5);
/// # Ok::<(), calibration::CalibrationError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    pub(crate) name: Option<String>,
    pub(crate) data: Data,
    pub(crate) outputs: Vec<Measured>,
    pub(crate) inputs: Vec<(String, String)>,
    pub(crate) start_values: Vec<(String, Value)>,
    pub(crate) window: Option<(f64, f64)>,
    pub(crate) start_time: Option<f64>,
}

/// An output of the model and the column that measured it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Measured {
    pub(crate) variable: String,
    pub(crate) column: String,
    pub(crate) weight: f64,
}

impl Experiment {
    /// A recording; outputs are still to be named.
    pub fn new(data: Data) -> Self {
        Self {
            name: None,
            data,
            outputs: Vec::new(),
            inputs: Vec::new(),
            start_values: Vec::new(),
            window: None,
            start_time: None,
        }
    }

    /// Names it: in the names of [local](Parameter::local) parameters, in messages and reports; default: `run1`, `run2` and
    /// so on, by its position. Not empty, without brackets and line breaks.
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

    /// The inputs that are driven, each with its column.
    pub fn inputs(&self) -> impl Iterator<Item = (&str, &str)> {
        self.inputs.iter().map(|(variable, column)| (variable.as_str(), column.as_str()))
    }

    /// Where measurements count, if that is not everywhere.
    pub fn window_of_measurements(&self) -> Option<(f64, f64)> {
        self.window
    }

    /// Variables with the columns that measure or drive them.
    pub(crate) fn columns_in_use(&self) -> Vec<(String, String)> {
        let outputs = self.outputs.iter().map(|o| (o.variable.clone(), o.column.clone()));
        outputs.chain(self.inputs.iter().cloned()).collect()
    }

    /// Whether a start value is that of a local parameter.
    pub(crate) fn is_start_of_local(name: &str, parameters: &[Parameter]) -> bool {
        parameters.iter().any(|p| p.is_local() && p.variable() == name)
    }

    /// `column` of the data measured the model's `variable`. Residuals follow the order of these calls.
    #[must_use]
    pub fn output(self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.weighted_output(variable, column, 1.0)
    }

    /// As [`output`](Self::output); `weight` multiplies the residual (so its square multiplies the squared error).
    #[must_use]
    pub fn weighted_output(
        mut self,
        variable: impl Into<String>,
        column: impl Into<String>,
        weight: f64,
    ) -> Self {
        self.outputs.push(Measured { variable: variable.into(), column: column.into(), weight });
        self
    }

    /// `column` of the data drives the model's input `variable`: linear between the rows for a continuous input, held
    /// for a discrete one; a time that stands twice is a jump. Rows where the value is missing are left out.
    #[must_use]
    pub fn input(mut self, variable: impl Into<String>, column: impl Into<String>) -> Self {
        self.inputs.push((variable.into(), column.into()));
        self
    }

    /// A value set before the simulation starts, the same for all trial parameters; of a [local](Parameter::local) parameter,
    /// where its search starts in this experiment.
    #[must_use]
    pub fn start_value(mut self, variable: impl Into<String>, value: impl Into<Value>) -> Self {
        self.start_values.push((variable.into(), value.into()));
        self
    }

    /// Only measurements in `[from, to]` count; the simulation still starts at its start time.
    #[must_use]
    pub fn window(mut self, from: f64, to: f64) -> Self {
        self.window = Some((from, to));
        self
    }

    /// Where the simulation starts; default: the model's default experiment, else 0.
    #[must_use]
    pub fn start_time(mut self, start_time: f64) -> Self {
        self.start_time = Some(start_time);
        self
    }

    /// Times and, per output, measurements that count.
    pub(crate) fn measurements(&self) -> Result<(Vec<f64>, Vec<Vec<f64>>), CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        if self.outputs.is_empty() {
            return setup(format!("{}: no output is compared with a column", self.data.source()));
        }
        let (from, to) = self.window.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
        if from.is_nan() || to.is_nan() || from > to {
            return setup(format!("window from {from} to {to}: the end must not lie before the start"));
        }
        let time = self.data.time();
        let rows = time.partition_point(|t| *t < from)..time.partition_point(|t| *t <= to);
        if rows.is_empty() {
            return setup(format!(
                "no time of {} lies in the window from {from} to {to}; the times run from {} to {}",
                self.data.source(),
                time[0],
                time[time.len() - 1]
            ));
        }
        let mut columns = Vec::with_capacity(self.outputs.len());
        for Measured { variable, column, weight } in &self.outputs {
            if !(weight.is_finite() && *weight > 0.0) {
                return setup(format!("weight {weight} of output '{variable}' must be positive and finite"));
            }
            columns.push(self.data.measured(column, rows.clone())?.to_vec());
        }
        Ok((time[rows].to_vec(), columns))
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
                p.variable() == given
                    || reference(given).is_some_and(|of| reference(p.variable()) == Some(of))
            };
            if let Some(parameter) = parameters.iter().find(is_it) {
                let name = parameter.name().to_owned();
                let alias = if *given == name { String::new() } else { format!(" (as '{given}')") };
                let message = format!(
                    "it is fitted, and start_values gives it the value {value}{alias}: one of both counts"
                );
                return Err(CalibrationError::Parameter { name, message });
            }
            let is_driven = |(input, _): &&(String, String)| {
                input == given || reference(given).is_some_and(|of| reference(input) == Some(of))
            };
            if let Some((input, column)) = self.inputs.iter().find(is_driven) {
                return Err(CalibrationError::Setup(format!(
                    "input '{input}' is driven by column '{column}', and start_values gives it the value {value}: one of \
                     both counts"
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

    /// Refuses to simulate a long time before the recording where the start time is only the model's default.
    pub(crate) fn check_begin(&self, start_time: f64) -> Result<(), CalibrationError> {
        let begin = self.data.time()[0];
        match self.data.sampling_interval() {
            Some(interval) if self.start_time.is_none() && begin - start_time > MOST_BEFORE * interval => {
                let [begin, start, before] = [begin, start_time, begin - start_time].map(Number);
                Err(CalibrationError::Setup(format!(
                    "{}: the recording begins at {begin} s, the simulation at {start} s. Give start_time = {begin} to start \
                     with the recording, or start_time = {start} to simulate the {before} s before it as well",
                    self.data.source()
                )))
            }
            _ => Ok(()),
        }
    }

    /// The inputs: each keeps the rows where it has a value.
    pub(crate) fn input_table(&self) -> Result<Option<Inputs>, CalibrationError> {
        if self.inputs.is_empty() {
            return Ok(None);
        }
        let mut inputs = Inputs::new();
        for (variable, column) in &self.inputs {
            let values = self.data.column(column)?;
            let rows = || self.data.time().iter().zip(values).filter(|(_, v)| !v.is_nan());
            if rows().next().is_none() {
                return Err(CalibrationError::Setup(format!(
                    "all values of input column '{column}' are missing"
                )));
            }
            let (times, values): (Vec<f64>, Vec<f64>) = rows().unzip();
            inputs = inputs.series(variable, times, values);
        }
        Ok(Some(inputs))
    }
}

/// How the simulations of a fit are made.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SimulationSettings {
    /// How the model is run; default: by model exchange where it offers that, else by co-simulation.
    pub kind: fmi::Kind,
    /// Integration method. Default [`ode::Method::Auto`]: the winner of a race between the methods, see
    /// [`Calibration::solver`](crate::Calibration::solver).
    pub method: ode::Method,
    /// Relative tolerance; default: the model's default experiment, else 1e-6.
    pub relative_tolerance: Option<f64>,
    /// Step of a fixed-step method; the communication step of co-simulation.
    pub step_size: Option<f64>,
    /// Largest step of an adaptive method.
    pub max_step: Option<f64>,
    /// Whether a co-simulation is told the derivatives of its inputs, see
    /// [`SimulateOptions::input_derivatives`](fmi::SimulateOptions::input_derivatives); default: yes.
    pub input_derivatives: Option<bool>,
    /// What happens when state events follow each other so closely that time hardly advances; default: the simulation
    /// counts as failed.
    pub chattering: ode::ChatteringPolicy,
    /// Wall-clock limit of one simulation; one that reaches it counts as failed.
    pub timeout: Option<Duration>,
    /// How simulations that run in parallel share the library of the FMU. The costs do not depend on it.
    pub sharing: fmi::Sharing,
}

fn no_result(variable: &str, column: &str, what: &str) -> CalibrationError {
    CalibrationError::Setup(format!(
        "output '{variable}' is compared with column '{column}', but it is {what}, not a result of the simulation"
    ))
}
