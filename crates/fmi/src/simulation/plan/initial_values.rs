//! Values that variables must have when a simulation starts, even if the initialization computes others.
//! These are initial states, and start values of states that the initialization may change.

use crate::description::{Initial, ModelDescription, Value, VariableKind};
use crate::error::{FmiError, Result};
use crate::fmu::Fmu;
use crate::instance::Core;
use crate::simulation::variable_elements::{Starts, VariableElement, element_value};
use crate::value::is_same_number;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Required value of a variable at the start.
#[derive(Debug)]
pub(crate) struct InitialValue {
    pub(crate) place: VariableElement,
    given: GivenNumber,
    /// Index in the state vector (model exchange).
    state: Option<usize>,
}

#[derive(Debug, Clone, Copy)]
enum GivenNumber {
    Constant(f64),
    /// Parameter of the run, and its sign relative to the variable.
    Parameter(usize, f64),
}

/// Required values of variables at the start.
#[derive(Debug, Default)]
pub(crate) struct InitialValues {
    /// Initial states. Model exchange sets them after the initialization. A simulation fails if one of them
    /// does not have its value.
    pub(crate) required: Vec<InitialValue>,
    /// Start values of states that are guesses according to the description. A guess without effect is a
    /// quirk.
    guesses: Vec<InitialValue>,
    /// True if the guesses have been compared.
    are_guesses_compared: AtomicBool,
}

impl InitialValues {
    /// Creates the values of the named variables `required`, and of states whose start values are guesses.
    /// `parameters` are the parameters of the run.
    ///
    /// # Errors
    /// Returns an error if a name is unknown, has no value among the start values and parameters, or is not a
    /// floating-point number.
    pub(super) fn new(
        starts: &Starts<'_>,
        required: &[String],
        parameters: &[VariableElement],
        states: &StatePositions,
    ) -> Result<Self> {
        let description = starts.description;
        let mut values = Self::default();
        for name in required {
            let place = VariableElement::of_name(description, starts.structure, name)?;
            let given = given_number(starts, parameters, place)?.ok_or_else(|| {
                FmiError::BadSetting(format!(
                    "initial state {name} has no value; specify a start value, or make it a parameter of the \
                     run"
                ))
            })?;
            values.required.push(InitialValue { place, given, state: states.of(description, place) });
        }
        let starts_given = starts.given.iter().map(|(variable, value)| {
            let place = VariableElement { variable: *variable, element: None };
            (place, value.as_number().map(GivenNumber::Constant))
        });
        let parameters = parameters.iter().enumerate();
        let parameters = parameters.map(|(i, place)| (*place, Some(GivenNumber::Parameter(i, 1.0))));
        for (place, given) in starts_given.chain(parameters) {
            let variable = &description.variables[place.variable];
            let is_guess = variable.kind == VariableKind::Real
                && variable.initial == Some(Initial::Approx)
                && variable.dimensions.is_empty()
                && (states.0.is_empty() || states.of(description, place).is_some());
            let is_required = || values.required.iter().any(|one| one.place.overlaps(place, description));
            if let Some(given) = given.filter(|_| is_guess && !is_required()) {
                values.guesses.push(InitialValue { place, given, state: None });
            }
        }
        Ok(values)
    }

    /// Compares the start values that are guesses with an initialized instance, in the first run only.
    pub(crate) fn compare_guesses(&self, core: &mut Core, fmu: &Fmu, parameters: &[f64]) {
        if self.guesses.is_empty() || self.are_guesses_compared.swap(true, Ordering::Relaxed) {
            return;
        }
        for guess in &self.guesses {
            let given = guess.value(parameters);
            // Errors are ignored, because the values cannot be read from such a model.
            if let Ok(Some(found)) = guess.differs(core, given) {
                let name = &fmu.description().variables[guess.place.variable].name;
                fmu.note_ineffective_start_value(name, given, found);
            }
        }
    }

