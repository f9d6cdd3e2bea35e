//! One model as scripts use it: set values, simulate, look at the values, set others, simulate again.

use crate::assign::{check_settable_at_start, convert};
use crate::description::{Causality, Structure, Value};
use crate::error::FmiError;
use crate::fmu::Fmu;
use crate::options::{Kind, SimulateOptions};
use crate::places::{Place, Starts, element_value};
use crate::plan::SimulationPlan;
use crate::simulation::Simulator;
use crate::trajectory::Trajectory;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// A model with the values set since it was loaded or reset. Every simulation starts from a freshly reset model with all
/// these values, so that a second one gives the same bits.
///
/// Sessions of one [`Fmu`] hand their instances on to each other; making a session costs next to nothing.
#[derive(Debug)]
pub struct Session {
    fmu: Fmu,
    kind: Kind,
    /// Position of the variable and its value, in the order of setting; each position once.
    values: Vec<(usize, Value)>,
    /// Positions set since the last simulation.
    pending: Vec<usize>,
    /// Holds the final values of the last simulation.
    last: Option<Simulator>,
    /// Holds initial values, while nothing has been simulated.
    initial: Option<Simulator>,
}

impl Session {
    /// A session with nothing set.
    pub fn new(fmu: Fmu) -> Self {
        Self::of_kind(fmu, Kind::Auto)
    }

    /// The same, for one way of running the model: that of every simulation whose options leave it open.
    pub fn of_kind(fmu: Fmu, kind: Kind) -> Self {
        Self { fmu, kind, values: Vec::new(), pending: Vec::new(), last: None, initial: None }
    }

    /// The model.
    pub fn fmu(&self) -> &Fmu {
        &self.fmu
    }

