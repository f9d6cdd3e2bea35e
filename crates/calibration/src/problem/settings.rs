//! Settings of the simulations of a fit.

use crate::data::Unit;
use crate::error::CalibrationError;
#[cfg(feature = "schema")]
use crate::problem::schema;
use dfo::{Record, RecordError, Value, read_known, read_part};
use fmi::worker::{Isolation, WorkerLimits};
use fmi::{OpenOptions, RunSettings};
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;

/// Settings of the simulations of a fit.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(deny_unknown_fields))]
#[serde(default)]
pub struct SimulationSettings {
    /// How the model is run. A `relative_tolerance` that is not given is that of the model, but at most 1e-6:
    /// a fit reports where it is smaller than that of the model. A simulation that reaches the `timeout`, or
    /// whose events let time hardly advance, counts as failed.
    #[serde(flatten)]
    pub run: RunSettings,
    /// Where the FMU runs. The costs do not depend on it.
    #[cfg_attr(feature = "schema", schemars(schema_with = "schema::isolation"))]
    pub isolation: Isolation,
    /// Bytes of memory that a process of the FMU may have; default: the memory of the machine.
    pub memory_limit: Option<u64>,
    /// Processes of the FMU may write into their own folder only, and open no connections.
    pub sandbox: bool,
    /// Bytes that the `modelDescription.xml` of the model may have; default: see
    /// [`DescriptionLimits`](fmi::DescriptionLimits).
    pub max_description_bytes: Option<u64>,
    /// Units of variables of which the model states none, by name: recorded columns are converted to them.
    pub units: BTreeMap<String, String>,
}

/// A field of the settings, for messages.
const SETTING: &str = "setting of simulations";

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
    pub fn from_record(record: &Record) -> Result<Self, RecordError> {
        let mut record = record.clone();
        for (name, value) in &mut record {
            // Names are those that the choices have for users, times are in s.
            *value = match name.as_str() {
                "kind" => Value::of(&value.parse::<fmi::InterfaceChoice>(name)?)?,
                "solver" => Value::of(&value.parse::<ode::Method>(name)?)?,
                "chattering" => Value::of(&value.parse::<ode::ChatteringPolicy>(name)?)?,
                "timeout" => Value::of(&value.read_time(name)?)?,
                "isolation" => Value::of(&value.parse::<Isolation>(name)?)?,
                "memory_limit" | "max_description_bytes" => Value::of(&value.read_limit(name, 1)?)?,
                _ => continue,
            };
        }
        // In two parts, so that an error has the name of its field. Unknown names are refused here alone: a fit
        // that another version saved can be loaded.
        let (run, others) = read_part(record, SETTING)?;
        Ok(Self { run, ..read_known(&others, SETTING)? })
    }

    /// How the model is opened.
    pub fn open_options(&self) -> OpenOptions {
        let mut options = OpenOptions::default();
        options.description.bytes = self.max_description_bytes.unwrap_or(options.description.bytes);
        options
    }

    /// The model with the units that are stated here.
    ///
    /// # Errors
    /// A unit that is none, a variable that there is not, or that has another unit.
    pub(crate) fn with_units(&self, fmu: fmi::Fmu) -> Result<fmi::Fmu, CalibrationError> {
        if self.units.is_empty() {
            return Ok(fmu);
        }
        let defined = &fmu.description().units;
        for (variable, unit) in &self.units {
            if !defined.iter().any(|known| known.name == *unit) {
                Unit::parse(unit)
                    .map_err(|error| CalibrationError::Setup(format!("units: '{variable}': {error}")))?;
            }
        }
        Ok(fmu.with_units(self.units.iter().map(|(variable, unit)| (&variable[..], &unit[..])))?)
    }

    /// Limits of the processes of the FMU.
    pub(crate) fn worker_limits(&self) -> WorkerLimits {
        let usual = WorkerLimits::default();
        WorkerLimits { memory: self.memory_limit.or(usual.memory), sandbox: self.sandbox, ..usual }
    }

    /// How the model is run in a fit: with the relative tolerance that is set, else [`LOOSEST`] where the
    /// model states a larger one.
    pub(crate) fn run_of_fits(&self, description: &fmi::ModelDescription) -> RunSettings {
        let mut run = self.run.clone();
        let stated = description.default_experiment.tolerance;
        if run.relative_tolerance.is_none() && stated.is_some_and(|stated| stated > LOOSEST && stated < 1.0) {
            run.relative_tolerance = Some(LOOSEST);
        }
        run
    }
}

/// As one record, with the number of its fields: files are to have one form, and a flattened field does not
/// tell how many it has.
impl Serialize for SimulationSettings {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let Self { run, isolation, memory_limit, sandbox, max_description_bytes, units } = self;
        let Ok(Value::Record(mut fields)) = Value::of(run) else {
            return Err(serde::ser::Error::custom("the settings of a run are no record"));
        };
        let own = [
            ("isolation", Value::of(isolation)),
            ("memory_limit", Value::of(memory_limit)),
            ("sandbox", Value::of(sandbox)),
            ("max_description_bytes", Value::of(max_description_bytes)),
            ("units", Value::of(units)),
        ];
        for (name, value) in own {
            fields.insert(name.to_owned(), value.map_err(serde::ser::Error::custom)?);
        }
        fields.serialize(to)
    }
}

impl From<RunSettings> for SimulationSettings {
    fn from(run: RunSettings) -> Self {
        Self { run, ..Self::default() }
    }
}
