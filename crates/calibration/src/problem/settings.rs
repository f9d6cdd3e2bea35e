//! Settings of the simulations of a fit.

#[cfg(feature = "schema")]
use crate::problem::schema;
use dfo::{Record, RecordError, Value, read_known};
use fmi::worker::{Isolation, WorkerLimits};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Settings of the simulations of a fit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(deny_unknown_fields))]
#[serde(default)]
pub struct SimulationSettings {
    /// Interface of the model; default: model exchange where it offers that, else co-simulation.
    #[cfg_attr(feature = "schema", schemars(schema_with = "schema::interface"))]
    pub kind: fmi::Kind,
    /// Integration method. Default [`ode::Method::Auto`]: the winner of a race between the methods, see
    /// [`Calibration::solver`](crate::Calibration::solver).
    #[serde(rename = "solver")]
    #[cfg_attr(feature = "schema", schemars(schema_with = "schema::solver"))]
    pub method: ode::Method,
    /// Relative tolerance; default: the model's default experiment, but at most 1e-6, else 1e-6: a fit says
    /// where it is smaller than the model's.
    pub relative_tolerance: Option<f64>,
    /// Step of a fixed-step method; the communication step of co-simulation.
    pub step_size: Option<f64>,
    /// Largest step of an adaptive method.
    pub max_step: Option<f64>,
    /// True to give a co-simulation the derivatives of its inputs, see
    /// [`SimulateOptions::input_derivatives`](fmi::SimulateOptions::input_derivatives); default: true.
    pub input_derivatives: Option<bool>,
    /// Policy for state events that follow each other so closely that time hardly advances; default: the
    /// simulation counts as failed.
    #[cfg_attr(feature = "schema", schemars(schema_with = "schema::chattering"))]
    pub chattering: ode::ChatteringPolicy,
    /// Wall-clock limit of one simulation, in s where users write it; one that reaches it counts as failed.
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0)))]
    pub timeout: Option<Duration>,
    /// Where the FMU runs. The costs do not depend on it.
    #[cfg_attr(feature = "schema", schemars(schema_with = "schema::isolation"))]
    pub isolation: Isolation,
    /// Bytes of memory that a process of the FMU may have; default: the memory of the machine.
    pub memory_limit: Option<u64>,
    /// Processes of the FMU may write into their own folder only, and open no connections.
    pub sandbox: bool,
}

/// The largest relative tolerance that simulations of a fit have where none is asked for. With it a cost of
/// residuals of usual noise is smooth far below 1e-4 of itself, the `f_tol` of a fit; at 1e-4, which many
/// models state, it is not.
const LOOSEST: f64 = 1e-6;

impl SimulationSettings {
    /// The settings of a record: `solver` is the method, `timeout` is in s, all else has the name of its
    /// field. What it does not say is as by default.
    ///
    /// # Errors
    /// A setting that there is not, or a value that it cannot have.
    pub fn asked(record: &Record) -> Result<Self, RecordError> {
        let mut record = record.clone();
        for (name, value) in &mut record {
            // Names are those that the choices have for users, times are in s.
            *value = match name.as_str() {
                "kind" => Value::of(&value.parse::<fmi::Kind>(name)?)?,
                "solver" => Value::of(&value.parse::<ode::Method>(name)?)?,
                "chattering" => Value::of(&value.parse::<ode::ChatteringPolicy>(name)?)?,
                "timeout" => Value::of(&value.read_time(name)?)?,
                "isolation" => Value::of(&value.parse::<Isolation>(name)?)?,
                "memory_limit" => Value::of(&value.read_limit(name, 1)?)?,
                _ => continue,
            };
        }
        // Unknown names are refused here alone: a fit that another version saved can be loaded.
        read_known(&record, "setting of simulations")
    }

    /// Limits of the processes of the FMU.
    pub(crate) fn worker_limits(&self) -> WorkerLimits {
        let usual = WorkerLimits::default();
        WorkerLimits { memory: self.memory_limit.or(usual.memory), sandbox: self.sandbox, ..usual }
    }

    /// The relative tolerance that simulations are asked for: what is set, else [`LOOSEST`] where the model
    /// states a larger one; `None`: its own, or the default.
    pub(crate) fn tolerance_of_fits(&self, description: &fmi::ModelDescription) -> Option<f64> {
        let stated = description.default_experiment.tolerance;
        self.relative_tolerance
            .or_else(|| stated.filter(|stated| *stated > LOOSEST && *stated < 1.0).map(|_| LOOSEST))
    }
}
