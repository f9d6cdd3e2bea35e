//! Values that runs set in their instances: structure, start values and parameters.

use super::initial_values::{InitialValues, StatePositions};
use super::read_back::{Lost, ReadBack, ReadBackBuffers};
use crate::description::{Causality, ModelDescription, Structure, Value, VariableKind};
use crate::error::{FmiError, Result};
use crate::instance::Core;
use crate::instance::assignments::{self, Assignments, check_settable_at_start};
use crate::libraries::Setting;
use crate::simulation::inputs::InputPlan;
use crate::simulation::variable_elements::{FloatSlots, RunInput, StartValues, Starts, VariableElement};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;

/// Parameter that each run sets.
#[derive(Debug, Clone, Copy)]
struct RunParameter {
    place: VariableElement,
    /// Index among the values set.
    slot: usize,
    /// Sign: -1 for negated aliases.
    sign: f64,
    set: SetAt,
}

/// Time at which a parameter of a run is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SetAt {
    /// Before the initialization.
    Early,
    /// Input: in initialization mode, and also before it if the model extrapolates inputs.
    Initialization,
    /// Initial state that the model calculates: only after the initialization.
    Start,
}

/// Resolved and checked values of a run.
#[derive(Debug, Default)]
pub(crate) struct RunValues {
    pub(crate) start: StartValues,
    /// Values of structural parameters, which determine `structure`.
    structural: Assignments,
    pub(super) structure: Structure,
    parameters: Vec<RunParameter>,
    /// Variables to which the parameters belong.
    parameter_slots: FloatSlots,
    /// Variables to which the parameters that are inputs belong.
    input_slots: FloatSlots,
    pub(super) parameter_names: Vec<String>,
    /// Default values of the parameters.
    pub(super) parameter_starts: Vec<f64>,
    /// Values that are read back from a reused instance.
    pub(crate) read_back: ReadBack,
    /// Required values of variables at the start of the simulation.
    pub(crate) initial: InitialValues,
}

/// Initial states. `are_set` is true if they are set after the initialization.
pub(super) struct InitialStates<'a> {
    pub(super) names: &'a [String],
    /// Indices in the state vector; empty in co-simulation.
    pub(super) positions: StatePositions,
    /// True for model exchange.
    pub(super) are_set: bool,
}

impl InitialStates<'_> {
    /// Returns an error for a variable that can be set neither before nor after the initialization.
    fn check_settable(
        &self,
        description: &ModelDescription,
        place: VariableElement,
        name: &str,
    ) -> Result<()> {
        // Descriptions of FMI 1.0 do not specify the state variables.
        let may_be_state =
            || self.positions.of(description, place).is_some() || description.fmi_version.major == 1;
        match self.are_set && self.has(name) && may_be_state() {
            true => Ok(()),
            false => check_settable_at_start(&description.variables[place.variable]),
        }
    }

    fn has(&self, name: &str) -> bool {
        self.names.iter().any(|listed| listed == name)
    }
}

impl RunValues {
    /// Resolves the start values and the parameters with these names. A driven variable cannot be a
    /// parameter.
    ///
    /// # Errors
    /// Returns an error if a parameter is unknown, specified twice, driven or cannot be set, or if a value
    /// does not fit its variable.
    pub(super) fn new(
        starts: &Starts<'_>,
        parameters: &[String],
        initial: &InitialStates<'_>,
        driven: &[VariableElement],
    ) -> Result<Self> {
        let description = starts.description;
        let mut values = Self { structure: starts.structure.clone(), ..Self::default() };
        values.take_parameters(starts, parameters, initial, driven)?;
        let places: Vec<VariableElement> = values.parameters.iter().map(|one| one.place).collect();
        values.initial = InitialValues::new(starts, initial.names, &places, &initial.positions)?;
        for (index, value) in starts.given {
            let variable = &description.variables[*index];
            let place = VariableElement { variable: *index, element: None };
            let is_driven = || driven.iter().any(|one| one.overlaps(place, description));
            // Skips initial states that the model calculates, and tunable parameters that an input drives
            // from the start.
            if check_settable_at_start(variable).is_err() || variable.is_tunable_parameter() && is_driven() {
                continue;
            }
            let list = match variable.causality {
                Causality::StructuralParameter => &mut values.structural,
                Causality::Input => &mut values.start.inputs,
                _ => &mut values.start.early,
            };
            let is_array = !variable.dimensions.is_empty();
            list.push(variable, value, is_array.then(|| values.structure.elements(description, variable)))?;
            if !matches!(variable.causality, Causality::StructuralParameter | Causality::Input) {
                values.read_back.add_start(variable, &values.start.early);
            }
        }
        for (i, name) in values.parameter_names.iter().enumerate() {
            if let Some(variable) = description.variable(name) {
                values.read_back.add_parameter(variable, i);
            }
        }
        values.read_back.finish();
        Ok(values)
    }

