//! Warnings about a setup that can be evaluated but may not be intended.

use crate::data::{ClockChange, MOST_LISTED, UnitError, listed, parts};
use crate::findings::finding::Severity;
use crate::problem::experiment::{Experiment, Weight};
use crate::problem::input::InputSource;
use crate::problem::parameter::{Parameter, Scale};
use base::Number;
use fmi::description::Causality;
use fmi::{ModelDescription, Value};
use std::fmt;

/// Target of the log lines for each [`SetupWarning`].
pub const SETUP_LOG_TARGET: &str = "calibration::setup";

/// A property of a calibration that may not be intended; see
/// [`Calibration::warnings`](crate::Calibration::warnings).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SetupWarning {
    /// An unused column has the name of an input of the model that nothing drives.
    UnusedColumn {
        /// The recording.
        data: String,
        /// The column.
        column: String,
        /// The input.
        input: String,
    },
    /// A column declares a unit that was not converted to the unit of its variable.
    NotConverted {
        /// The recording.
        data: String,
        /// The column.
        column: String,
        /// The variable.
        variable: String,
        /// Reason.
        reason: UnitError,
    },
    /// Columns were converted using units in brackets at the end of their names, or in a line below the
    /// names. This is a note, because brackets may have another meaning.
    Converted {
        /// The recording.
        data: String,
        /// Column, unit of the column, unit of the variable.
        columns: Vec<(String, String, String)>,
    },
    /// The recording of the inputs has no columns named after these inputs of the model.
    WithoutColumn {
        /// The recording.
        data: String,
        /// The inputs, with their start values.
        inputs: Vec<(String, Option<Value>)>,
        /// The columns.
        columns: Vec<String>,
    },
    /// An hour is missing or repeated in times without a time zone.
    ClockChange {
        /// The recording.
        data: String,
        /// Description of the change.
        change: ClockChange,
    },
    /// A setting is ignored; the sentence gives the setting and the reason.
    NoEffect(String),
    /// A warning applies to one of several experiments.
    Experiment {
        /// Name of the experiment.
        name: String,
        /// The warning.
        warning: Box<SetupWarning>,
    },
}

impl SetupWarning {
    /// Returns the severity of the warning.
    pub fn severity(&self) -> Severity {
        match self {
            Self::Converted { .. } => Severity::Note,
            Self::Experiment { warning, .. } => warning.severity(),
            _ => Severity::Warning,
        }
    }
}

impl fmt::Display for SetupWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnusedColumn { data, column, input } => write!(
                f,
                "{data}: column '{column}' is not used, but the model has an input '{input}' that nothing drives; name it \
                 among the inputs, if it is its recording"
            ),
            Self::NotConverted { data, column, variable, reason } => {
                write!(
                    f,
                    "{data}: column '{column}' is taken in the unit of '{variable}', without conversion: {reason}"
                )?;
                match reason {
                    UnitError::NotStated { .. } => f.write_str("; the setting units states it"),
                    _ => Ok(()),
                }
            }
            Self::Converted { data, columns } => {
                let one =
                    |(column, from, to): &(String, String, String)| format!("'{column}' from {from} to {to}");
                let all = columns.iter().map(one).collect::<Vec<_>>().join(", ");
                write!(f, "{data}: converted by the units that the columns state: {all}")
            }
            Self::WithoutColumn { data, inputs, columns } => {
                let value = |(_, start): &(String, Option<Value>)| match start {
                    Some(Value::Real(value)) => Number(*value).to_string(),
                    Some(value) => value.to_string(),
                    None => "of the model".to_owned(),
                };
                let names = listed(inputs.iter().map(|(name, _)| name.as_str()));
                let values = inputs.iter().take(MOST_LISTED).map(value).collect::<Vec<_>>().join(", ");
                let (subject, verb) = match inputs.len() {
                    1 => ("input", "has no column: it keeps its start value"),
                    _ => ("inputs", "have no column: they keep their start values"),
                };
                let columns = listed(columns.iter().map(String::as_str));
                write!(f, "{data}: {subject} {names} {verb} {values}; columns are {columns}")
            }
            Self::ClockChange { data, change } => write!(f, "{data}: {change}"),
            Self::NoEffect(sentence) => f.write_str(sentence),
            Self::Experiment { name, warning } => write!(f, "{name}: {warning}"),
        }
    }
}

/// Returns warnings about unused columns that have the names of inputs that nothing drives.
pub(crate) fn unused_columns(description: &ModelDescription, experiment: &Experiment) -> Vec<SetupWarning> {
    let Experiment { data, outputs, inputs, start_values, .. } = experiment;
    let is_used = |column: &str| {
        let weighs = |weight: &Weight| matches!(weight, Weight::Column(used) if used == column);
        let drives = |source: &InputSource| matches!(source, InputSource::Column(used) if used == column);
        outputs.iter().any(|o| o.column == column || weighs(&o.weight))
            || inputs.iter().any(|(_, source)| drives(source))
    };
    let is_given = |input: &str| {
        inputs.iter().any(|(name, _)| name == input) || start_values.iter().any(|(name, _)| name == input)
    };
    let input = |column: &str| {
        let names = [column, parts(column).0];
        let open =
            || description.variables.iter().filter(|v| v.causality == Causality::Input && !is_given(&v.name));
        let exact = open().find(|v| names.contains(&v.name.as_str()));
        // Names in a model are case-sensitive, but names in a recording often are not.
        exact
            .or_else(|| open().find(|v| names.iter().any(|name| name.eq_ignore_ascii_case(&v.name))))
            .map(|v| v.name.clone())
    };
    let warning = |column: &str| {
        let (data, input) = (data.source().to_owned(), input(column)?);
        Some(SetupWarning::UnusedColumn { data, column: column.to_owned(), input })
    };
    data.all_names().filter(|column| !is_used(column)).filter_map(warning).collect()
}

/// Returns a warning if an hour is missing or repeated in the times of a recording.
pub(crate) fn clock_change(experiment: &Experiment) -> Option<SetupWarning> {
    let (data, change) = (&experiment.data, experiment.data.clock_change()?.clone());
    Some(SetupWarning::ClockChange { data: data.source().to_owned(), change })
}

/// Returns warnings about nominal values that are unused on a logarithmic scale.
pub(crate) fn ignored_nominals(parameters: &[Parameter]) -> impl Iterator<Item = SetupWarning> {
    let is_ignored = |p: &&Parameter| p.scale_kind() == Scale::Log && p.nominal_size().is_some();
    let warning = |p: &Parameter| format!("nominal of parameter '{}' has no effect on a log scale", p.name());
    parameters.iter().filter(is_ignored).map(move |p| SetupWarning::NoEffect(warning(p)))
}
