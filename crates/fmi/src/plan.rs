//! A simulation resolved against its model, once: names have become value references, everything has been checked.

use crate::assign::{self, Assignments, check_settable_at_start, resolve};
use crate::clocks::ClockPlan;
use crate::communication::Communication;
use crate::description::{Causality, ModelDescription, Structure, Value, Variable, VariableKind};
use crate::error::FmiError;
use crate::fmu::{Fmu, Reuse};
use crate::input::{InputPlan, Inputs};
use crate::instance::Core;
use crate::options::SimulateOptions;
use crate::outputs::{OutputContext, OutputPlan, Recorded, element_of};
use crate::pool::nudge;
use crate::sys::InterfaceKind;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A simulation of one model with everything resolved and checked. It does not change and can be shared by workers;
/// each makes a [`Simulator`](crate::Simulator) of it.
#[derive(Debug)]
pub struct SimulationPlan {
    pub(crate) fmu: Fmu,
    pub(crate) options: ode::Options,
    pub(crate) start: f64,
    pub(crate) end: f64,
    pub(crate) same: f64,
    pub(crate) times: Vec<f64>,
    pub(crate) start_values: Assignments,
    /// Structural parameters, and the sizes that follow from them.
    structural_values: Assignments,
    structure: Structure,
    parameters: Vec<u32>,
    /// Signs of the parameters: -1 for negated aliases.
    signs: Vec<f64>,
    parameter_names: Vec<String>,
    /// What the parameters are where nobody gives a value.
    pub(crate) parameter_starts: Vec<f64>,
    pub(crate) inputs: InputPlan,
    pub(crate) clocks: ClockPlan,
    pub(crate) outputs: OutputPlan,
    /// Everything that a run sets, sorted.
    pub(crate) settings: Arc<[Setting]>,
    output_names: Vec<String>,
    pub(crate) n_states: usize,
    pub(crate) n_indicators: usize,
    /// Nominals of the states as the description says them.
    pub(crate) nominals: Vec<f64>,
    pub(crate) completed_step_not_needed: bool,
    pub(crate) kind: InterfaceKind,
    /// The steps of co-simulation.
    pub(crate) communication: Option<Communication>,
    warned_of_nominals: AtomicBool,
}

/// A variable that a run sets: whether before the initialization (or in it, and later), its type, its reference.
pub(crate) type Setting = (bool, VariableKind, u32);

impl SimulationPlan {
    /// Resolves and checks a simulation of `fmu`. No code of the FMU is run.
    ///
    /// # Errors
    /// The FMU cannot be simulated by this version; a name is unknown (with the nearest names); a value has the wrong
    /// type or is not finite; a variable cannot be set; times or other options make no sense.
    pub fn new(fmu: &Fmu, options: &SimulateOptions) -> Result<Self, FmiError> {
        let kind = fmu.choose(options.kind)?;
        let interface = fmu.check_interface(kind)?;
        let description = fmu.description();
        let grid = options.grid(&description.default_experiment)?;
        let communication = match kind {
            InterfaceKind::ModelExchange => None,
            InterfaceKind::CoSimulation => Some(Communication::new(
                options,
                &description.default_experiment,
                &interface.capabilities,
                &grid,
            )?),
        };
        let method = options.method_options(&description.default_experiment);
        method.check()?;
        let no_inputs = Inputs::default();
        let inputs = InputPlan::new(description, options.inputs.as_ref().unwrap_or(&no_inputs), grid.same)?;
        let has_events = kind == InterfaceKind::ModelExchange || interface.capabilities.uses_event_mode();
        if !has_events && !inputs.clocks.ticks.is_empty() {
            let problem =
                "the inputs trigger clocks, which takes an event mode, and this co-simulation has none";
            return Err(FmiError::BadSetting { problem: problem.to_owned() });
        }
        let (start_values, structure) = resolve_values(description, &options.start_values)?;
        let states = states(description, &structure);
        let mut plan = Self {
            fmu: fmu.clone(),
            options: method,
            start: grid.start,
            end: grid.end,
            same: grid.same,
            times: grid.times,
            start_values: Assignments::default(),
            structural_values: Assignments::default(),
            parameters: Vec::new(),
            signs: Vec::new(),
            parameter_names: Vec::new(),
            parameter_starts: Vec::new(),
            clocks: match has_events {
                true => ClockPlan::new(description, &inputs.clocks, grid.same),
                // Clocks tick in event mode.
                false => ClockPlan::default(),
            },
            inputs,
            outputs: OutputPlan::default(),
            settings: Arc::default(),
            output_names: Vec::new(),
            n_states: structure.states(description),
            n_indicators: structure.indicators(description),
            nominals: (0..structure.states(description))
                .map(|i| states.get(i).copied().flatten().and_then(|state| state.nominal).unwrap_or(1.0))
                .collect(),
            structure,
            completed_step_not_needed: interface.capabilities.completed_integrator_step_not_needed,
            kind,
            communication,
            warned_of_nominals: AtomicBool::new(false),
        };
        plan.take_parameters(description, &options.parameters, &start_values)?;
        for (index, value) in &start_values {
            let variable = &description.variables[*index];
            let list = match variable.causality {
                Causality::StructuralParameter => &mut plan.structural_values,
                _ => &mut plan.start_values,
            };
            let is_array = !variable.dimensions.is_empty();
            list.push(variable, value, is_array.then(|| plan.structure.elements(description, variable)))?;
        }
        plan.take_outputs(description, options.outputs.as_deref(), &states)?;
        plan.settings = plan.all_settings();
        Ok(plan)
    }