    /// Returns an error if an initialized instance does not have the required values.
    pub(crate) fn check_required(&self, core: &mut Core, fmu: &Fmu, parameters: &[f64]) -> Result<()> {
        self.required.iter().try_for_each(|required| required.check(core, fmu, required.value(parameters)))
    }
}

impl InitialValue {
    /// Returns the value of the variable.
    pub(crate) fn value(&self, parameters: &[f64]) -> f64 {
        match self.given {
            GivenNumber::Constant(value) => value,
            GivenNumber::Parameter(i, sign) => sign * parameters[i],
        }
    }

    /// Returns the index in the state vector. `references` lists the state variables of an FMU whose
    /// description does not define them (FMI 1.0).
    pub(crate) fn position(&self, fmu: &Fmu, references: &[u32]) -> Option<usize> {
        let state_reference = fmu.description().variables[self.place.variable].value_reference;
        self.state.or_else(|| references.iter().position(|reference| *reference == state_reference))
    }

    /// Returns the value of the variable if it differs from `given`.
    fn differs(&self, core: &mut Core, given: f64) -> Result<Option<f64>> {
        let fmu = core.fmu().clone();
        let value = core.value(&fmu.description().variables[self.place.variable])?;
        let found = element_value(value, self.place.element).as_number().unwrap_or(f64::NAN);
        Ok((!is_same_number(given, found)).then_some(found))
    }

    /// Returns an error if the variable has a value other than `given`.
    pub(crate) fn check(&self, core: &mut Core, fmu: &Fmu, given: f64) -> Result<()> {
        match self.differs(core, given)? {
            None => Ok(()),
            Some(found) => {
                let name = fmu.description().variables[self.place.variable].name.clone();
                Err(FmiError::StateNotTaken { name, given, found })
            }
        }
    }
}

/// Returns the value of a variable or element: the parameter of the run, otherwise the start value.
fn given_number(
    starts: &Starts<'_>,
    parameters: &[VariableElement],
    place: VariableElement,
) -> Result<Option<GivenNumber>> {
    let description = starts.description;
    let is_it = |parameter: &VariableElement| parameter.overlaps(place, description);
    // An alias may have the opposite sign.
    let sign = |i: usize| if description.variables[i].negated { -1.0 } else { 1.0 };
    let relative = |i: usize| sign(i) * sign(place.variable);
    if let Some(i) = parameters.iter().position(is_it) {
        return Ok(Some(GivenNumber::Parameter(i, relative(parameters[i].variable))));
    }
    let reference = |i: usize| (description.variables[i].kind, description.variables[i].value_reference);
    // If several aliases have values, the model receives the last one.
    let given = starts.given.iter().rfind(|(index, _)| reference(*index) == reference(place.variable));
    let Some((index, value)) = given else { return Ok(None) };
    match element_value(value.clone(), place.element) {
        Value::Real(value) => Ok(Some(GivenNumber::Constant(relative(*index) * value))),
        _ => {
            let name = &description.variables[place.variable].name;
            Err(FmiError::BadSetting(format!(
                "{name} cannot be an initial state: it is not a scalar real variable"
            )))
        }
    }
}

/// Indices of the states in the state vector, by value reference. For an array, the index of its first
/// element.
#[derive(Debug, Default)]
pub(super) struct StatePositions(HashMap<u32, usize>);

impl StatePositions {
    /// Creates the indices. `states` contains the state variables by their index in the description.
    pub(super) fn new(description: &ModelDescription, states: &[Option<usize>]) -> Self {
        let mut positions = HashMap::new();
        for (i, state) in states.iter().enumerate() {
            if let Some(state) = state {
                positions.entry(description.variables[*state].value_reference).or_insert(i);
            }
        }
        Self(positions)
    }

    /// Returns the index of a variable or of one of its elements.
    pub(super) fn of(&self, description: &ModelDescription, place: VariableElement) -> Option<usize> {
        let variable = &description.variables[place.variable];
        let first = self.0.get(&variable.value_reference).filter(|_| variable.kind == VariableKind::Real)?;
        Some(first + place.element.unwrap_or(0))
    }
}
