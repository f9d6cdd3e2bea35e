//! A simulation resolved against its model, once: names have become value references, everything has been checked.

use crate::assign::{self, Assignments, check_settable_at_start};
use crate::beginning::StartValues;
use crate::clocks::ClockPlan;
use crate::description::{Causality, ModelDescription, Structure, Value, Variable, VariableKind};
use crate::error::FmiError;
use crate::fmu::{Fmu, Reuse};
use crate::input::{InputPlan, Inputs};
use crate::instance::Core;
use crate::jacobian::JacobianPlan;
use crate::options::SimulateOptions;
use crate::outputs::{OutputContext, OutputPlan, Recorded};
use crate::places::{Place, Slots, Starts};
use crate::points::Communication;
use crate::readback::{ReadBack, ReadBackBuffers};
use crate::selection::{Selection, states};
use crate::sys::InterfaceKind;
use crate::trial::nudge;
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
    pub(crate) start_values: StartValues,
    /// Structural parameters, and the sizes that follow from them.
    structural_values: Assignments,
    structure: Structure,
    parameters: Vec<RunParameter>,
    /// The variables that the parameters are, or are elements of.
    parameter_slots: Slots<f64>,
    /// The same of the parameters that are inputs.
    input_slots: Slots<f64>,
    parameter_names: Vec<String>,
    /// What the parameters are where nobody gives a value.
    pub(crate) parameter_starts: Vec<f64>,
    pub(crate) inputs: InputPlan,
    pub(crate) clocks: ClockPlan,
    outputs: Selection,
    /// Everything that a run sets, sorted.
    pub(crate) settings: Arc<[Setting]>,
    pub(crate) n_states: usize,
    pub(crate) n_indicators: usize,
    /// Nominals of the states as the description says them.
    pub(crate) nominals: Vec<f64>,
    /// Which states the description calls unbounded.
    pub(crate) unbounded: Vec<bool>,
    pub(crate) completed_step_not_needed: bool,
    /// What a reused instance is asked for again.
    pub(crate) read_back: ReadBack,
    pub(crate) kind: InterfaceKind,
    /// How the Jacobian can be had; empty for co-simulation.
    pub(crate) jacobian: JacobianPlan,
    /// The steps of co-simulation.
    pub(crate) communication: Option<Communication>,
    warned_of_nominals: AtomicBool,
}

/// A variable that a run sets: whether before the initialization (or in it, and later), its type, its reference.
pub(crate) type Setting = (bool, VariableKind, u32);

