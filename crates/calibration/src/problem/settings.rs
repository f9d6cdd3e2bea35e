//! Settings of the simulations of a fit.

use crate::data::{TimeUnit, Unit};
use crate::error::CalibrationError;
#[cfg(feature = "schema")]
use crate::problem::schema;
use dfo::{Record, RecordError, Value, read_part, read_strict};
use fmi::worker::{Isolation, WorkerLimits};
use fmi::{OpenOptions, RunSettings};
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;

/// Settings of the simulations of a fit.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(deny_unknown_fields))]
#[serde(default)]
pub struct SimulationSettings {
    /// Settings of a model run. If `relative_tolerance` is not given, it is the tolerance of the model, but
    /// at most 1e-6. A fit reports if this is smaller than the tolerance of the model. A simulation counts as
    /// failed if it reaches the `timeout`, or if its events hardly let time advance.
    #[serde(flatten)]
    pub run: RunSettings,
    /// Isolation of the FMU. The costs do not depend on it.
    #[cfg_attr(feature = "schema", schemars(schema_with = "schema::isolation"))]
    pub isolation: Isolation,
    /// Memory limit in bytes for a process of the FMU; default: the memory of the machine.
    pub memory_limit: Option<u64>,
    /// True if processes of the FMU may write only to their own folder and may not open connections.
    pub sandbox: bool,
    /// Size limit in bytes for the `modelDescription.xml` of the model; default: see
    /// [`DescriptionLimits`](fmi::DescriptionLimits).
    pub max_description_bytes: Option<u64>,
    /// Units of variables without a declared unit, by name. Recorded columns are converted to these units.
    pub units: BTreeMap<String, String>,
    /// Unit in which the model counts its time, such as `h`; default: the unit that the model states for its
    /// independent variable, otherwise s. Recorded times are converted to this unit. Windows, start times,
    /// delays, step sizes and results are in this unit.
    pub time_unit: Option<String>,
}

/// Description of a field of the settings in messages.
const SETTING: &str = "setting of simulations";

/// Largest relative tolerance of simulations in a fit if none is given. At this tolerance, a cost with usual
/// measurement noise is smooth far below 1e-4 of its value, the `f_tol` of a fit. At 1e-4, which many models
/// declare, the cost is not smooth enough.
const LOOSEST: f64 = 1e-6;

impl SimulationSettings {
    /// Returns the settings of a record. `solver` is the method, `timeout` is in s, and all other entries are
    /// named as the fields. Missing entries keep their defaults.
    ///
    /// # Errors
    /// Returns an error if a setting is unknown or has an invalid value.
    pub fn from_record(record: &Record) -> Result<Self, RecordError> {
        let mut record = record.clone();
        for (name, value) in &mut record {
            // Enumerations are parsed by their user-visible names. Times are in s.
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
        // The record is read in two parts so that errors name their fields. Unknown names are
        // rejected only here, so that a fit saved by another version can be loaded.
        let (run, others) = read_part(record, SETTING)?;
        Ok(Self { run, ..read_strict(&others, SETTING)? })
    }

    /// Returns the options for opening the model.
    pub fn open_options(&self) -> OpenOptions {
        let mut options = OpenOptions::default();
        options.description.bytes = self.max_description_bytes.unwrap_or(options.description.bytes);
        options
    }

    /// Returns the model with the units from the settings.
    ///
    /// # Errors
    /// Returns an error if a unit is invalid, or if a variable is unknown or has a different unit.
    pub(crate) fn with_units(&self, mut fmu: fmi::Fmu) -> Result<fmi::Fmu, CalibrationError> {
        if let Some(unit) = &self.time_unit {
            if TimeUnit::named(unit, fmu.description()).length.is_none() {
                return Err(CalibrationError::Setup(format!(
                    "time_unit: '{unit}' is not a unit of time; expected s, ms, us, ns, min, h or d"
                )));
            }
            fmu = fmu.with_time_unit(unit);
        }
        if self.units.is_empty() {
            return Ok(fmu);
        }
        let defined = &fmu.description().units;
        for (variable, unit) in &self.units {
            if !defined.iter().any(|defined_unit| defined_unit.name == *unit) {
                Unit::parse(unit)
                    .map_err(|error| CalibrationError::Setup(format!("units: '{variable}': {error}")))?;
            }
        }
        Ok(fmu.with_units(self.units.iter().map(|(variable, unit)| (&variable[..], &unit[..])))?)
    }

    /// Returns the limits of the processes of the FMU.
    pub(crate) fn worker_limits(&self) -> WorkerLimits {
        let usual = WorkerLimits::default();
        WorkerLimits { memory: self.memory_limit.or(usual.memory), sandbox: self.sandbox, ..usual }
    }

    /// Returns the run settings for a fit. If no relative tolerance is set and the model declares a larger
    /// one than [`LOOSEST`], the tolerance is [`LOOSEST`].
    pub(crate) fn run_of_fits(&self, description: &fmi::ModelDescription) -> RunSettings {
        let mut run = self.run.clone();
        let stated = description.default_experiment.tolerance;
        if run.relative_tolerance.is_none() && stated.is_some_and(|stated| stated > LOOSEST && stated < 1.0) {
            run.relative_tolerance = Some(LOOSEST);
        }
        run
    }
}

/// Serialises the settings as one record with a known number of fields. A flattened field would not report
/// its number of fields, and files would have several forms.
impl Serialize for SimulationSettings {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let Self { run, isolation, memory_limit, sandbox, max_description_bytes, units, time_unit } = self;
        let Ok(Value::Record(mut fields)) = Value::of(run) else {
            return Err(serde::ser::Error::custom("the settings of a run are not a record"));
        };
        let others = [
            ("isolation", Value::of(isolation)),
            ("memory_limit", Value::of(memory_limit)),
            ("sandbox", Value::of(sandbox)),
            ("max_description_bytes", Value::of(max_description_bytes)),
            ("units", Value::of(units)),
            ("time_unit", Value::of(time_unit)),
        ];
        for (name, value) in others {
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
