//! Values on their way into an FMU: names resolved, types and settability checked, sorted into one call per type.

use crate::description::{Causality, Initial, ModelDescription, Value, Variability, Variable, VariableKind};
use crate::error::FmiError;
use std::ffi::CString;

/// Position of the variable of this name.
///
/// # Errors
/// [`FmiError::UnknownVariable`] with the nearest names.
pub(crate) fn resolve(description: &ModelDescription, name: &str) -> Result<usize, FmiError> {
    description.variable_index(name).ok_or_else(|| FmiError::UnknownVariable {
        name: name.to_owned(),
        nearest: description.nearest_names(name, 3).into_iter().map(str::to_owned).collect(),
    })
}

/// Converts a value to the variable's type: integers to reals, and reals that are whole numbers to integers.
///
/// # Errors
/// [`FmiError::WrongType`], and [`FmiError::NotFinite`] for NaN and infinities.
pub(crate) fn convert(variable: &Variable, value: &Value) -> Result<Value, FmiError> {
    if let Value::Real(x) = value
        && !x.is_finite()
    {
        return Err(FmiError::NotFinite { name: variable.name.clone(), value: *x });
    }
    match (variable.kind, value) {
        (VariableKind::Real, Value::Real(_))
        | (VariableKind::Integer | VariableKind::Enumeration, Value::Integer(_))
        | (VariableKind::Boolean, Value::Boolean(_))
        | (VariableKind::String, Value::String(_)) => Ok(value.clone()),
        (VariableKind::Real, Value::Integer(i)) => Ok(Value::Real(f64::from(*i))),
        (VariableKind::Integer | VariableKind::Enumeration, Value::Real(x)) if whole(*x).is_some() => {
            Ok(Value::Integer(whole(*x).unwrap_or_default()))
        }
        _ => Err(FmiError::WrongType {
            name: variable.name.clone(),
            kind: variable.kind,
            value: value.clone(),
            given: value.kind_name(),
        }),
    }
}

/// A real that is a 32-bit integer.
pub(crate) fn whole(x: f64) -> Option<i32> {
    let i = x as i32;
    (f64::from(i) == x).then_some(i)
}

/// Refuses variables that can never be set before a simulation, and says why
/// (FMI 2.0.x, section 2.2.7: table of causality, variability and initial; section 3.2.2: when what may be set).
pub(crate) fn check_settable_at_start(variable: &Variable) -> Result<(), FmiError> {
    let reason = if variable.causality == Causality::Independent {
        "it is the independent variable (time)"
    } else if variable.variability == Variability::Constant {
        "it is a constant"
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

/// Refuses what initialization mode does not let be set: all but inputs and variables with `initial = exact`.
pub(crate) fn check_settable_in_initialization(variable: &Variable) -> Result<(), FmiError> {
    check_settable_at_start(variable)?;
    if variable.causality == Causality::Input || variable.initial == Some(Initial::Exact) {
        Ok(())
    } else {
        Err(not_settable(variable, "its start value is a guess, which initialization mode calculates"))
    }
}

/// Refuses what event mode does not let be set: all but inputs and tunable parameters.
pub(crate) fn check_settable_in_event_mode(variable: &Variable) -> Result<(), FmiError> {
    match (variable.causality, variable.variability) {
        (Causality::Input, _) | (Causality::Parameter, Variability::Tunable) => Ok(()),
        _ => Err(not_settable(variable, "in event mode only inputs and tunable parameters can be set")),
    }
}

/// Refuses what continuous-time mode does not let be set: all but continuous inputs.
pub(crate) fn check_settable_in_continuous_time(variable: &Variable) -> Result<(), FmiError> {
    match (variable.causality, variable.variability) {
        (Causality::Input, Variability::Continuous) => Ok(()),
        _ => Err(not_settable(variable, "in continuous-time mode only continuous inputs can be set")),
    }
}

/// Refuses what cannot be set between communication points: all but inputs and tunable parameters.
pub(crate) fn check_settable_in_step_mode(variable: &Variable) -> Result<(), FmiError> {
    match (variable.causality, variable.variability) {
        (Causality::Input, _) | (Causality::Parameter, Variability::Tunable) => Ok(()),
        _ => Err(not_settable(variable, "between steps only inputs and tunable parameters can be set")),
    }
}

pub(crate) fn not_settable(variable: &Variable, reason: &'static str) -> FmiError {
    FmiError::NotSettable { name: variable.name.clone(), reason }
}

/// Values by type, each type for one call.
#[derive(Debug, Clone, Default)]
pub(crate) struct Assignments {
    pub(crate) reals: (Vec<u32>, Vec<f64>),
    pub(crate) integers: (Vec<u32>, Vec<i32>),
    pub(crate) booleans: (Vec<u32>, Vec<bool>),
    pub(crate) strings: (Vec<u32>, Vec<CString>),
}

impl Assignments {
    /// Adds a value.
    ///
    /// # Errors
    /// The value has the wrong type, is not finite, or is a text with a NUL.
    pub(crate) fn push(&mut self, variable: &Variable, value: &Value) -> Result<(), FmiError> {
        let reference = variable.value_reference;
        match convert(variable, value)? {
            Value::Real(x) => {
                self.reals.0.push(reference);
                self.reals.1.push(x);
            }
            Value::Integer(i) => {
                self.integers.0.push(reference);
                self.integers.1.push(i);
            }
            Value::Boolean(b) => {
                self.booleans.0.push(reference);
                self.booleans.1.push(b);
            }
            Value::String(text) => {
                let text = CString::new(text).map_err(|_| FmiError::WrongType {
                    name: variable.name.clone(),
                    kind: variable.kind,
                    value: value.clone(),
                    given: "text with a NUL character",
                })?;
                self.strings.0.push(reference);
                self.strings.1.push(text);
            }
        }
        Ok(())
    }
}
