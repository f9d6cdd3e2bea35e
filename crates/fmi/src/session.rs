//! A model for scripts: set values, simulate, read the results, and repeat with other values.

use crate::description::{Causality, Structure, Value, VariableKind};
use crate::error::{FmiError, Result};
use crate::fmu::{Fmu, InterfaceChoice};
use crate::instance::assignments::{check_settable_at_start, convert};
use crate::simulation::plan::SimulationPlan;
use crate::simulation::trajectory::Trajectory;
use crate::simulation::variable_elements::{Starts, VariableElement, element_value};
use crate::simulation::{Inputs, SimulateOptions};
use crate::simulators::Simulator;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Maximum number of start values that become parameters of a plan. With more, all remain start values. A
/// change then requires a new plan, but no search for aliases among them is needed.
const MOST_PARAMETERS: usize = 1 << 10;

/// A model with the values set since it was loaded or reset. Every simulation starts from a freshly reset
/// model with all these values, so repeated simulations are bit-for-bit identical.
///
/// Sessions of one [`Fmu`] have separate instances in one loaded library, so creating a session is cheap.
#[derive(Debug)]
pub struct Session {
    fmu: Fmu,
    kind: InterfaceChoice,
    /// Position of each variable and its value, in the order of setting. Each position occurs once.
    values: Vec<(usize, Value)>,
    /// Positions of the variables set since the last simulation.
    pending: Vec<usize>,
    last: Option<Last>,
    /// Simulator with the initial values, until the first simulation.
    initial: Option<Simulator>,
}

/// The last simulation.
#[derive(Debug)]
struct Last {
    /// Simulator with the final values.
    simulator: Simulator,
    requested: SimulateOptions,
    /// Values of the parameters of the plan.
    values: Option<Vec<f64>>,
}

impl Session {
    /// Creates a session with no values set.
    pub fn new(fmu: Fmu) -> Self {
        Self::of_kind(fmu, InterfaceChoice::Auto)
    }

    /// Creates a session for one interface. It applies to every simulation whose options do not specify an
    /// interface.
    pub fn of_kind(fmu: Fmu, kind: InterfaceChoice) -> Self {
        Self { fmu, kind, values: Vec::new(), pending: Vec::new(), last: None, initial: None }
    }

    /// Returns the model.
    pub fn fmu(&self) -> &Fmu {
        &self.fmu
    }

