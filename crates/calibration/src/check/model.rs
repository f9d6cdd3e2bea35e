//! What the description of the model says about parameters, inputs and units.

use super::subject::Subject;
use crate::column_units::declared;
use crate::data::UnitConversion;
use crate::experiment::InitialState;
use crate::finding::{Finding, Severity};
use crate::parameter::Parameter;
use crate::problem::Problem;
use crate::warning::SetupWarning;
use fmi::ModelDescription;
use fmi::description::{Causality, Variable};
use ode::Number;

/// What was in doubt when the calibration was built.
pub(super) fn construction_warnings(warnings: &[SetupWarning]) -> Vec<Finding> {
    let finding = |warning: &SetupWarning| Finding::new(warning.severity(), "setup", warning.to_string(), "");
    warnings.iter().map(finding).collect()
}

/// Priors beside measurements whose noise no weight states.
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
    Some(Finding::new(
        Severity::Note,
        format!("prior of {priors}"),
        format!(
            "it counts in units of its standard deviation, but nothing states the standard deviation of the noise of {outputs}, which is \
             taken for 1 over the weight: where it is smaller, the prior decides"
        ),
        "a fit of the sum of squares estimates the noise with the parameters; weights of 1/sigma state it",
    ))
}

/// Parameters whose start or bounds lie beyond the range that the model states.
pub(super) fn parameters(parameters: &[Parameter], description: &ModelDescription) -> Vec<Finding> {
    let mut findings = Vec::new();
    for parameter in parameters {
        let first = parameter.variable_names().first();
        let Some(variable) = first.and_then(|name| declared(description, name)) else { continue };
        // The model's range in the unit of the parameter.
        let given = parameter.given_unit().filter(|_| !parameter.is_tied());
        let conversion = given.and_then(|unit| UnitConversion::to_variable(unit, variable, description).ok());
        let own = |value| conversion.unwrap_or(UnitConversion::IDENTITY).invert(value);
        let (min, max) = (variable.min.map(own), variable.max.map(own));
        let (low, high) = (min.unwrap_or(f64::NEG_INFINITY), max.unwrap_or(f64::INFINITY));
        let subject = format!("parameter '{}'", parameter.name());
        let range = match (min, max) {
            (Some(low), Some(high)) => format!("from {} to {}", Number(low), Number(high)),
            (Some(low), None) => format!("of at least {}", Number(low)),
            (None, Some(high)) => format!("of at most {}", Number(high)),
            (None, None) => continue,
        };
        let start = parameter.start();
        if start < low || start > high {
            findings.push(Finding::new(
                Severity::Warning,
                subject,
                format!("start {} is outside of the model's range {range}", Number(start)),
                "start within it; is its unit that of the model?",
            ));
            continue;
        }
        let beyond = [
            (parameter.lower() < low).then(|| ("lower", parameter.lower())),
            (parameter.upper() > high).then(|| ("upper", parameter.upper())),
        ];
        for (side, bound) in beyond.into_iter().flatten() {
            let text = if bound.is_finite() {
                format!("{side} bound {}", Number(bound))
            } else {
                format!("no {side} bound")
            };
            let severity = if bound.is_finite() { Severity::Warning } else { Severity::Note };
            findings.push(Finding::new(
                severity,
                subject.clone(),
                format!("{text}, but the model states a range {range}"),
                "simulations beyond it may fail or mean nothing: give bounds within it",
            ));
        }
    }
    findings
}

/// Inputs that nothing drives.
pub(super) fn inputs(subject: &Subject<'_>) -> Vec<Finding> {
    let Subject { prefix, experiment, description, .. } = subject;
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

/// Columns that state no unit where the model states one: they are taken as they are.
pub(super) fn units(subject: &Subject<'_>) -> Vec<Finding> {
    let Subject { prefix, experiment, description, .. } = subject;
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
    vec![Finding::new(
        Severity::Note,
        format!("{prefix}{}", experiment.data.source()),
        format!("columns without a unit are taken in those of the model: {}", columns.join(", ")),
        format!("state units to have them converted{}", example.unwrap_or_default()),
    )]
}
