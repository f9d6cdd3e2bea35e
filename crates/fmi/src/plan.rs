//! A simulation resolved against its model, once: names have become value references, everything has been checked.

use crate::assign::{self, Assignments, check_settable_at_start, resolve};
use crate::description::{Causality, ModelDescription, Value, Variable, VariableKind};
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::input::{InputPlan, Inputs};
use crate::options::SimulateOptions;
use crate::pool::nudge;
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
    pub(crate) parameters: Vec<u32>,
    parameter_names: Vec<String>,
    /// What the parameters are where nobody gives a value.
    pub(crate) parameter_starts: Vec<f64>,
    pub(crate) inputs: InputPlan,
    pub(crate) outputs: OutputPlan,
    /// Everything that a run sets, sorted.
    pub(crate) settings: Arc<[Setting]>,
    output_names: Vec<String>,
    pub(crate) n_states: usize,
    pub(crate) n_indicators: usize,
    /// Nominals of the states as the description says them.
    pub(crate) nominals: Vec<f64>,
    pub(crate) completed_step_not_needed: bool,
    warned_of_nominals: AtomicBool,
}

/// A variable that a run sets: whether before the initialization (or in it, and later), a number for its type, its
/// reference.
pub(crate) type Setting = (bool, u8, u32);

/// Where an output comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OutputSource {
    Time,
    /// A state or an alias of one: copied, without a call.
    State(usize),
    Real(usize),
    Integer(usize),
    Boolean(usize),
}

/// The outputs by type, each type for one call.
#[derive(Debug, Default)]
pub(crate) struct OutputPlan {
    pub(crate) sources: Vec<OutputSource>,
    pub(crate) reals: Vec<u32>,
    pub(crate) integers: Vec<u32>,
    pub(crate) booleans: Vec<u32>,
}

impl OutputPlan {
    /// Whether a sample needs a call at all.
    pub(crate) fn needs_fmu(&self) -> bool {
        !(self.reals.is_empty() && self.integers.is_empty() && self.booleans.is_empty())
    }

    fn add(&mut self, variable: &Variable, states: &HashMap<u32, usize>) -> Result<(), FmiError> {
        let reference = variable.value_reference;
        let place = |list: &mut Vec<u32>| {
            list.push(reference);
            list.len() - 1
        };
        self.sources.push(match variable.kind {
            _ if variable.causality == Causality::Independent => OutputSource::Time,
            VariableKind::Real => match states.get(&reference) {
                Some(state) => OutputSource::State(*state),
                None => OutputSource::Real(place(&mut self.reals)),
            },
            VariableKind::Integer | VariableKind::Enumeration => {
                OutputSource::Integer(place(&mut self.integers))
            }
            VariableKind::Boolean => OutputSource::Boolean(place(&mut self.booleans)),
            VariableKind::String => {
                let reason = "it is text, and results are numbers";
                return Err(FmiError::NotAnOutput { name: variable.name.clone(), reason });
            }
        });
        Ok(())
    }
}

impl SimulationPlan {
    /// Resolves and checks a simulation of `fmu`. No code of the FMU is run.
    ///
    /// # Errors
    /// The FMU cannot be simulated by this version; a name is unknown (with the nearest names); a value has the wrong
    /// type or is not finite; a variable cannot be set; times or other options make no sense.
    pub fn new(fmu: &Fmu, options: &SimulateOptions) -> Result<Self, FmiError> {
        let interface = fmu.check_runnable()?;
        let description = fmu.description();
        let grid = options.grid(&description.default_experiment)?;
        let method = options.method_options(&description.default_experiment);
        method.check()?;
        let no_inputs = Inputs::default();
        let inputs = InputPlan::new(description, options.inputs.as_ref().unwrap_or(&no_inputs), grid.same)?;
        let states = states(description);
        let start_values = resolve_values(description, &options.start_values)?;
        let mut plan = Self {
            fmu: fmu.clone(),
            options: method,
            start: grid.start,
            end: grid.end,
            same: grid.same,
            times: grid.times,
            start_values: Assignments::default(),
            parameters: Vec::new(),
            parameter_names: Vec::new(),
            parameter_starts: Vec::new(),
            inputs,
            outputs: OutputPlan::default(),
            settings: Arc::default(),
            output_names: Vec::new(),
            n_states: description.n_states(),
            n_indicators: description.n_event_indicators,
            nominals: (0..description.n_states())
                .map(|i| states.get(i).copied().flatten().and_then(|state| state.nominal).unwrap_or(1.0))
                .collect(),
            completed_step_not_needed: interface.capabilities.completed_integrator_step_not_needed,
            warned_of_nominals: AtomicBool::new(false),
        };
        plan.take_parameters(description, &options.parameters, &start_values)?;
        for (index, value) in &start_values {
            plan.start_values.push(&description.variables[*index], value)?;
        }
        plan.take_outputs(description, options.outputs.as_deref(), &states)?;
        plan.settings = plan.all_settings();
        Ok(plan)
    }

