//! Values that are set repeatedly, per variable or array element. FMI sets only complete arrays, so the
//! remaining elements keep their start values.

use crate::description::{ModelDescription, Structure, Value, VariableKind};
use crate::error::{FmiError, Result};
use crate::instance::Core;
use crate::instance::assignments::{self, Assignments, resolve};
use crate::simulation::outputs::element_of;
use crate::sys::{Fault, RawInstance};
use std::collections::HashMap;

/// Variable, or one of its elements (counted from 0, the last index varying fastest).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct VariableElement {
    pub(crate) variable: usize,
    pub(crate) element: Option<usize>,
}

impl VariableElement {
    /// Resolves a name of a variable or of an element such as `name[2,1]`, counted from 1.
    ///
    /// # Errors
    /// Returns [`FmiError::UnknownVariable`] with the nearest names.
    pub(crate) fn of_name(description: &ModelDescription, structure: &Structure, name: &str) -> Result<Self> {
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

    /// True if both refer to a common value. Aliases have the same reference.
    pub(crate) fn overlaps(self, other: VariableElement, description: &ModelDescription) -> bool {
        let reference = |place: VariableElement| {
            let variable = &description.variables[place.variable];
            (variable.kind, variable.value_reference)
        };
        (self.variable == other.variable || reference(self) == reference(other))
            && (self.element.is_none() || other.element.is_none() || self.element == other.element)
    }
}

/// Start values of a simulation: the requested values, otherwise the model's.
#[derive(Clone, Copy)]
pub(crate) struct Starts<'a> {
    pub(crate) description: &'a ModelDescription,
    pub(crate) structure: &'a Structure,
    /// Variable indices and values, each index once.
    pub(crate) given: &'a [(usize, Value)],
}

impl<'a> Starts<'a> {
    /// Returns the start value of a variable, if it has one.
    pub(crate) fn of(&self, variable: usize) -> Option<&'a Value> {
        let given = self.given.iter().find(|(index, _)| *index == variable).map(|(_, value)| value);
        given.or(self.description.variables[variable].start.as_ref())
    }

    /// Returns the start values of all elements of an array.
    ///
    /// # Errors
    /// Returns an error if there are no start values, or their number differs from the number of elements.
    pub(crate) fn elements(&self, variable: usize) -> Result<Vec<Value>> {
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
                    "one element of {} is specified, so the other elements require start values, but there \
                     are {found} start values for {n} elements",
                    array.name
                );
                Err(FmiError::BadSetting(problem))
            }
        }
    }

    /// Returns the array with one element replaced.
    ///
    /// # Errors
    /// Returns the errors of [`elements`](Self::elements).
    pub(crate) fn with_element(&self, variable: usize, element: usize, value: Value) -> Result<Value> {
        let mut values = self.elements(variable)?;
        // The index is in range, because it was computed from the same extents.
        if let Some(place) = values.get_mut(element) {
            *place = value;
        }
        Ok(Value::Array(values))
    }
}

/// Returns the element of an array. Other values, and arrays without this element, are returned unchanged.
pub(crate) fn element_value(value: Value, element: Option<usize>) -> Value {
    match (value, element) {
        (Value::Array(mut values), Some(element)) if element < values.len() => values.swap_remove(element),
        (value, _) => value,
    }
}

/// Variables of one type for one call, with all their values. `start` contains the start values, which a run
/// copies and modifies before it sets them.
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
    /// Returns the index of the value of a variable or element. `whole` returns all start values of the
    /// variable.
    ///
    /// # Errors
    /// Returns the errors of `whole`.
    pub(crate) fn place(
        &mut self,
        reference: u32,
        element: Option<usize>,
        whole: impl FnOnce() -> Result<Vec<T>>,
    ) -> Result<usize> {
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

/// Floating-point variables, set with one call per type. Variables of type `Real` precede variables of type
/// `Float32`.
#[derive(Debug, Clone, Default)]
pub(crate) struct FloatSlots {
    slots: Slots<f64>,
    /// Number of references and number of values of type `Real`.
    reals: (usize, usize),
}

impl FloatSlots {
    /// Creates `n` values without variables.
    #[cfg(test)]
    pub(crate) fn of_zeros(n: usize) -> Self {
        Self { slots: Slots { start: vec![0.0; n], ..Slots::default() }, reals: (0, n) }
    }

    /// Returns an index as [`Slots::place`] does. All variables of type `Real` must be placed before the
    /// others.
    ///
    /// # Errors
    /// Returns the errors of `Starts::reals`.
    pub(crate) fn place(&mut self, starts: &Starts<'_>, place: VariableElement) -> Result<usize> {
        let variable = &starts.description.variables[place.variable];
        let found = self.slots.place(variable.value_reference, place.element, || starts.reals(place))?;
        if variable.kind == VariableKind::Real {
            self.reals = (self.slots.references.len(), self.slots.start.len());
        }
        Ok(found)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.slots.references.is_empty()
    }

    /// Returns the start values.
    pub(crate) fn start(&self) -> &[f64] {
        &self.slots.start
    }

    /// Returns the references and the number of values of the variables of type `Real`.
    pub(crate) fn reals(&self) -> (&[u32], usize) {
        (&self.slots.references[..self.reals.0], self.reals.1)
    }

    /// Returns the variables with their types and references.
    pub(crate) fn references(&self) -> impl Iterator<Item = (VariableKind, u32)> + '_ {
        let kind = |i| if i < self.reals.0 { VariableKind::Real } else { VariableKind::Float32 };
        self.slots.references.iter().enumerate().map(move |(i, reference)| (kind(i), *reference))
    }

    /// Sets the variables.
    pub(crate) fn send(&self, raw: &mut RawInstance, values: &[f64]) -> Result<(), Fault> {
        let (references, single_references) = self.slots.references.split_at(self.reals.0);
        let (values, singles) = values.split_at(self.reals.1);
        if !references.is_empty() {
            raw.set_real(references, values)?;
        }
        if !single_references.is_empty() {
            raw.set_singles(single_references, singles)?;
        }
        Ok(())
    }

    /// Sets the variables. An error contains their names.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub(crate) fn set(&self, core: &mut Core, values: &[f64]) -> Result<()> {
        let sent = self.send(&mut core.raw, values);
        sent.map_err(|fault| core.error_about(fault, &self.slots.references, VariableKind::is_float))
    }
}

/// Start values of variables.
#[derive(Debug, Clone, Default)]
pub(crate) struct StartValues {
    /// Values set before the initialization.
    pub(crate) early: Assignments,
    /// Values of inputs. The standard allows setting them before and during the initialization. Some models
    /// reject them before it.
    pub(crate) inputs: Assignments,
}

/// Input of one run: the plan's start values, or other values for the same variables, and the values of the
/// parameters.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RunInput<'a> {
    pub(crate) start: &'a StartValues,
    pub(crate) parameters: &'a [f64],
}
