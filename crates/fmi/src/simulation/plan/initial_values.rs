//! Values that variables have when a simulation starts, whatever the initialization makes of their start
//! values: initial states, and the start values of states that the initialization may change.

use crate::description::{Initial, ModelDescription, Value, VariableKind};
use crate::error::{FmiError, Result};
use crate::fmu::Fmu;
use crate::instance::Core;
use crate::simulation::variable_elements::{Starts, VariableElement, element_value};
use crate::value::is_same_number;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// A value that a variable is to have at the start.
#[derive(Debug)]
pub(crate) struct InitialValue {
    pub(crate) place: VariableElement,
    given: GivenNumber,
    /// Position in the state vector (model exchange).
    state: Option<usize>,
}

#[derive(Debug, Clone, Copy)]
enum GivenNumber {
    Constant(f64),
    /// A parameter of the run, and its sign relative to the variable.
    Parameter(usize, f64),
}

/// The values that variables are to have at the start.
#[derive(Debug, Default)]
pub(crate) struct InitialValues {
    /// Initial states: set after the initialization in model exchange; a simulation without one is refused.
    pub(crate) required: Vec<InitialValue>,
    /// Start values of states that are guesses by the description: one without effect is a quirk.
    guesses: Vec<InitialValue>,
    /// The guesses have been compared.
    are_guesses_compared: AtomicBool,
}

impl InitialValues {
    /// The values of the variables `required`, by name, and of states whose start values are guesses.
    /// `parameters`: of the run.
    ///
    /// # Errors
    /// A name is unknown, has no value among the start values and parameters, or is no floating-point number.
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
                    "initial state {name} has no value: give it a start value, or make it a parameter of the run"
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

    /// Compares an initialized instance with the start values that are guesses, in the first run.
    pub(crate) fn compare_guesses(&self, core: &mut Core, fmu: &Fmu, parameters: &[f64]) {
        if self.guesses.is_empty() || self.are_guesses_compared.swap(true, Ordering::Relaxed) {
            return;
        }
        for guess in &self.guesses {
            let given = guess.value(parameters);
            // A model that does not answer cannot be asked.
            if let Ok(Some(found)) = guess.differs(core, given) {
                let name = &fmu.description().variables[guess.place.variable].name;
                fmu.note_ineffective_start_value(name, given, found);
            }
        }
    }

    /// Refuses an initialized instance that does not have the values required.
    pub(crate) fn check_required(&self, core: &mut Core, fmu: &Fmu, parameters: &[f64]) -> Result<()> {
        self.required.iter().try_for_each(|required| required.check(core, fmu, required.value(parameters)))
    }
}

impl InitialValue {
    /// The value of the variable.
    pub(crate) fn value(&self, parameters: &[f64]) -> f64 {
        match self.given {
            GivenNumber::Constant(value) => value,
            GivenNumber::Parameter(i, sign) => sign * parameters[i],
        }
    }

    /// Position in the state vector; `references`: its variables, of an FMU whose description does not say
    /// which they are (FMI 1.0).
    pub(crate) fn position(&self, fmu: &Fmu, references: &[u32]) -> Option<usize> {
        let own = fmu.description().variables[self.place.variable].value_reference;
        self.state.or_else(|| references.iter().position(|reference| *reference == own))
    }

    /// The value that the variable has, if it is another one than that given.
    fn differs(&self, core: &mut Core, given: f64) -> Result<Option<f64>> {
        let fmu = core.fmu().clone();
        let value = core.value(&fmu.description().variables[self.place.variable])?;
        let found = element_value(value, self.place.element).as_number().unwrap_or(f64::NAN);
        Ok((!is_same_number(given, found)).then_some(found))
    }

    /// Refuses a variable with another value than `given`.
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

/// The value given to a variable or an element: of a parameter of the run, else the start value.
fn given_number(
    starts: &Starts<'_>,
    parameters: &[VariableElement],
    place: VariableElement,
) -> Result<Option<GivenNumber>> {
    let description = starts.description;
    let is_it = |parameter: &VariableElement| parameter.overlaps(place, description);
    // An alias may have the other sign.
    let sign = |i: usize| if description.variables[i].negated { -1.0 } else { 1.0 };
    let relative = |i: usize| sign(i) * sign(place.variable);
    if let Some(i) = parameters.iter().position(is_it) {
        return Ok(Some(GivenNumber::Parameter(i, relative(parameters[i].variable))));
    }
    let reference = |i: usize| (description.variables[i].kind, description.variables[i].value_reference);
    // Of several aliases the model gets the last value.
    let given = starts.given.iter().rfind(|(index, _)| reference(*index) == reference(place.variable));
    let Some((index, value)) = given else { return Ok(None) };
    match element_value(value.clone(), place.element) {
        Value::Real(value) => Ok(Some(GivenNumber::Constant(relative(*index) * value))),
        _ => {
            let name = &description.variables[place.variable].name;
            Err(FmiError::BadSetting(format!("{name} cannot be an initial state: it is not one real number")))
        }
    }
}

/// Positions of the states in the state vector, by their references; of arrays that of the first element.
#[derive(Debug, Default)]
pub(super) struct StatePositions(HashMap<u32, usize>);

impl StatePositions {
    /// `states`: the variables of the state vector, by their positions in the description.
    pub(super) fn new(description: &ModelDescription, states: &[Option<usize>]) -> Self {
        let mut positions = HashMap::new();
        for (i, state) in states.iter().enumerate() {
            if let Some(state) = state {
                positions.entry(description.variables[*state].value_reference).or_insert(i);
            }
        }
        Self(positions)
    }

    /// Position of a variable, or an element of one.
    pub(super) fn of(&self, description: &ModelDescription, place: VariableElement) -> Option<usize> {
        let variable = &description.variables[place.variable];
        let first = self.0.get(&variable.value_reference).filter(|_| variable.kind == VariableKind::Real)?;
        Some(first + place.element.unwrap_or(0))
    }
}
