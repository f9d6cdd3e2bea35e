//! A simulation resolved against its model, once: names have become value references, everything has been checked.

use crate::assign::{self, Assignments, check_settable_at_start, resolve};
use crate::communication::Communication;
use crate::description::{Causality, ModelDescription, Value, Variable, VariableKind};
use crate::error::FmiError;
use crate::fmu::{Fmu, Reuse};
use crate::input::{InputPlan, Inputs};
use crate::options::SimulateOptions;
use crate::outputs::OutputPlan;
use crate::sys::InterfaceKind;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
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
            output_names: Vec::new(),
            n_states: description.n_states(),
            n_indicators: description.n_event_indicators,
            nominals: (0..description.n_states())
                .map(|i| states.get(i).copied().flatten().and_then(|state| state.nominal).unwrap_or(1.0))
                .collect(),
            completed_step_not_needed: interface.capabilities.completed_integrator_step_not_needed,
            kind,
            communication,
            warned_of_nominals: AtomicBool::new(false),
        };
        plan.take_parameters(description, &options.parameters, &start_values)?;
        for (index, value) in &start_values {
            plan.start_values.push(&description.variables[*index], value)?;
        }
        plan.take_outputs(description, options.outputs.as_deref(), &states)?;
        Ok(plan)
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
        // A model that integrates itself does not show its states otherwise than as variables.
        let is_me = self.kind == InterfaceKind::ModelExchange;
        let places: HashMap<u32, usize> = states
            .iter()
            .filter(|_| is_me)
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
