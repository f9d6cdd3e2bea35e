//! Checks of the inputs and units in the model description, and warnings of the setup.

use super::experiment_subject::ExperimentSubject;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::problem::column_units::declared;
use crate::problem::definition::Problem;
use crate::problem::experiment::InitialState;
use crate::problem::warning::SetupWarning;
use fmi::Fmu;
use fmi::description::{Causality, Variable};

/// Converts warnings from the construction of the calibration to findings.
pub(super) fn construction_warnings(warnings: &[SetupWarning]) -> Vec<Finding> {
    warnings.iter().map(SetupWarning::finding).collect()
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
        let id = FindingId::StartValueWithoutEffect;
        Some(Finding::warning(id, format!("{prefix}start value of '{name}'"), message, ""))
    };
    numbers.chain(starts).filter_map(finding).collect()
}

/// Returns a finding if priors are combined with measurements whose weights do not state their noise.
pub(crate) fn unstated_noise(problem: &Problem) -> Option<Finding> {
    let fitted = problem.experiments.iter().flat_map(|e| &e.initial_states).filter_map(|(state, initial)| {
        let InitialState::Fitted(parameter) = initial else { return None };
        parameter.stated_prior().map(|_| state.as_str())
    });
    let named = problem.parameters.iter().filter(|p| p.stated_prior().is_some()).map(|p| p.name());
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
        FindingId::UnstatedNoise,
        format!("prior of {priors}"),
        format!(
            "the weights do not state the noise of {outputs}, which determines the influence of the prior. A fit of the sum of squares \
             estimates the noise, and a fit with a robust loss or with noise 'stated' assumes 1 over the weight"
        ),
        "Set the weights to 1/sigma",
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
        let held = match &v.start {
            Some(start) => format!("It stays at its start value {start}"),
            None => "It stays at 0, because the model declares no start value".to_owned(),
        };
        Finding::warning(
            FindingId::UndrivenInput,
            format!("{prefix}input '{}'", v.name),
            format!("the input is not driven. {held}"),
            format!(
                "Specify its column (inputs={{\"{0}\": ...}}), or set start_values={{\"{0}\": ...}} if this is intended",
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
            example = example
                .or_else(|| Some(format!(", as in '{column} [{}]'", subject.example_unit(&variable)?)));
        }
    }
    if columns.is_empty() {
        return Vec::new();
    }
    vec![Finding::note(
        FindingId::MissingUnit,
        format!("{prefix}{}", experiment.data.source()),
        format!("columns without a unit are not converted to the units of the model: {}", columns.join(", ")),
        format!("State the units of the columns to convert them{}", example.unwrap_or_default()),
    )]
}
