//! Values to set in an FMU: resolves names, checks types and settability, and sorts the values into one call
//! per type.

use super::integer_codec::{self, whole};
use crate::description::{Causality, Initial, ModelDescription, Value, Variability, Variable, VariableKind};
use crate::error::{FmiError, Result};
use std::ffi::CString;

/// Returns the index of the variable with this name.
///
/// # Errors
/// Returns [`FmiError::UnknownVariable`] with the nearest names.
pub(crate) fn resolve(description: &ModelDescription, name: &str) -> Result<usize> {
    description.variable_index(name).ok_or_else(|| FmiError::UnknownVariable {
        name: name.to_owned(),
        nearest: description.nearest_names(name, 3).into_iter().map(str::to_owned).collect(),
    })
}

/// Converts a value to the variable's type: integers to reals, and reals with integer values to integers. For
/// an array, `elements` is the required number of elements.
///
/// # Errors
/// Returns [`FmiError::WrongType`], and [`FmiError::NotFinite`] for NaN and infinities.
pub(crate) fn convert(variable: &Variable, value: &Value, elements: Option<usize>) -> Result<Value> {
    let wrong = |given| wrong_type(variable, value, given);
    let Some(elements) = elements else { return convert_one(variable, value) };
    match value {
        Value::Array(values) if values.len() == elements => values
            .iter()
            .map(|value| convert_one(variable, value))
            .collect::<Result<_, _>>()
            .map(Value::Array),
        Value::Array(_) => Err(wrong("array of different size")),
        _ if elements == 1 => Ok(Value::Array(vec![convert_one(variable, value)?])),
        _ => Err(wrong("a scalar for an array")),
    }
}

/// Converts a single value as [`convert`] does.
pub(crate) fn convert_one(variable: &Variable, value: &Value) -> Result<Value> {
    if let Value::Real(x) = value
        && !x.is_finite()
    {
        return Err(FmiError::NotFinite { name: variable.name.clone(), value: *x });
    }
    let kind = variable.kind;
    let wrong = |given| wrong_type(variable, value, given);
    let in_range = |i: i128| match variable.integer_range() {
        Some((least, most)) if (least..=most).contains(&i) => Ok(Value::Integer(i)),
        _ => Err(out_of_range(variable, value)),
    };
    match (kind, value) {
        (VariableKind::Real | VariableKind::Float32, Value::Real(_))
        | (VariableKind::Boolean | VariableKind::Clock, Value::Boolean(_))
        | (VariableKind::String, Value::String(_))
        | (VariableKind::Binary, Value::Binary(_)) => Ok(value.clone()),
        (VariableKind::Real | VariableKind::Float32, Value::Integer(i)) => Ok(Value::Real(*i as f64)),
        (kind, Value::Integer(i)) if kind.is_integer() => in_range(*i),
        (kind, Value::Real(x)) if kind.is_integer() => match whole(*x) {
            Some(i) => in_range(i),
            None => Err(wrong(value.kind_name())),
        },
        _ => Err(wrong(value.kind_name())),
    }
}

/// Returns the error for a value that does not fit a variable. `given` describes the type of the value.
pub(crate) fn wrong_type(variable: &Variable, value: &Value, given: &'static str) -> FmiError {
    let (name, value) = (variable.name.clone(), value.clone());
    FmiError::WrongType { name, kind: variable.kind, value, given }
}

fn out_of_range(variable: &Variable, value: &Value) -> FmiError {
    let range = variable.integer_range().unwrap_or_default();
    FmiError::OutOfRange { name: variable.name.clone(), kind: variable.kind, value: value.clone(), range }
}

/// Returns the value with its sign reversed. A Boolean is inverted.
pub(crate) fn negate(value: Value) -> Value {
    match value {
        Value::Real(x) => Value::Real(-x),
        Value::Integer(i) => Value::Integer(-i),
        Value::Boolean(b) => Value::Boolean(!b),
        Value::Array(values) => Value::Array(values.into_iter().map(negate).collect()),
        other => other,
    }
}

/// Returns an error with the reason for variables that can never be set before a simulation. See FMI 2.0.x,
/// section 2.2.7 (table of causality, variability and initial) and section 3.2.2 (settable variables in each
/// state).
pub(crate) fn check_settable_at_start(variable: &Variable) -> Result<()> {
    let reason = if variable.causality == Causality::Independent {
        "it is the independent variable (time)"
    } else if variable.variability == Variability::Constant {
        "it is a constant"
    } else if variable.kind == VariableKind::Clock {
        "it is a clock; clocks are activated in event mode"
    } else if variable.causality == Causality::Input
        || matches!(variable.initial, Some(Initial::Exact | Initial::Approx))
    {
        return Ok(());
    } else if variable.causality == Causality::CalculatedParameter {
        "it is a calculated parameter"
    } else {
        "the model calculates it (initial = calculated)"
    };
    Err(not_settable(variable, reason))
}

