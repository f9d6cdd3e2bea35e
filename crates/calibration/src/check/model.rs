//! Checks of the inputs and units in the model description, and warnings of the setup.

use super::experiment_subject::ExperimentSubject;
use crate::findings::finding::{Finding, Severity};
use crate::problem::column_units::declared;
use crate::problem::definition::Problem;
use crate::problem::experiment::InitialState;
use crate::problem::warning::SetupWarning;
use fmi::Fmu;
use fmi::description::{Causality, Variable};

/// Converts warnings from the construction of the calibration to findings.
pub(super) fn construction_warnings(warnings: &[SetupWarning]) -> Vec<Finding> {
    let finding = |warning: &SetupWarning| Finding::new(warning.severity(), "setup", warning.to_string(), "");
    warnings.iter().map(finding).collect()
}

/// Returns findings about start values that had no effect in a simulation. In co-simulation, numbers for
/// initial states are also start values.
pub(super) fn start_values(
    fmu: &Fmu,
    is_co_simulation: bool,
    subject: &ExperimentSubject<'_>,
) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, .. } = subject;
    let numbers = experiment.initial_states.iter().filter_map(|(name, initial)| match initial {
        InitialState::Value(value) if is_co_simulation => Some((name, *value)),
        _ => None,
    });
    let starts = experiment.start_values.iter().filter_map(|(name, value)| Some((name, value.as_number()?)));
    let finding = |(name, value): (&String, f64)| {
        let message = fmu.ineffective_start_value(name, value)?;
        Some(Finding::warning(format!("{prefix}start value of '{name}'"), message, ""))
    };
    numbers.chain(starts).filter_map(finding).collect()
}

/// Returns a finding if priors are combined with measurements whose weights do not state their noise.
pub(crate) fn unstated_noise(problem: &Problem) -> Option<Finding> {
    let fitted = problem.experiments.iter().flat_map(|e| &e.initial_states).filter_map(|(state, initial)| {
        let InitialState::Fitted(parameter) = initial else { return None };
        parameter.known_prior().map(|_| state.as_str())
    });
    let named = problem.parameters.iter().filter(|p| p.known_prior().is_some()).map(|p| p.name());
    let with_prior: Vec<&str> = named.chain(fitted).collect();
    let outputs = problem.experiments.iter().flat_map(|experiment| &experiment.outputs);
    let unstated = outputs.filter(|output| !output.weight.states_noise());
    let mut unstated: Vec<&str> = unstated.map(|output| &*output.variable).collect();
    unstated.sort_unstable();
    unstated.dedup();
    if with_prior.is_empty() || unstated.is_empty() {
        return None;
    }
    let (priors, outputs) = (with_prior.join(", "), unstated.join(", "));
    Some(Finding::note(
        format!("prior of {priors}"),
        format!(
            "it counts in units of its standard deviation, and nothing states the standard deviation of the noise of {outputs}: a fit of \
             the sum of squares estimates it with the parameters; a fit with a robust loss, or with noise 'stated', takes it for 1 over the \
             weight, and the prior decides where it is smaller"
        ),
        "weights of 1/sigma state it",
    ))
}

/// Returns findings about inputs without a source.
pub(super) fn inputs(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, description, .. } = subject;
    let reference = |v: &Variable| (v.kind, v.value_reference);
    let given: Vec<_> = (experiment.inputs.iter().map(|(name, _)| name))
        .chain(experiment.start_values.iter().map(|(name, _)| name))
        .filter_map(|name| declared(description, name).map(reference))
        .collect();
    let is_open = |v: &&Variable| {
        v.causality == Causality::Input && v.clock.is_none() && !given.contains(&reference(v))
    };
    let finding = |v: &Variable| {
        let (held, severity) = match &v.start {
            Some(start) => (format!("it stays at its start value {start}"), Severity::Warning),
            None => {
                ("the model states no start value for it, so it stays at 0".to_owned(), Severity::Warning)
            }
        };
        Finding::new(
            severity,
            format!("{prefix}input '{}'", v.name),
            format!("nothing drives it: {held}"),
            format!(
                "name the column that recorded it (inputs={{\"{0}\": ...}}), or give start_values={{\"{0}\": ...}} if this is meant",
                v.name
            ),
        )
    };
    description.variables.iter().filter(is_open).map(finding).collect()
}

/// Returns a finding about columns that declare no unit although the model declares one. They are used
/// unconverted.
pub(super) fn units(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, description, .. } = subject;
    let mut columns: Vec<String> = Vec::new();
    let mut example = None;
    for (variable, column) in experiment.columns_in_use() {
        let unit = declared(description, &variable).and_then(|v| v.unit.as_deref());
        let Some(unit) = unit.filter(|unit| !matches!(*unit, "" | "1" | "-")) else { continue };
        let text = format!("'{column}' in {unit}");
        if experiment.data.unit(&column).is_none() && !columns.contains(&text) {
            columns.push(text);
            example =
                example.or_else(|| Some(format!(": '{column} [{}]'", subject.example_unit(&variable)?)));
        }
    }
    if columns.is_empty() {
        return Vec::new();
    }
    vec![Finding::note(
        format!("{prefix}{}", experiment.data.source()),
        format!("columns without a unit are taken in those of the model: {}", columns.join(", ")),
        format!("state units to have them converted{}", example.unwrap_or_default()),
    )]
}
