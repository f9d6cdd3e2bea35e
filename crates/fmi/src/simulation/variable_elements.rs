//! Values that are given anew again and again, by variable or by element of an array: FMI sets arrays as a whole, so that
//! what is not given keeps its start value.

use crate::description::{ModelDescription, Structure, Value};
use crate::error::FmiError;
use crate::instance::assignments::{self, Assignments, resolve};
use crate::simulation::outputs::element_of;
use std::collections::HashMap;

/// A variable, or one element of it (counted from 0, the last index varying fastest).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct VariableElement {
    pub(crate) variable: usize,
    pub(crate) element: Option<usize>,
}

impl VariableElement {
    /// What a name stands for: a variable, or `name[2,1]`, counted from 1.
    ///
    /// # Errors
    /// [`FmiError::UnknownVariable`] with the nearest names.
    pub(crate) fn of_name(
        description: &ModelDescription,
        structure: &Structure,
        name: &str,
    ) -> Result<Self, FmiError> {
        if let Some(variable) = description.variable_index(name) {
            return Ok(Self { variable, element: None });
        }
        let extents = |array: &str| Some(structure.extents(description, description.variable(array)?));
        let (name, element) = match element_of(name, extents) {
            Some((array, element)) => (array, Some(element)),
            None => (name, None),
        };
        Ok(Self { variable: resolve(description, name)?, element })
    }

    /// Whether the two have a value in common: aliases have the same reference.
    pub(crate) fn overlaps(self, other: VariableElement, description: &ModelDescription) -> bool {
        let reference = |place: VariableElement| {
            let variable = &description.variables[place.variable];
            (variable.kind, variable.value_reference)
        };
        (self.variable == other.variable || reference(self) == reference(other))
            && (self.element.is_none() || other.element.is_none() || self.element == other.element)
    }
}

/// The start values of a simulation: those given, else those of the model.
#[derive(Clone, Copy)]
pub(crate) struct Starts<'a> {
    pub(crate) description: &'a ModelDescription,
    pub(crate) structure: &'a Structure,
    /// Positions and values, each position once.
    pub(crate) given: &'a [(usize, Value)],
}

impl<'a> Starts<'a> {
    /// The start value of a variable, if it has one.
    pub(crate) fn of(&self, variable: usize) -> Option<&'a Value> {
        let given = self.given.iter().find(|(index, _)| *index == variable).map(|(_, value)| value);
        given.or(self.description.variables[variable].start.as_ref())
    }

    /// The start values of all elements of an array.
    ///
    /// # Errors
    /// There are none, or not as many as the array has elements.
    pub(crate) fn elements(&self, variable: usize) -> Result<Vec<Value>, FmiError> {
        let array = &self.description.variables[variable];
        let n = self.structure.elements(self.description, array);
        match self.of(variable) {
            Some(value @ Value::Array(values)) if values.len() == n => {
                match assignments::convert(array, value, Some(n))? {
                    Value::Array(values) => Ok(values),
                    other => Ok(vec![other]),
                }
            }
            other => {
                let found = match other {
                    Some(Value::Array(values)) => values.len(),
                    other => usize::from(other.is_some()),
                };
                let problem = format!(
                    "one element of {} is given; the others need start values, and there are {found} for {n} elements",
                    array.name
                );
                Err(FmiError::BadSetting { problem })
            }
        }
    }

    /// The array with one element replaced.
    ///
    /// # Errors
    /// As [`elements`](Self::elements).
    pub(crate) fn with_element(
        &self,
        variable: usize,
        element: usize,
        value: Value,
    ) -> Result<Value, FmiError> {
        let mut values = self.elements(variable)?;
        // Elements are counted by the same extents.
        if let Some(place) = values.get_mut(element) {
            *place = value;
        }
        Ok(Value::Array(values))
    }
}

/// The element of an array; other values, and arrays without this element, as they are.
pub(crate) fn element_value(value: Value, element: Option<usize>) -> Value {
    match (value, element) {
        (Value::Array(mut values), Some(element)) if element < values.len() => values.swap_remove(element),
        (value, _) => value,
    }
}

/// Variables of one type for one call, and all their values: what a run writes before it sets them, and start values.
#[derive(Debug, Clone)]
pub(crate) struct Slots<T> {
    pub(crate) references: Vec<u32>,
    pub(crate) start: Vec<T>,
    firsts: HashMap<u32, usize>,
}

impl<T> Default for Slots<T> {
    fn default() -> Self {
        Self { references: Vec::new(), start: Vec::new(), firsts: HashMap::new() }
    }
}

impl<T> Slots<T> {
    /// Where the value of a variable or an element goes; `whole`: all start values of the variable.
    ///
    /// # Errors
    /// Those of `whole`.
    pub(crate) fn place(
        &mut self,
        reference: u32,
        element: Option<usize>,
        whole: impl FnOnce() -> Result<Vec<T>, FmiError>,
    ) -> Result<usize, FmiError> {
        let first = match self.firsts.get(&reference) {
            Some(first) => *first,
            None => {
                let first = self.start.len();
                self.start.extend(whole()?);
                self.references.push(reference);
                self.firsts.insert(reference, first);
                first
            }
        };
        Ok(first + element.unwrap_or(0))
    }
}

/// The values that variables start with.
#[derive(Debug, Clone, Default)]
pub(crate) struct StartValues {
    /// Set before the initialization.
    pub(crate) early: Assignments,
    /// Of inputs. The standard allows them before the initialization and in it; models are known that refuse them before.
    pub(crate) inputs: Assignments,
}

/// What one run is given: start values, those of the plan or others for the same variables, and the values of its parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RunInput<'a> {
    pub(crate) start: &'a StartValues,
    pub(crate) parameters: &'a [f64],
}

/// What a run sets besides the settings of its plan: variables that were set in the copy by earlier runs with other plans.
#[derive(Debug, Default)]
pub(crate) struct Unset {
    pub(crate) structural: Assignments,
    /// Set before the initialization.
    pub(crate) early: Assignments,
    /// Of inputs.
    pub(crate) inputs: Assignments,
}