    fn all_settings(&self) -> Arc<[Setting]> {
        let mut settings: Vec<Setting> = Vec::new();
        for values in [&self.structural_values, &self.start_values] {
            settings.extend(values.references().map(|(kind, reference)| (true, kind, reference)));
        }
        settings.extend(self.parameters.iter().map(|reference| (true, VariableKind::Real, *reference)));
        settings.extend(self.inputs.references().map(|(kind, reference)| (false, kind, reference)));
        settings.sort_unstable();
        settings.dedup();
        settings.into()
    }

    /// Start values and parameters a little off, within their bounds: for trial runs whose traces must not be found
    /// again in the next run. Integers and the like stay as they are: they may choose another model altogether.
    pub(crate) fn other_values(&self, parameters: &[f64]) -> (Assignments, Vec<f64>) {
        let description = self.fmu.description();
        let mut others = self.start_values.clone();
        if !others.reals.0.is_empty() {
            let variables: HashMap<u32, &Variable> = description
                .variables
                .iter()
                .filter(|v| v.kind == VariableKind::Real && check_settable_at_start(v).is_ok())
                .map(|v| (v.value_reference, v))
                .collect();
            for (reference, value) in others.reals.0.iter().zip(&mut others.reals.1) {
                *value = variables.get(reference).map_or(*value, |variable| nudge(variable, *value));
            }
        }
        let parameters = self.parameter_names.iter().zip(parameters);
        let parameters = parameters
            .map(|(name, &value)| description.variable(name).map_or(value, |variable| nudge(variable, value)))
            .collect();
        (others, parameters)
    }

    fn take_parameters(
        &mut self,
        description: &ModelDescription,
        names: &[String],
        start_values: &[(usize, Value)],
    ) -> Result<(), FmiError> {
        let mut indices = Vec::with_capacity(names.len());
        for name in names {
            let index = resolve(description, name)?;
            let variable = &description.variables[index];
            check_settable_at_start(variable)?;
            if variable.kind != VariableKind::Real || !variable.dimensions.is_empty() {
                return Err(assign::not_settable(
                    variable,
                    "only single variables of type Real can be parameters of a run",
                ));
            }
            if indices.contains(&index) {
                return Err(FmiError::BadSetting { problem: format!("parameter {name} is given twice") });
            }
            if self.inputs.driven.contains(&index) {
                return Err(assign::not_settable(variable, "it is driven by the inputs"));
            }
            indices.push(index);
            let given = start_values.iter().find(|(i, _)| *i == index).map(|(_, value)| value);
            self.parameter_starts.push(match given.or(variable.start.as_ref()) {
                Some(Value::Real(x)) if x.is_finite() => *x,
                Some(Value::Integer(i)) => *i as f64,
                _ => 0.0,
            });
            self.parameters.push(variable.value_reference);
            self.signs.push(if variable.negated { -1.0 } else { 1.0 });
            self.parameter_names.push(name.clone());
        }
        Ok(())
    }