    fn all_settings(&self) -> Arc<[Setting]> {
        let Assignments { reals, integers, booleans, strings } = &self.start_values;
        let inputs = &self.inputs;
        let lists = [
            (true, 0, &reals.0),
            (true, 0, &self.parameters),
            (true, 1, &integers.0),
            (true, 2, &booleans.0),
            (true, 3, &strings.0),
            (false, 0, &inputs.continuous),
            (false, 0, &inputs.held_reals),
            (false, 1, &inputs.held_integers),
            (false, 2, &inputs.held_booleans),
        ];
        let mut settings: Vec<Setting> = lists
            .into_iter()
            .flat_map(|(before, kind, list)| list.iter().map(move |reference| (before, kind, *reference)))
            .collect();
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
            if variable.kind != VariableKind::Real {
                return Err(assign::not_settable(
                    variable,
                    "only variables of type Real can be parameters of a run",
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
                Some(Value::Integer(i)) => f64::from(*i),
                _ => 0.0,
            });
            self.parameters.push(variable.value_reference);
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
        let places: HashMap<u32, usize> = states
            .iter()
            .enumerate()
            .filter_map(|(i, state)| state.map(|v| (v.value_reference, i)))
            .collect();
        let Some(names) = names else {
            let outputs: Vec<&Variable> = description
                .variables
                .iter()
                .filter(|v| v.causality == Causality::Output && v.kind != VariableKind::String)
                .collect();
            let states: Vec<&Variable> = states.iter().copied().flatten().collect();
            for variable in if outputs.is_empty() { states } else { outputs } {
                self.outputs.add(variable, &places)?;
                self.output_names.push(variable.name.clone());
            }
            return Ok(());
        };
        for name in names {
            match resolve(description, name) {
                Ok(index) => self.outputs.add(&description.variables[index], &places)?,
                // Time is always there; models may or may not have a variable for it.
                Err(_) if name == "time" => continue,
                Err(error) => return Err(error),
            }
            self.output_names.push(name.clone());
        }
        Ok(())
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

    /// Names of the outputs, in the order of [`Sample::outputs`](ode::Sample).
    pub fn output_names(&self) -> &[String] {
        &self.output_names
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

/// The state variables in the order of the state vector; `None` where the description does not say which variable a
/// derivative belongs to.
fn states(description: &ModelDescription) -> Vec<Option<&Variable>> {
    let derivatives =
        description.structure.derivatives.iter().map(|unknown| &description.variables[unknown.index]);
    derivatives.map(|derivative| derivative.derivative.map(|state| &description.variables[state])).collect()
}

/// Positions and values, each position once: the last value counts.
fn resolve_values(
    description: &ModelDescription,
    values: &[(String, Value)],
) -> Result<Vec<(usize, Value)>, FmiError> {
    let mut resolved: Vec<(usize, Value)> = Vec::with_capacity(values.len());
    let mut places: HashMap<usize, usize> = HashMap::with_capacity(values.len());
    for (name, value) in values {
        let index = resolve(description, name)?;
        let variable = &description.variables[index];
        check_settable_at_start(variable)?;
        let value = assign::convert(variable, value)?;
        match places.entry(index) {
            Entry::Occupied(place) => resolved[*place.get()].1 = value,
            Entry::Vacant(place) => {
                place.insert(resolved.len());
                resolved.push((index, value));
            }
        }
    }
    Ok(resolved)
}
