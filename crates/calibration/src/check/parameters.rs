//! Checks of parameters and given values against the ranges and start values that the model declares.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::rounded;
use crate::data::UnitConversion;
use crate::findings::finding::{Finding, Severity};
use crate::findings::identifier::FindingId;
use crate::problem::column_units::declared;
use crate::problem::experiment::Experiment;
use crate::problem::input::InputSource;
use crate::problem::parameter::Parameter;
use base::Number;
use fmi::description::Variable;
use fmi::{ModelDescription, Value};

/// Minimum ratio to the model's own value that indicates a different unit.
const UNLIKE: f64 = 1e3;

/// A temperature above the first limit is in K, and one below the second is in degC.
const KELVIN: (f64, f64) = (200.0, 150.0);

/// Returns the start value that the model declares for a variable if it indicates its size: finite and not
/// zero.
fn start_of_model(variable: &Variable) -> Option<f64> {
    match variable.start {
        Some(Value::Real(start)) if start != 0.0 && start.is_finite() => Some(start),
        _ => None,
    }
}

/// Returns the ratio of the larger to the smaller magnitude. Returns infinity for numbers of different sign.
fn factor(a: f64, b: f64) -> f64 {
    if a * b > 0.0 { (a / b).abs().max((b / a).abs()) } else { f64::INFINITY }
}

/// Returns the conversion of the values of a parameter to the values of its variable.
fn conversion(parameter: &Parameter, variable: &Variable, description: &ModelDescription) -> UnitConversion {
    let given = parameter.given_unit().filter(|_| !parameter.is_derived());
    let conversion = given.and_then(|unit| UnitConversion::to_variable(unit, variable, description).ok());
    conversion.unwrap_or(UnitConversion::IDENTITY)
}

/// Returns findings about parameters whose start and value are far from the model's own start values. The
/// most likely cause is a different unit.
pub(super) fn far_from_model_start(
    parameters: &[Parameter],
    values: &[f64],
    description: &ModelDescription,
) -> Vec<Finding> {
    let of = |(parameter, value): (&Parameter, &f64)| {
        let first = parameter.variable_names().first().filter(|_| !parameter.is_derived())?;
        let variable = declared(description, first)?;
        let start_value = conversion(parameter, variable, description).invert(start_of_model(variable)?);
        let start = parameter.start();
        let is_far = |value: f64| value * start_value > 0.0 && factor(value, start_value) >= UNLIKE;
        (is_far(*value) && is_far(start)).then(|| {
            let sentence = format!(
                "start {} is {} times the start value {} of the model. The unit is probably wrong",
                Number(start),
                Number(rounded(start / start_value)),
                Number(rounded(start_value))
            );
            let remedy =
                "Check the unit, and state it with Parameter(..., unit=...) if it differs from the model";
            let id = FindingId::ValueUnlikeModel;
            Finding::warning(id, format!("parameter '{}'", parameter.name()), sentence, remedy)
        })
    };
    parameters.iter().zip(values).filter_map(of).collect()
}

/// Range of values given for a variable.
#[derive(Clone, Copy)]
pub(super) struct GivenRange {
    pub(super) lowest: f64,
    pub(super) highest: f64,
    /// True for a single value, which is compared with the model's own value. A signal may start anywhere.
    pub(super) is_constant: bool,
}

/// Returns the declaration of the model that the values contradict: its range or its own start value. Returns
/// `None` if they agree.
pub(super) fn beside_the_model(variable: &Variable, given: GivenRange) -> Option<String> {
    let GivenRange { lowest, highest, is_constant } = given;
    let is_below = variable.min.is_some_and(|min| lowest < min);
    let is_above = variable.max.is_some_and(|max| highest > max);
    if is_below || is_above {
        let bounds = [("at least ", variable.min), ("at most ", variable.max)];
        let bounds = bounds.into_iter().filter_map(|(word, limit)| Some(format!("{word}{}", Number(limit?))));
        return Some(format!("the range of the model is {}", bounds.collect::<Vec<_>>().join(" and ")));
    }
    let start_value = start_of_model(variable)?;
    let is_far = is_constant
        && highest != 0.0
        && highest * start_value > 0.0
        && factor(highest, start_value) >= UNLIKE;
    let is_celsius = variable.unit.as_deref() == Some("K") && highest < KELVIN.1 && start_value > KELVIN.0;
    let hint = if is_celsius { ", as with degC instead of K" } else { "" };
    (is_far || is_celsius).then(|| format!("the start value of the model is {}{hint}", Number(start_value)))
}

/// Returns findings about start values and constant inputs of an experiment. They are reported if they are
/// outside the model's range or far from its own start value.
pub(super) fn given_values(subject: &ExperimentSubject<'_>, parameters: &[Parameter]) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, description, .. } = subject;
    // Start values of local parameters are in the unit of the parameter.
    let is_constant = |(name, _): &&(String, Value)| !Experiment::is_start_of_local(name, parameters);
    let starts = experiment.start_values.iter().filter(is_constant).filter_map(|(name, value)| match value {
        Value::Real(value) => Some((name, "start value", *value)),
        _ => None,
    });
    let constants = experiment.inputs.iter().filter_map(|(name, source)| match source {
        InputSource::Constant(value) => Some((name, "constant input", *value)),
        _ => None,
    });
    let of = |(name, what, value): (&String, &str, f64)| {
        let variable = declared(description, name)?;
        let unit = variable.unit.as_deref().unwrap_or_default();
        let beside =
            beside_the_model(variable, GivenRange { lowest: value, highest: value, is_constant: true })?;
        let in_unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        Some(Finding::warning(
            FindingId::ValueUnlikeModel,
            format!("{prefix}{what} of '{name}'"),
            format!("the value is {}{in_unit}, but {beside}. The unit is probably wrong", Number(value)),
            "Convert the value to the unit of the model",
        ))
    };
    starts.chain(constants).filter_map(of).collect()
}

/// Returns findings about parameters whose start or bounds are outside the range that the model declares.
pub(super) fn ranges(parameters: &[Parameter], description: &ModelDescription) -> Vec<Finding> {
    let mut findings = Vec::new();
    for parameter in parameters {
        let first = parameter.variable_names().first();
        let Some(variable) = first.and_then(|name| declared(description, name)) else { continue };
        // Range of the model in the unit of the parameter.
        let in_parameter_unit = |value| conversion(parameter, variable, description).invert(value);
        let (min, max) = (variable.min.map(in_parameter_unit), variable.max.map(in_parameter_unit));
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
            findings.push(Finding::warning(
                FindingId::OutsideModelRange,
                subject,
                format!(
                    "start {} is outside of the model's range {range}. The simulation may fail or be meaningless there",
                    Number(start)
                ),
                "Start inside the range, and check the unit",
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
                FindingId::OutsideModelRange,
                subject.clone(),
                format!("{text}, but the model declares a range {range}. Simulations beyond it may fail or be meaningless"),
                "Set bounds inside the range",
            ));
        }
    }
    findings
}