/// Returns an error for variables that cannot be set in initialization mode: all except inputs and variables
/// with `initial = exact`.
pub(crate) fn check_settable_in_initialization(variable: &Variable) -> Result<()> {
    check_settable_at_start(variable)?;
    if variable.causality == Causality::StructuralParameter {
        return Err(not_settable(variable, "structural parameters are set before the initialization"));
    }
    if variable.causality == Causality::Input || variable.initial == Some(Initial::Exact) {
        Ok(())
    } else {
        Err(not_settable(
            variable,
            "its start value is a guess, and initialization mode calculates its value",
        ))
    }
}

/// Returns an error for all variables except inputs and tunable parameters. Only these can be set in event
/// mode and between communication points.
pub(crate) fn check_settable_when_discrete(variable: &Variable, reason: &'static str) -> Result<()> {
    match (variable.causality, variable.variability) {
        (Causality::Input, _) | (Causality::Parameter, Variability::Tunable) => Ok(()),
        _ => Err(not_settable(variable, reason)),
    }
}

/// Returns an error for variables that cannot be set in continuous-time mode: all except continuous inputs.
pub(crate) fn check_settable_in_continuous_time(variable: &Variable) -> Result<()> {
    match (variable.causality, variable.variability) {
        (Causality::Input, Variability::Continuous) => Ok(()),
        _ => Err(not_settable(variable, "in continuous-time mode only continuous inputs can be set")),
    }
}

/// Returns an error for all variables except tunable structural parameters.
pub(crate) fn check_settable_in_reconfiguration(variable: &Variable) -> Result<()> {
    match (variable.causality, variable.variability) {
        (Causality::StructuralParameter, Variability::Tunable) => Ok(()),
        (Causality::StructuralParameter, _) => {
            Err(not_settable(variable, "it is a structural parameter that is fixed after the initialization"))
        }
        _ => Err(not_settable(
            variable,
            "in reconfiguration mode only tunable structural parameters can be set",
        )),
    }
}

pub(crate) fn not_settable(variable: &Variable, reason: &'static str) -> FmiError {
    FmiError::NotSettable { name: variable.name.clone(), reason }
}

/// Values by type, each type for one call.
#[derive(Debug, Clone, Default)]
pub(crate) struct Assignments {
    pub(crate) reals: (Vec<u32>, Vec<f64>),
    pub(crate) packed: Vec<(VariableKind, Vec<u32>, Vec<i64>)>,
    pub(crate) strings: (Vec<u32>, Vec<CString>),
    pub(crate) binaries: (Vec<u32>, Vec<Vec<u8>>),
}

impl Assignments {
    /// True if there is nothing to set.
    pub(crate) fn is_empty(&self) -> bool {
        self.reals.0.is_empty()
            && self.packed.is_empty()
            && self.strings.0.is_empty()
            && self.binaries.0.is_empty()
    }

    /// Returns the types and references of the variables to set.
    pub(crate) fn references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        fn of(kind: VariableKind, list: &[u32]) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
            list.iter().map(move |reference| (kind, *reference))
        }
        of(VariableKind::Real, &self.reals.0)
            .chain(self.packed.iter().flat_map(|(kind, list, _)| of(*kind, list)))
            .chain(of(VariableKind::String, &self.strings.0))
            .chain(of(VariableKind::Binary, &self.binaries.0))
    }

    /// Adds a value, or the elements of an array (`elements` of them).
    ///
    /// # Errors
    /// Returns an error if the value has the wrong type, is not finite, or is a text with a NUL.
    pub(crate) fn push(&mut self, variable: &Variable, value: &Value, elements: Option<usize>) -> Result<()> {
        let value = convert(variable, value, elements)?;
        let value = if variable.negated { negate(value) } else { value };
        let (kind, reference) = (variable.kind, variable.value_reference);
        match kind {
            VariableKind::Real => self.reals.0.push(reference),
            VariableKind::String => self.strings.0.push(reference),
            VariableKind::Binary => self.binaries.0.push(reference),
            kind => match self.packed.iter_mut().find(|(packed_kind, ..)| *packed_kind == kind) {
                Some((_, references, _)) => references.push(reference),
                None => self.packed.push((kind, vec![reference], Vec::new())),
            },
        }
        match value {
            Value::Array(values) => values.iter().try_for_each(|value| self.push_value(variable, value)),
            value => self.push_value(variable, &value),
        }
    }

    fn push_value(&mut self, variable: &Variable, value: &Value) -> Result<()> {
        let kind = variable.kind;
        match (kind, value) {
            (VariableKind::Real, Value::Real(x)) => self.reals.1.push(*x),
            (VariableKind::String, Value::String(text)) => {
                let text = CString::new(text.as_str())
                    .map_err(|_| wrong_type(variable, value, "string with a NUL character"))?;
                self.strings.1.push(text);
            }
            (VariableKind::Binary, Value::Binary(bytes)) => self.binaries.1.push(bytes.clone()),
            _ => {
                let word = integer_codec::word(kind, value).ok_or_else(|| out_of_range(variable, value))?;
                let group = self.packed.iter_mut().find(|(packed_kind, ..)| *packed_kind == kind);
                group.into_iter().for_each(|(_, _, words)| words.push(word));
            }
        }
        Ok(())
    }
}