    fn take_parameters(
        &mut self,
        starts: &Starts<'_>,
        names: &[String],
        initial: &InitialStates<'_>,
        driven: &[VariableElement],
    ) -> Result<()> {
        for name in names {
            let place = VariableElement::of_name(starts.description, starts.structure, name)?;
            let variable = &starts.description.variables[place.variable];
            initial.check_settable(starts.description, place, name)?;
            if !variable.kind.is_float() {
                return Err(assignments::not_settable(
                    variable,
                    "only floating-point variables can be parameters of a run",
                ));
            }
            if !variable.dimensions.is_empty() && place.element.is_none() {
                return Err(assignments::not_settable(
                    variable,
                    "it is an array; specify its elements individually, such as name[1]",
                ));
            }
            let is_same = |earlier: &VariableElement| earlier.overlaps(place, starts.description);
            if let Some(first) = self.parameters.iter().position(|earlier| is_same(&earlier.place)) {
                let problem = match &names[first] {
                    first if first == name => format!("parameter {name} is specified twice"),
                    first => {
                        format!("parameter {name} is the same variable as {first}, which is also specified")
                    }
                };
                return Err(FmiError::BadSetting(problem));
            }
            if driven.iter().any(is_same) {
                return Err(assignments::not_settable(variable, "it is driven by an input"));
            }
            let set = match variable.causality {
                Causality::Input => SetAt::Initialization,
                _ if check_settable_at_start(variable).is_err() => SetAt::Start,
                _ => SetAt::Early,
            };
            let sign = if variable.negated { -1.0 } else { 1.0 };
            self.parameters.push(RunParameter { place, slot: 0, sign, set });
            self.parameter_names.push(name.clone());
        }
        // Variables of type Real come first, as `FloatSlots` requires.
        for of_reals in [true, false] {
            for parameter in &mut self.parameters {
                let kind = starts.description.variables[parameter.place.variable].kind;
                if (kind == VariableKind::Real) == of_reals {
                    let slots = match parameter.set {
                        SetAt::Early => &mut self.parameter_slots,
                        SetAt::Initialization => &mut self.input_slots,
                        SetAt::Start => continue,
                    };
                    parameter.slot = slots.place(starts, parameter.place)?;
                }
            }
        }
        self.parameter_starts =
            self.parameters.iter().map(|parameter| self.start_of(starts, parameter)).collect();
        Ok(())
    }

    /// Returns the default value of a parameter.
    fn start_of(&self, starts: &Starts<'_>, parameter: &RunParameter) -> f64 {
        match (parameter.place.element, starts.of(parameter.place.variable)) {
            (Some(_), _) if parameter.set == SetAt::Early => self.parameter_slots.start()[parameter.slot],
            (Some(_), _) if parameter.set == SetAt::Initialization => {
                self.input_slots.start()[parameter.slot]
            }
            (None, Some(Value::Real(x))) if x.is_finite() => *x,
            (None, Some(Value::Integer(i))) => *i as f64,
            _ => 0.0,
        }
    }

    /// Returns all variables that a run sets, including its inputs, sorted.
    pub(super) fn settings(&self, inputs: &InputPlan) -> Arc<[Setting]> {
        let mut settings: Vec<Setting> = Vec::new();
        for values in [&self.structural, &self.start.early, &self.start.inputs] {
            settings.extend(values.references().map(|(kind, reference)| (true, kind, reference)));
        }
        for slots in [&self.parameter_slots, &self.input_slots] {
            settings.extend(slots.references().map(|(kind, reference)| (true, kind, reference)));
        }
        settings.extend(inputs.early_references().map(|(kind, reference)| (true, kind, reference)));
        settings.extend(inputs.references().map(|(kind, reference)| (false, kind, reference)));
        settings.sort_unstable();
        settings.dedup();
        settings.into()
    }

    /// Combines the plan's start values with these parameters.
    pub(crate) fn input<'a>(&'a self, parameters: &'a [f64]) -> RunInput<'a> {
        RunInput { start: &self.start, parameters }
    }