    /// Sets a parameter, a start value, or the constant value of an input, for all following simulations.
    ///
    /// # Errors
    /// Returns an error if the name is unknown (with the nearest names) or the type is wrong. Also returns an
    /// error if the value is NaN or infinite, or if the variable cannot be set.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) -> Result<()> {
        let fmu = self.fmu.clone();
        let description = fmu.description();
        let structure = self.structure();
        let VariableElement { variable: index, element } =
            VariableElement::of_name(description, &structure, name)?;
        let variable = &description.variables[index];
        check_settable_at_start(variable)?;
        let value = match (element, value.into()) {
            (Some(element), value) => {
                let value = convert(variable, &value, None)?;
                Starts { description, structure: &structure, given: &self.values }
                    .with_element(index, element, value)?
            }
            // A simulation checks the number of elements, because structural parameters may change it.
            (None, value) if !variable.dimensions.is_empty() => {
                let found = if let Value::Array(values) = &value { values.len() } else { 1 };
                convert(variable, &value, Some(found))?
            }
            (None, value) => convert(variable, &value, None)?,
        };
        match self.values.iter_mut().find(|(entry, _)| *entry == index) {
            Some(entry) => entry.1 = value,
            None => self.values.push((index, value)),
        }
        if !self.pending.contains(&index) {
            self.pending.push(index);
        }
        self.initial = None;
        Ok(())
    }

    /// Sets several variables in order. If one cannot be set, none is changed.
    ///
    /// # Errors
    /// Returns the errors of [`set`](Self::set).
    pub fn set_all<'a>(&mut self, given: impl IntoIterator<Item = (&'a str, Value)>) -> Result<()> {
        let mut given = given.into_iter();
        if given.size_hint() == (1, Some(1)) {
            return given.try_for_each(|(name, value)| self.set(name, value));
        }
        let (values, pending) = (self.values.clone(), self.pending.clone());
        let outcome = given.try_for_each(|(name, value)| self.set(name, value));
        if outcome.is_err() {
            (self.values, self.pending) = (values, pending);
        }
        outcome
    }

    /// Returns the assigned names and values, in the order of assignment.
    pub fn values(&self) -> impl Iterator<Item = (&str, &Value)> {
        let variables = &self.fmu.description().variables;
        self.values.iter().map(|(index, value)| (variables[*index].name.as_str(), value))
    }

    /// Returns the value of a variable. After a simulation this is the final value, unless the variable has
    /// been set since. Before a simulation this is the assigned value, or the start value. If neither
    /// exists, the model is initialized.
    ///
    /// # Errors
    /// Returns an error if the name is unknown, or if the model cannot be initialized.
    pub fn get(&mut self, name: &str) -> Result<Value> {
        if let Some(value) = self.value_without_run(name, self.last.is_some())? {
            return Ok(value);
        }
        match &mut self.last {
            Some(last) => last.simulator.value(name),
            None => self.initial_value(name),
        }
    }

    /// Returns the value of a variable if it is known without running the model. Before a simulation this is
    /// the assigned value, or the start value. After a simulation (`is_simulated`) this is the value set
    /// since.
    ///
    /// # Errors
    /// Returns an error if the name is unknown.
    pub fn value_without_run(&self, name: &str, is_simulated: bool) -> Result<Option<Value>> {
        let VariableElement { variable: index, element } =
            VariableElement::of_name(self.fmu.description(), &self.structure(), name)?;
        let set = || self.values.iter().find(|(i, _)| *i == index).map(|(_, value)| value.clone());
        let variable = &self.fmu.description().variables[index];
        // The start values of the description do not fit an array whose size was changed.
        let fits = |start: &&Value| match start {
            Value::Array(values) => {
                values.len() == self.structure().elements(self.fmu.description(), variable)
            }
            _ => true,
        };
        let value = match is_simulated {
            true => set().filter(|_| self.pending.contains(&index)),
            false => set().or_else(|| variable.start.as_ref().filter(fits).cloned()),
        };
        Ok(value.map(|value| element_value(value, element)))
    }

    /// True if the session has simulated and has the final values.
    pub fn is_simulated(&self) -> bool {
        self.last.is_some()
    }

    /// Records that a simulation with these values was run elsewhere.
    pub fn note_simulated(&mut self) {
        (self.last, self.initial) = (None, None);
        self.pending.clear();
    }

    /// Returns the values of variables at the end of the simulation with these options. Repeats the
    /// simulation unless it was the last one.
    ///
    /// # Errors
    /// Returns an error if the simulation fails or a name is unknown. Also returns an error if the simulation
    /// has input functions and was not the last one.
    pub fn final_values(
        &mut self,
        options: &SimulateOptions,
        names: &[String],
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Vec<Value>> {
        let (requested, values) = self.with_parameters(self.with_values(options));
        let is_last = |last: &Last| last.values == values && last.requested.is_same(&requested);
        if !self.last.as_ref().is_some_and(is_last) {
            if options.has_input_functions() {
                let gone = "the final values of the simulation are no longer available, because its process \
                            has ended and its input functions are not stored; simulate again";
                return Err(FmiError::BadSetting(gone.to_owned()));
            }
            self.simulate_with(options, poll)?;
        }
        let last = self.last.as_mut().ok_or(FmiError::Cancelled)?;
        names.iter().map(|name| last.simulator.value(name)).collect()
    }

    /// Returns the number of elements of an array in each dimension, with the structural parameters
    /// set. The result is empty for a scalar.
    ///
    /// # Errors
    /// Returns an error if the name is unknown.
    pub fn extents(&self, name: &str) -> Result<Vec<usize>> {
        let description = self.fmu.description();
        let structure = self.structure();
        let place = VariableElement::of_name(description, &structure, name)?;
        Ok(match place.element {
            Some(_) => Vec::new(),
            None => structure.extents(description, &description.variables[place.variable]),
        })
    }

    /// Returns the array sizes that follow from the values set.
    fn structure(&self) -> Structure {
        let mut structure = Structure::default();
        for (index, value) in &self.values {
            if self.fmu.description().variables[*index].causality == Causality::StructuralParameter {
                structure.set(*index, value);
            }
        }
        structure
    }

    fn initial_value(&mut self, name: &str) -> Result<Value> {
        let mut simulator = match self.initial.take() {
            Some(simulator) => simulator,
            None => {
                let start = self.fmu.description().default_experiment.start_time.unwrap_or(0.0);
                let options = self.with_values(&SimulateOptions::new().start_time(start).final_time(start));
                let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&self.fmu, &options)?))?;
                simulator.initialize_only(&[])?;
                simulator
            }
        };
        let value = simulator.value(name);
        self.initial = Some(simulator);
        value
    }

    /// Clears all values set and the last simulation.
    pub fn reset(&mut self) {
        *self = Self::of_kind(self.fmu.clone(), self.kind);
    }

    /// Simulates from a freshly reset model with all values set. `start_values` of the options take
    /// precedence over these values, for this simulation only.
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::simulate`].
    pub fn simulate(&mut self, options: &SimulateOptions) -> Result<Trajectory> {
        self.simulate_with(options, &mut || ControlFlow::Continue(()))
    }

    /// Simulates as [`simulate`](Self::simulate) does, and calls `poll` before every step. `Break` ends the
    /// simulation at that step. The result then contains the rows so far and
    /// [`Termination::StoppedByObserver`](ode::Termination::StoppedByObserver).
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::simulate`].
    pub fn simulate_with(
        &mut self,
        options: &SimulateOptions,
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory> {
        let (requested, values) = self.with_parameters(self.with_values(options));
        self.initial = None;
        let mut simulator = match self.last.take() {
            Some(last) if last.requested.is_same(&requested) => last.simulator,
            last => {
                let plan = match SimulationPlan::new(&self.fmu, &requested) {
                    Ok(plan) => Arc::new(plan),
                    // Invalid options leave the session unchanged.
                    Err(error) => {
                        self.last = last;
                        return Err(error);
                    }
                };
                // The old instance is freed before another one is created.
                drop(last);
                Simulator::new(plan)?.keeping_end()
            }
        };
        let plan = Arc::clone(simulator.plan());
        let given = values.as_deref().unwrap_or(plan.parameter_starts());
        let trajectory = simulator.trajectory_with(given, poll)?;
        self.last = Some(Last { simulator, requested, values });
        self.pending.clear();
        Ok(trajectory)
    }

    /// Converts start values that may change between runs of one plan to parameters. A simulation that
    /// differs from the last one only in these values then reuses the plan. Returns `None` if the parameters
    /// have the values in the plan.
    fn with_parameters(&self, mut options: SimulateOptions) -> (SimulateOptions, Option<Vec<f64>>) {
        if !options.parameters.is_empty() || options.start_values.len() > MOST_PARAMETERS {
            return (options, None);
        }
        let description = self.fmu.description();
        let mut references: Vec<u32> = Vec::new();
        let mut values: Vec<f64> = Vec::new();
        let (mut parameters, mut others) = (Vec::new(), Vec::new());
        // The start value of a driven tunable parameter has no effect, as for an input.
        let driven =
            options.inputs.iter().flat_map(Inputs::names).filter_map(|name| description.variable(name));
        let driven: Vec<u32> =
            driven.filter(|v| v.is_tunable_parameter()).map(|v| v.value_reference).collect();
        for (name, value) in std::mem::take(&mut options.start_values) {
            let single = description.variable(&name).filter(|variable| {
                variable.kind == VariableKind::Real
                    && variable.dimensions.is_empty()
                    && !driven.contains(&variable.value_reference)
                    && !matches!(variable.causality, Causality::Input | Causality::StructuralParameter)
            });
            let number = value.as_number().filter(|number| number.is_finite());
            let (Some(variable), Some(number), false) = (single, number, matches!(value, Value::Boolean(_)))
            else {
                others.push((name, value));
                continue;
            };
            // The last value counts, even if it is set through an alias.
            match references
                .iter()
                .position(|value_without_run| *value_without_run == variable.value_reference)
            {
                Some(k) => (parameters[k], values[k]) = (name, number),
                None => {
                    references.push(variable.value_reference);
                    parameters.push(name);
                    values.push(number);
                }
            }
        }
        (options.parameters, options.start_values) = (parameters, others);
        (options, Some(values))
    }

    /// Returns the options of a simulation with all values set.
    pub fn with_values(&self, options: &SimulateOptions) -> SimulateOptions {
        let mut options = options.clone();
        if options.run.kind == InterfaceChoice::Auto {
            options.run.kind = self.kind;
        }
        let variables = &self.fmu.description().variables;
        let mut values: Vec<(String, Value)> = self
            .values
            .iter()
            .map(|(index, value)| (variables[*index].name.clone(), value.clone()))
            .collect();
        values.append(&mut options.start_values);
        options.start_values = values;
        options
    }
}

impl Fmu {
    /// Simulates once.
    ///
    /// # Errors
    /// Returns an error if the options do not fit the model or if the simulation fails.
    pub fn simulate(&self, options: &SimulateOptions) -> Result<Trajectory> {
        self.simulate_with(options, &mut || ControlFlow::Continue(()))
    }

    /// Simulates as [`simulate`](Self::simulate) does, and calls `poll` before every step. `Break` ends the
    /// simulation at that step.
    ///
    /// # Errors
    /// Returns the errors of [`simulate`](Self::simulate).
    pub fn simulate_with(
        &self,
        options: &SimulateOptions,
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory> {
        let plan = Arc::new(SimulationPlan::new(self, options)?);
        Simulator::new(Arc::clone(&plan))?.trajectory_with(plan.parameter_starts(), poll)
    }
}