    fn take_outputs(
        &mut self,
        description: &ModelDescription,
        names: Option<&[String]>,
        states: &[Option<&Variable>],
    ) -> Result<(), FmiError> {
        // A model that integrates itself does not show its states otherwise than as variables.
        let is_me = self.kind == InterfaceKind::ModelExchange;
        let mut places: HashMap<u32, usize> = HashMap::new();
        if is_me {
            for (i, state) in states.iter().enumerate() {
                // The first place of an array is that of its first element.
                state.iter().for_each(|v| {
                    places.entry(v.value_reference).or_insert(i);
                });
            }
        }
        let structure = self.structure.clone();
        let context = OutputContext { model: description, structure: &structure, states: &places };
        let Some(names) = names else {
            let outputs: Vec<&Variable> =
                description.variables.iter().filter(|v| v.causality == Causality::Output).collect();
            let mut states: Vec<&Variable> = states.iter().copied().flatten().collect();
            states.dedup_by_key(|state| state.value_reference);
            for variable in if outputs.is_empty() { states } else { outputs } {
                let names = self.outputs.add(&context, variable, &variable.name, None);
                self.output_names.extend(names);
            }
            self.outputs.finish();
            return Ok(());
        };
        for name in names {
            let extents = |array: &str| Some(structure.extents(description, description.variable(array)?));
            let added = match (resolve(description, name), element_of(name, extents)) {
                (Ok(index), _) => self.outputs.add(&context, &description.variables[index], name, None),
                (Err(_), Some((array, element))) => {
                    let index = resolve(description, array)?;
                    self.outputs.add(&context, &description.variables[index], name, Some(element))
                }
                // Time is always there; models may or may not have a variable for it.
                (Err(_), None) if name == "time" => continue,
                (Err(error), None) => return Err(error),
            };
            self.output_names.extend(added);
        }
        self.outputs.finish();
        Ok(())
    }

    /// Gives a fresh instance its structure, start values (those of the plan or others for the same variables) and
    /// parameters; `buffer` is used on the way.
    pub(crate) fn set_up(
        &self,
        core: &mut Core,
        start_values: &Assignments,
        parameters: &[f64],
        buffer: &mut Vec<f64>,
    ) -> Result<(), FmiError> {
        if !self.structure.is_default() {
            core.configure(&self.structural_values, &self.structure)?;
        }
        core.apply(start_values)?;
        buffer.clear();
        buffer.extend(parameters.iter().zip(&self.signs).map(|(value, sign)| value * sign));
        core.set_reals(&self.parameters, buffer)
    }

    /// The model.
    pub fn fmu(&self) -> &Fmu {
        &self.fmu
    }

    /// The times of the rows.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Start time.
    pub fn start_time(&self) -> f64 {
        self.start
    }

    /// Final time.
    pub fn final_time(&self) -> f64 {
        self.end
    }

    /// What is known about reset for this way of running the model.
    pub(crate) fn reuse(&self) -> Option<Reuse> {
        self.fmu.reuse_of(self.kind)
    }

    pub(crate) fn set_reuse(&self, reuse: Reuse) {
        self.fmu.set_reuse(self.kind, reuse);
    }

    /// How the model is run.
    pub fn kind(&self) -> InterfaceKind {
        self.kind
    }

    /// Names of the outputs that are numbers, in the order of [`Sample::outputs`](ode::Sample). Behind them a sample has
    /// numbers that stand for texts and the like; a [`Trajectory`](crate::Trajectory) has their values.
    pub fn output_names(&self) -> &[String] {
        &self.output_names
    }