/// A value that each run is given.
#[derive(Debug, Clone, Copy)]
struct RunParameter {
    place: Place,
    /// Where it goes among the values set.
    slot: usize,
    /// -1 for negated aliases.
    sign: f64,
    is_input: bool,
}

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
        let (start_values, structure) = resolve_values(description, &options.start_values)?;
        let known_structure = structure.clone();
        let starts = Starts { description, structure: &known_structure, given: &start_values };
        let no_inputs = Inputs::default();
        let inputs = InputPlan::new(&starts, options.inputs.as_ref().unwrap_or(&no_inputs), grid.same)?;
        let has_events = kind == InterfaceKind::ModelExchange || interface.capabilities.uses_event_mode();
        let clocks = if has_events {
            ClockPlan::new(description, &inputs.clocks, &options.clock_intervals, grid.same)?
        } else {
            ClockPlan::without_event_mode(description, &inputs.clocks, &options.clock_intervals)?
        };
        let states = states(description, &structure);
        let mut plan = Self {
            fmu: fmu.clone(),
            options: method,
            start: grid.start,
            end: grid.end,
            same: grid.same,
            times: grid.times,
            start_values: StartValues::default(),
            structural_values: Assignments::default(),
            parameters: Vec::new(),
            parameter_slots: Slots::default(),
            input_slots: Slots::default(),
            parameter_names: Vec::new(),
            parameter_starts: Vec::new(),
            clocks,
            inputs,
            outputs: Selection::default(),
            settings: Arc::default(),
            n_states: structure.states(description),
            n_indicators: structure.indicators(description),
            nominals: (0..structure.states(description))
                .map(|i| {
                    let state = states.get(i).copied().flatten();
                    state.and_then(|state| description.variables[state].nominal).unwrap_or(1.0)
                })
                .collect(),
            unbounded: (0..structure.states(description))
                .map(|i| {
                    let state = states.get(i).copied().flatten();
                    state.is_some_and(|state| description.variables[state].unbounded)
                })
                .collect(),
            jacobian: match kind {
                InterfaceKind::ModelExchange => {
                    JacobianPlan::new(description, &structure, &interface.capabilities)
                }
                InterfaceKind::CoSimulation => JacobianPlan::default(),
            },
            structure,
            completed_step_not_needed: interface.capabilities.completed_integrator_step_not_needed,
            read_back: ReadBack::default(),
            kind,
            communication,
            warned_of_nominals: AtomicBool::new(false),
        };
        plan.take_parameters(&starts, &options.parameters)?;
        for (index, value) in &start_values {
            let variable = &description.variables[*index];
            let list = match variable.causality {
                Causality::StructuralParameter => &mut plan.structural_values,
                Causality::Input => &mut plan.start_values.inputs,
                _ => &mut plan.start_values.early,
            };
            let is_array = !variable.dimensions.is_empty();
            list.push(variable, value, is_array.then(|| plan.structure.elements(description, variable)))?;
            if !matches!(variable.causality, Causality::StructuralParameter | Causality::Input) {
                plan.read_back.add_start(variable, &plan.start_values.early);
            }
        }
        for (i, name) in plan.parameter_names.iter().enumerate() {
            if let Some(variable) = description.variable(name) {
                plan.read_back.add_parameter(variable, i);
            }
        }
        plan.read_back.finish();
        plan.take_outputs(description, options.outputs.as_deref(), &states)?;
        if !has_events && !plan.outputs.plan.clocks.is_empty() {
            let problem = "clocks are recorded, which tick in event mode, and this co-simulation has none";
            return Err(FmiError::BadSetting { problem: problem.to_owned() });
        }
        plan.settings = plan.all_settings();
        Ok(plan)
    }

    fn all_settings(&self) -> Arc<[Setting]> {
        let mut settings: Vec<Setting> = Vec::new();
        for values in [&self.structural_values, &self.start_values.early, &self.start_values.inputs] {
            settings.extend(values.references().map(|(kind, reference)| (true, kind, reference)));
        }
        for slots in [&self.parameter_slots, &self.input_slots] {
            settings.extend(slots.references.iter().map(|r| (true, VariableKind::Real, *r)));
        }
        settings.extend(self.inputs.references().map(|(kind, reference)| (false, kind, reference)));
        settings.sort_unstable();
        settings.dedup();
        settings.into()
    }

    /// Start values and parameters a little off, within their bounds: for trial runs whose traces must not be found
    /// again in the next run. Integers and the like stay as they are: they may choose another model altogether.
    pub(crate) fn other_values(&self, parameters: &[f64]) -> (StartValues, Vec<f64>) {
        let description = self.fmu.description();
        let mut others = self.start_values.clone();
        self.nudge_all(&mut others.early);
        self.nudge_all(&mut others.inputs);
        let variable = |parameter: &RunParameter| &description.variables[parameter.place.variable];
        let parameters = self.parameters.iter().zip(parameters);
        let parameters = parameters.map(|(parameter, value)| nudge(variable(parameter), *value)).collect();
        (others, parameters)
    }

    fn nudge_all(&self, values: &mut Assignments) {
        if values.reals.0.is_empty() {
            return;
        }
        let description = self.fmu.description();
        let variables: HashMap<u32, &Variable> = description
            .variables
            .iter()
            .filter(|v| v.kind == VariableKind::Real && check_settable_at_start(v).is_ok())
            .map(|v| (v.value_reference, v))
            .collect();
        let mut rest = &mut values.reals.1[..];
        for reference in &values.reals.0 {
            let Some(variable) = variables.get(reference) else { break };
            let (values, others) = rest.split_at_mut(self.structure.elements(description, variable));
            values.iter_mut().for_each(|value| *value = nudge(variable, *value));
            rest = others;
        }
    }

    fn take_parameters(&mut self, starts: &Starts<'_>, names: &[String]) -> Result<(), FmiError> {
        for name in names {
            let place = Place::of_name(starts.description, starts.structure, name)?;
            let variable = &starts.description.variables[place.variable];
            check_settable_at_start(variable)?;
            if variable.kind != VariableKind::Real {
                return Err(assign::not_settable(
                    variable,
                    "only variables of type Real can be parameters of a run",
                ));
            }
            if !variable.dimensions.is_empty() && place.element.is_none() {
                return Err(assign::not_settable(
                    variable,
                    "it is an array; its elements can be parameters of a run, one by one: name[1]",
                ));
            }
            if self.parameters.iter().any(|known| known.place.overlaps(place)) {
                return Err(FmiError::BadSetting { problem: format!("parameter {name} is given twice") });
            }
            if self.inputs.driven.iter().any(|driven| driven.overlaps(place)) {
                return Err(assign::not_settable(variable, "it is driven by the inputs"));
            }
            let is_input = variable.causality == Causality::Input;
            let slots = if is_input { &mut self.input_slots } else { &mut self.parameter_slots };
            let slot = slots.place(variable.value_reference, place.element, || starts.reals(place))?;
            let start = match (place.element, starts.of(place.variable)) {
                (Some(_), _) => slots.start[slot],
                (None, Some(Value::Real(x))) if x.is_finite() => *x,
                (None, Some(Value::Integer(i))) => *i as f64,
                _ => 0.0,
            };
            let sign = if variable.negated { -1.0 } else { 1.0 };
            self.parameters.push(RunParameter { place, slot, sign, is_input });
            self.parameter_starts.push(start);
            self.parameter_names.push(name.clone());
        }
        Ok(())
    }

    fn take_outputs(
        &mut self,
        description: &ModelDescription,
        names: Option<&[String]>,
        states: &[Option<usize>],
    ) -> Result<(), FmiError> {
        // A model that integrates itself does not show its states otherwise than as variables.
        let mut places: HashMap<u32, usize> = HashMap::new();
        if self.kind == InterfaceKind::ModelExchange {
            for (i, state) in states.iter().enumerate() {
                // The first place of an array is that of its first element.
                if let Some(state) = state {
                    places.entry(description.variables[*state].value_reference).or_insert(i);
                }
            }
        }
        let structure = self.structure.clone();
        let context = OutputContext { model: description, structure: &structure, states: &places };
        self.outputs = match names {
            Some(names) => Selection::of_names(&context, names)?,
            None => {
                let states: Vec<usize> = states.iter().copied().flatten().collect();
                Selection::default_of(&context, &states)
            }
        };
        Ok(())
    }

    /// Sizes of arrays.
    pub(crate) fn structure(&self) -> &Structure {
        &self.structure
    }

    /// Gives a fresh instance its structure, start values (those of the plan or others for the same variables) and
    /// parameters; `buffer` is used on the way.
    pub(crate) fn set_up(
        &self,
        core: &mut Core,
        start_values: &StartValues,
        parameters: &[f64],
        buffer: &mut Vec<f64>,
    ) -> Result<(), FmiError> {
        if !self.structure.is_default() {
            core.configure(&self.structural_values, &self.structure)?;
        }
        core.apply(&start_values.early)?;
        self.set_parameters(core, &self.parameter_slots, false, parameters, buffer)
    }

    /// Gives the inputs that do not vary their values, in initialization mode; `buffer` is used on the way.
    pub(crate) fn set_up_inputs(
        &self,
        core: &mut Core,
        start_values: &StartValues,
        parameters: &[f64],
        buffer: &mut Vec<f64>,
    ) -> Result<(), FmiError> {
        core.apply(&start_values.inputs)?;
        self.set_parameters(core, &self.input_slots, true, parameters, buffer)
    }

    /// Sets the parameters of a run that are inputs, or the others.
    fn set_parameters(
        &self,
        core: &mut Core,
        slots: &Slots<f64>,
        inputs: bool,
        values: &[f64],
        buffer: &mut Vec<f64>,
    ) -> Result<(), FmiError> {
        buffer.clear();
        buffer.extend_from_slice(&slots.start);
        for (parameter, value) in self.parameters.iter().zip(values) {
            if parameter.is_input == inputs {
                buffer[parameter.slot] = value * parameter.sign;
            }
        }
        core.set_reals(&slots.references, buffer)
    }

    /// Whether an initialized instance has the values that [`set_up`](Self::set_up) gave it. An error is one of the FMU's.
    pub(crate) fn has_values(
        &self,
        core: &mut Core,
        parameters: &[f64],
        buffers: &mut ReadBackBuffers,
    ) -> Result<bool, FmiError> {
        self.read_back.agrees(
            core,
            &self.start_values.early,
            |i| parameters[i] * self.parameters[i].sign,
            buffers,
        )
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

    /// Relative tolerance of the method.
    pub fn relative_tolerance(&self) -> f64 {
        self.options.relative_tolerance
    }

    /// Number of continuous states.
    pub fn n_states(&self) -> usize {
        self.n_states
    }

    /// How instances are brought back to their beginning for this way of running the model, as far as is known.
    pub(crate) fn reuse(&self) -> Option<Reuse> {
        self.fmu.reuse_for(self.kind, &self.settings)
    }

    /// Stores what trial runs have shown; without a step they show nothing good.
    pub(crate) fn set_reuse(&self, reuse: Reuse) {
        if self.end <= self.start && reuse != Reuse::Reinstantiate {
            return;
        }
        self.fmu.set_reuse(self.kind, reuse, &self.settings);
    }

    /// Whether instances may be brought back by a saved state, as far as is known.
    pub(crate) fn may_restore(&self) -> bool {
        self.fmu.may_restore(self.kind)
    }

    /// Saved states were found not to bring instances back.
    pub(crate) fn refuse_restore(&self) {
        self.fmu.refuse_restore(self.kind);
    }

    /// How the model is run.
    pub fn kind(&self) -> InterfaceKind {
        self.kind
    }

    /// Names of the outputs that are numbers, in the order of [`Sample::outputs`](ode::Sample). Behind them a sample has
    /// numbers that stand for texts and the like; a [`Trajectory`](crate::Trajectory) has their values.
    pub fn output_names(&self) -> &[String] {
        &self.outputs.names
    }

    /// Positions in the description of the variables of the outputs that are numbers; all elements of an array have the
    /// same.
    pub fn output_variables(&self) -> &[usize] {
        &self.outputs.variables
    }

    /// Where the outputs come from.
    pub(crate) fn outputs(&self) -> &OutputPlan {
        &self.outputs.plan
    }

    /// The variables recorded, in the order in which they were asked for.
    pub fn recorded(&self) -> &[Recorded] {
        &self.outputs.plan.recorded
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

/// Positions and values, each position once (the last value counts), and the structure that they make.
fn resolve_values(
    description: &ModelDescription,
    values: &[(String, Value)],
) -> Result<(Vec<(usize, Value)>, Structure), FmiError> {
    let mut resolved: Vec<(usize, Value)> = Vec::with_capacity(values.len());
    let mut places: HashMap<usize, usize> = HashMap::with_capacity(values.len());
    let mut structure = Structure::default();
    // Sizes first: they tell the elements of arrays apart.
    for (name, value) in values {
        if let Some(index) = description.variable_index(name) {
            let variable = &description.variables[index];
            if variable.causality == Causality::StructuralParameter && variable.dimensions.is_empty() {
                structure.set(index, &assign::convert(variable, value, None)?);
            }
        }
    }
    for (name, value) in values {
        let Place { variable: index, element } = Place::of_name(description, &structure, name)?;
        let variable = &description.variables[index];
        check_settable_at_start(variable)?;
        let value =
            match element {
                Some(element) => Starts { description, structure: &structure, given: &resolved }
                    .with_element(index, element, value.clone())?,
                // Whole arrays are looked at when all is known.
                None if !variable.dimensions.is_empty() => value.clone(),
                None => assign::convert(variable, value, None)?,
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