    /// Sets a parameter, a start value, or the constant value of an input, for all simulations from now on.
    ///
    /// # Errors
    /// Unknown name (with the nearest names), wrong type, NaN or infinity, or a variable that cannot be set.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) -> Result<(), FmiError> {
        let fmu = self.fmu.clone();
        let description = fmu.description();
        let structure = self.structure();
        let Place { variable: index, element } = Place::of_name(description, &structure, name)?;
        let variable = &description.variables[index];
        check_settable_at_start(variable)?;
        let value = match (element, value.into()) {
            (Some(element), value) => {
                let value = convert(variable, &value, None)?;
                Starts { description, structure: &structure, given: &self.values }
                    .with_element(index, element, value)?
            }
            // How many values an array has is checked in a simulation: structural parameters may change it.
            (None, value) if !variable.dimensions.is_empty() => {
                let found = if let Value::Array(values) = &value { values.len() } else { 1 };
                convert(variable, &value, Some(found))?
            }
            (None, value) => convert(variable, &value, None)?,
        };
        match self.values.iter_mut().find(|(known, _)| *known == index) {
            Some(entry) => entry.1 = value,
            None => self.values.push((index, value)),
        }
        if !self.pending.contains(&index) {
            self.pending.push(index);
        }
        self.initial = None;
        Ok(())
    }

    /// Sets several variables one after the other: all of them, or none if one cannot be set.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn set_all<'a>(&mut self, given: impl IntoIterator<Item = (&'a str, Value)>) -> Result<(), FmiError> {
        let (values, pending) = (self.values.clone(), self.pending.clone());
        let outcome = given.into_iter().try_for_each(|(name, value)| self.set(name, value));
        if outcome.is_err() {
            (self.values, self.pending) = (values, pending);
        }
        outcome
    }

    /// Names and values of what was set, in the order of setting.
    pub fn values(&self) -> impl Iterator<Item = (&str, &Value)> {
        let variables = &self.fmu.description().variables;
        self.values.iter().map(|(index, value)| (variables[*index].name.as_str(), value))
    }

    /// Value of a variable: after a simulation its final value, unless it has been set since; before, the value set or the
    /// start value, or what the initialization makes of them.
    ///
    /// # Errors
    /// Unknown name; the model cannot be initialized.
    pub fn get(&mut self, name: &str) -> Result<Value, FmiError> {
        let Place { variable: index, element } =
            Place::of_name(self.fmu.description(), &self.structure(), name)?;
        let set = |values: &[(usize, Value)]| {
            let value = values.iter().find(|(i, _)| *i == index).map(|(_, v)| v.clone());
            value.map(|value| element_value(value, element))
        };
        if let Some(simulator) = &mut self.last {
            let pending = if self.pending.contains(&index) { set(&self.values) } else { None };
            return pending.map_or_else(|| simulator.value(name), Ok);
        }
        if let Some(value) = set(&self.values) {
            return Ok(value);
        }
        let variable = &self.fmu.description().variables[index];
        let n = self.structure().elements(self.fmu.description(), variable);
        // The start values of an array that has got another size are not those of this model.
        let fits = |start: &&Value| if let Value::Array(values) = start { values.len() == n } else { true };
        if let Some(value) = variable.start.as_ref().filter(fits) {
            return Ok(element_value(value.clone(), element));
        }
        self.initial_value(name)
    }

    /// Number of elements of an array in each direction, with the structural parameters that were set; empty for a
    /// single value.
    ///
    /// # Errors
    /// Unknown name.
    pub fn extents(&self, name: &str) -> Result<Vec<usize>, FmiError> {
        let description = self.fmu.description();
        let structure = self.structure();
        let place = Place::of_name(description, &structure, name)?;
        Ok(match place.element {
            Some(_) => Vec::new(),
            None => structure.extents(description, &description.variables[place.variable]),
        })
    }

    /// Sizes of arrays with the values set.
    fn structure(&self) -> Structure {
        let mut structure = Structure::default();
        for (index, value) in &self.values {
            if self.fmu.description().variables[*index].causality == Causality::StructuralParameter {
                structure.set(*index, value);
            }
        }
        structure
    }

    fn initial_value(&mut self, name: &str) -> Result<Value, FmiError> {
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

    /// Forgets all values set and the last simulation.
    pub fn reset(&mut self) {
        *self = Self::of_kind(self.fmu.clone(), self.kind);
    }

    /// Simulates from a freshly reset model with all values set; `start_values` of the options count on top of them for
    /// this simulation only.
    ///
    /// # Errors
    /// As [`Fmu::simulate`].
    pub fn simulate(&mut self, options: &SimulateOptions) -> Result<Trajectory, FmiError> {
        self.simulate_with(options, &mut || ControlFlow::Continue(()))
    }

    /// As [`simulate`](Self::simulate); `poll` is asked before every step, and `Break` ends the simulation there, with the
    /// rows so far and [`Termination::StoppedByObserver`](ode::Termination::StoppedByObserver).
    ///
    /// # Errors
    /// As [`Fmu::simulate`].
    pub fn simulate_with(
        &mut self,
        options: &SimulateOptions,
        poll: &mut dyn FnMut() -> ControlFlow<()>,
    ) -> Result<Trajectory, FmiError> {
        let plan = Arc::new(SimulationPlan::new(&self.fmu, &self.with_values(options))?);
        // Their instances go back to the FMU and are used again right away.
        self.last = None;
        self.initial = None;
        let mut simulator = Simulator::new(Arc::clone(&plan))?;
        let begun = Instant::now();
        let trajectory = simulator.trajectory_with(plan.parameter_starts(), poll);
        self.fmu.note_run(plan.kind(), begun.elapsed());
        let trajectory = trajectory?;
        self.last = Some(simulator);
        self.pending.clear();
        Ok(trajectory)
    }

    fn with_values(&self, options: &SimulateOptions) -> SimulateOptions {
        let mut options = options.clone();
        if options.kind == Kind::Auto {
            options.kind = self.kind;
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
