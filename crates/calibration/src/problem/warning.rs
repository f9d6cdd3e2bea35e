//! Warnings about a setup that can be evaluated but may not be intended.

use crate::data::{ClockChange, MOST_LISTED, TimeUnit, UnitError, listed, parts};
use crate::findings::finding::{Finding, Severity};
use crate::findings::identifier::FindingId;
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
    /// A column is not converted from its declared unit to the unit of its variable.
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
    /// Rows repeat the time and all measured values of the row before.
    DuplicateRows {
        /// The recording.
        data: String,
        /// Number of such rows.
        n: usize,
        /// Time of the first one.
        time: f64,
        /// Unit of the time.
        time_unit: String,
    },
    /// The settings state another time unit than the model.
    TimeUnit {
        /// Unit in the settings.
        given: String,
        /// Unit of the model.
        stated: String,
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

    /// Returns the warning as a finding.
    pub fn finding(&self) -> Finding {
        let finding = |id, subject: &str, sentence: String, remedy: String| {
            Finding::new(self.severity(), id, subject, sentence, remedy)
        };
        match self {
            Self::UnusedColumn { data, column, input } => finding(
                FindingId::UnusedColumn,
                data,
                format!("column '{column}' is not used, but nothing drives the input '{input}' of the model"),
                "Add the column to the inputs if it is the recording of this input".to_owned(),
            ),
            Self::NotConverted { data, column, variable, reason } => finding(
                FindingId::UnconvertedUnit,
                data,
                format!("column '{column}' is used in the unit of '{variable}' without conversion: {reason}"),
                match reason {
                    UnitError::NotStated { .. } => {
                        format!("State the unit of '{variable}' with the setting units")
                    }
                    _ => "Correct the unit of the column".to_owned(),
                },
            ),
            Self::Converted { data, columns } => {
                let one =
                    |(column, from, to): &(String, String, String)| format!("'{column}' from {from} to {to}");
                let all = columns.iter().map(one).collect::<Vec<_>>().join(", ");
                let sentence = format!("columns were converted from the units that they state: {all}");
                finding(FindingId::ConvertedUnit, data, sentence, String::new())
            }
            Self::WithoutColumn { data, inputs, columns } => {
                let value = |(_, start): &(String, Option<Value>)| match start {
                    Some(Value::Real(value)) => Number(*value).to_string(),
                    Some(value) => value.to_string(),
                    None => "of the model".to_owned(),
                };
                let names = listed(inputs.iter().map(|(name, _)| name.as_str()));
                let values = inputs.iter().take(MOST_LISTED).map(value).collect::<Vec<_>>().join(", ");
                let sentence = match inputs.len() {
                    1 => format!("input {names} has no column and keeps its start value {values}"),
                    _ => format!("inputs {names} have no column and keep their start values {values}"),
                };
                let columns = listed(columns.iter().map(String::as_str));
                finding(
                    FindingId::UndrivenInput,
                    data,
                    sentence,
                    format!("Assign one of the columns {columns}"),
                )
            }
            Self::ClockChange { data, change } => {
                finding(FindingId::ClockChange, data, change.symptom(), change.remedy())
            }
            Self::DuplicateRows { data, n, time, time_unit } => finding(
                FindingId::DuplicateRows,
                data,
                format!(
                    "number of rows with the time and all measured values of the row before: {n}, the first at {} {time_unit}. Their \
                     measurements count twice",
                    Number(*time)
                ),
                "Remove the rows unless they are separate measurements".to_owned(),
            ),
            Self::TimeUnit { given, stated } => finding(
                FindingId::ContradictedTimeUnit,
                "time_unit",
                format!(
                    "time_unit is '{given}', but the model states the time unit '{stated}'. Recorded times and delays are converted to \
                     {given}, and the units of other variables stay as the model states them"
                ),
                "Remove time_unit, unless the model states the wrong unit".to_owned(),
            ),
            Self::NoEffect(sentence) => {
                finding(FindingId::SettingWithoutEffect, "", sentence.clone(), String::new())
            }
            Self::Experiment { name, warning } => {
                let of_experiment = warning.finding();
                let subject = match of_experiment.subject.as_str() {
                    "" => name.clone(),
                    subject => format!("{name}: {subject}"),
                };
                Finding { subject, ..of_experiment }
            }
        }
    }
}

/// Writes the text and the remedy of the finding.
impl fmt::Display for SetupWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.finding().advice())
    }
}

/// Returns warnings about unused columns that have the names of inputs that nothing drives.
pub(crate) fn unused_columns(description: &ModelDescription, experiment: &Experiment) -> Vec<SetupWarning> {
    let Experiment { data, outputs, inputs, start_values, .. } = experiment;
    let is_used = |column: &str| {
        let weighs = |weight: &Weight| weight.column() == Some(column);
        let drives = |source: &InputSource| source.column() == Some(column);
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

/// Returns a warning if rows repeat the time and all measured values of the row before.
pub(crate) fn duplicate_rows(experiment: &Experiment) -> Option<SetupWarning> {
    let (data, time) = (&experiment.data, experiment.data.time());
    let columns: Vec<&[f64]> =
        experiment.outputs.iter().filter_map(|output| data.column(&output.column).ok()).collect();
    let is_duplicate = |row: &usize| {
        time[*row] == time[row - 1] && columns.iter().all(|values| values[*row] == values[row - 1])
    };
    let rows: Vec<usize> = (1..time.len()).filter(is_duplicate).collect();
    let first = time[*rows.first().filter(|_| !columns.is_empty())?];
    let (source, time_unit) = (data.source().to_owned(), data.time_unit().to_owned());
    Some(SetupWarning::DuplicateRows { data: source, n: rows.len(), time: first, time_unit })
}

/// Returns a warning if an hour is missing or repeated in the times of a recording.
pub(crate) fn clock_change(experiment: &Experiment) -> Option<SetupWarning> {
    let (data, change) = (&experiment.data, experiment.data.clock_change()?.clone());
    Some(SetupWarning::ClockChange { data: data.source().to_owned(), change })
}

/// Returns a warning if the time unit in the settings has another length than the one that the model states.
/// A stated unit that is not a unit of time does not contradict.
pub(crate) fn other_time_unit(given: Option<&str>, description: &ModelDescription) -> Option<SetupWarning> {
    let mut independent = description.variables.iter().filter(|v| v.causality == Causality::Independent);
    let stated = independent.next()?.unit.as_deref().map(str::trim)?;
    let length = |name: &str| TimeUnit::named(name, description).length;
    let (given, (n, d), (own_n, own_d)) = (given?, length(given?)?, length(stated)?);
    let (given, stated) = (given.to_owned(), stated.to_owned());
    (n * own_d != own_n * d).then_some(SetupWarning::TimeUnit { given, stated })
}

/// Returns warnings about nominal values that are unused on a logarithmic scale.
pub(crate) fn ignored_nominals(parameters: &[Parameter]) -> impl Iterator<Item = SetupWarning> {
    let is_ignored = |p: &&Parameter| p.scale_kind() == Scale::Log && p.nominal_size().is_some();
    let warning = |p: &Parameter| format!("nominal of parameter '{}' has no effect on a log scale", p.name());
    parameters.iter().filter(is_ignored).map(move |p| SetupWarning::NoEffect(warning(p)))
}