    /// The variables recorded, in the order in which they were asked for.
    pub fn recorded(&self) -> &[Recorded] {
        &self.outputs.recorded
    }

    /// Refuses outputs that are not single numbers, so that there is one column for each name.
    ///
    /// # Errors
    /// [`FmiError::NotAnOutput`] names the first one.
    pub fn require_single_numbers(&self) -> Result<(), FmiError> {
        let reason = |recorded: &Recorded| match () {
            () if !recorded.kind.is_number() => Some("it is text or binary, and numbers are needed"),
            () if !recorded.extents.is_empty() => {
                Some("it is an array, and single numbers are needed: its elements")
            }
            () => None,
        };
        match self.recorded().iter().find_map(|recorded| Some((recorded, reason(recorded)?))) {
            Some((recorded, reason)) => Err(FmiError::NotAnOutput { name: recorded.name.clone(), reason }),
            None => Ok(()),
        }
    }

    /// Names of the parameters, in the order in which a run takes their values.
    pub fn parameter_names(&self) -> &[String] {
        &self.parameter_names
    }

    /// The values the parameters have where none are given, in the same order.
    pub fn parameter_starts(&self) -> &[f64] {
        &self.parameter_starts
    }

    /// Checks the values of the parameters for one run.
    pub(crate) fn check_parameters(&self, values: &[f64]) -> Result<(), FmiError> {
        let expected = self.parameters.len();
        if values.len() != expected {
            return Err(FmiError::Length { call: "values of the parameters", expected, found: values.len() });
        }
        match values.iter().position(|value| !value.is_finite()) {
            Some(i) => Err(FmiError::NotFinite { name: self.parameter_names[i].clone(), value: values[i] }),
            None => Ok(()),
        }
    }

    /// Nominals that are zero, NaN or infinite become 1, negative ones lose their sign, with one warning.
    pub(crate) fn correct_nominals(&self, nominals: &mut [f64]) {
        for (i, nominal) in nominals.iter_mut().enumerate() {
            let corrected = if nominal.is_finite() && *nominal != 0.0 { nominal.abs() } else { 1.0 };
            if corrected.to_bits() == nominal.to_bits() {
                continue;
            }
            if !self.warned_of_nominals.swap(true, Ordering::Relaxed) {
                log::warn!(
                    "{}: the nominal value of state {i} is {nominal}; {corrected} is used",
                    self.fmu.description().model_name
                );
            }
            *nominal = corrected;
        }
    }
}

/// The state variables in the order of the state vector, those that are arrays once for each element; `None` where the
/// description does not say which variable a derivative belongs to.
fn states<'a>(description: &'a ModelDescription, structure: &Structure) -> Vec<Option<&'a Variable>> {
    let mut states = Vec::new();
    for unknown in &description.structure.derivatives {
        let derivative = &description.variables[unknown.index];
        let state = derivative.derivative.map(|state| &description.variables[state]);
        states.extend(std::iter::repeat_n(state, structure.elements(description, derivative)));
    }
    states
}

/// Positions and values, each position once (the last value counts), and the structure that they make.
fn resolve_values(
    description: &ModelDescription,
    values: &[(String, Value)],
) -> Result<(Vec<(usize, Value)>, Structure), FmiError> {
    let mut resolved: Vec<(usize, Value)> = Vec::with_capacity(values.len());
    let mut places: HashMap<usize, usize> = HashMap::with_capacity(values.len());
    let mut structure = Structure::default();
    for (name, value) in values {
        let index = resolve(description, name)?;
        let variable = &description.variables[index];
        check_settable_at_start(variable)?;
        // Arrays are looked at when all sizes are known.
        let is_array = !variable.dimensions.is_empty();
        let value = if is_array { value.clone() } else { assign::convert(variable, value, None)? };
        if variable.causality == Causality::StructuralParameter {
            structure.set(index, &value);
        }
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