    /// Sets the structure, start values and parameters of a new instance. The start values are the plan's, or
    /// other values for the same variables. `buffer` is scratch memory.
    pub(crate) fn set_up(&self, core: &mut Core, input: RunInput<'_>, buffer: &mut Vec<f64>) -> Result<()> {
        if !self.structure.is_default() {
            core.configure(&self.structural, &self.structure)?;
        }
        core.apply(&input.start.early)?;
        self.set_parameters(core, &self.parameter_slots, SetAt::Early, input.parameters, buffer)
    }

    /// Sets the inputs that do not vary, in initialization mode. `buffer` is scratch memory.
    pub(crate) fn set_up_inputs(
        &self,
        core: &mut Core,
        input: RunInput<'_>,
        buffer: &mut Vec<f64>,
    ) -> Result<()> {
        core.apply(&input.start.inputs)?;
        self.set_parameters(core, &self.input_slots, SetAt::Initialization, input.parameters, buffer)
    }

    /// Sets those parameters of a run that are due at `set`.
    fn set_parameters(
        &self,
        core: &mut Core,
        slots: &FloatSlots,
        set: SetAt,
        values: &[f64],
        buffer: &mut Vec<f64>,
    ) -> Result<()> {
        buffer.clear();
        buffer.extend_from_slice(slots.start());
        for (parameter, value) in self.parameters.iter().zip(values) {
            if parameter.set == set {
                buffer[parameter.slot] = value * parameter.sign;
            }
        }
        slots.set(core, buffer)
    }

    /// True if an initialized instance has the values that [`set_up`](Self::set_up) has set. Errors come from
    /// the FMU.
    pub(crate) fn has_values(
        &self,
        core: &mut Core,
        parameters: &[f64],
        buffers: &mut ReadBackBuffers,
    ) -> Result<bool> {
        self.read_back.agrees(core, &self.start.early, |i| parameters[i] * self.parameters[i].sign, buffers)
    }

    /// Returns the first variable of an initialized instance that does not have its specified value. See
    /// [`ReadBack::first_lost`].
    pub(crate) fn first_lost<'d>(
        &self,
        core: &mut Core,
        description: &'d ModelDescription,
        parameters: &[f64],
    ) -> Result<Option<Lost<'d>>> {
        let given = |i: usize| parameters[i] * self.parameters[i].sign;
        self.read_back.first_lost(core, description, &self.start.early, given)
    }

    /// Checks the parameter values of one run.
    pub(crate) fn check_parameters(&self, values: &[f64]) -> Result<()> {
        let expected = self.parameters.len();
        if values.len() != expected {
            return Err(FmiError::Length { call: "parameter values", expected, found: values.len() });
        }
        match values.iter().position(|value| !value.is_finite()) {
            Some(i) => Err(FmiError::NotFinite { name: self.parameter_names[i].clone(), value: values[i] }),
            None => Ok(()),
        }
    }
}

/// Returns variable indices and values of the named start values, each index once, and the resulting
/// structure. The last value of a variable is used.
pub(super) fn resolve_start_values(
    description: &ModelDescription,
    values: &[(String, Value)],
    initial: &InitialStates<'_>,
) -> Result<(Vec<(usize, Value)>, Structure)> {
    let mut resolved: Vec<(usize, Value)> = Vec::with_capacity(values.len());
    let mut places: HashMap<usize, usize> = HashMap::with_capacity(values.len());
    let mut structure = Structure::default();
    // Sizes come first, because the names of array elements depend on them.
    for (name, value) in values {
        if let Some(index) = description.variable_index(name) {
            let variable = &description.variables[index];
            if variable.causality == Causality::StructuralParameter && variable.dimensions.is_empty() {
                structure.set(index, &assignments::convert(variable, value, None)?);
            }
        }
    }
    structure.check(description).map_err(|(_, problem)| FmiError::BadSetting(problem))?;
    for (name, value) in values {
        let place = VariableElement::of_name(description, &structure, name)?;
        let VariableElement { variable: index, element } = place;
        let variable = &description.variables[index];
        initial.check_settable(description, place, name)?;
        let value =
            match element {
                Some(element) => Starts { description, structure: &structure, given: &resolved }
                    .with_element(index, element, value.clone())?,
                // Complete arrays are checked after all sizes are known.
                None if !variable.dimensions.is_empty() => value.clone(),
                None => assignments::convert(variable, value, None)?,
            };
        match places.entry(index) {
            Entry::Occupied(place) => resolved[*place.get()].1 = value,
            Entry::Vacant(place) => {
                place.insert(resolved.len());
                resolved.push((index, value));
            }
        }
    }
    Ok((resolved, structure))
}
