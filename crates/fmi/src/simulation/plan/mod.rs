//! Simulation resolved and checked for its model. Names have been replaced by value references.

mod communication;
mod initial_values;
mod jacobian;
mod read_back;
mod run_values;

pub(crate) use communication::Communication;
use communication::MANY_STEPS;
use initial_values::StatePositions;
pub(crate) use read_back::ReadBackBuffers;
use run_values::InitialStates;
pub(crate) use run_values::RunValues;

use crate::cancel_request::CancelRequest;
use crate::description::{ModelDescription, QuirkKind, Structure};
use crate::error::{FmiError, Result};
use crate::fmu::Fmu;
use crate::libraries::Setting;
use crate::macros::getters;
use crate::simulation::clocks::ClockPlan;
use crate::simulation::inputs::{InputPlan, Inputs};
use crate::simulation::options::SimulateOptions;
use crate::simulation::outputs::{OutputContext, OutputPlan, Recorded, Selection, states};
use crate::simulation::variable_elements::Starts;
use crate::sys::InterfaceKind;
use base::Number;
use jacobian::JacobianPlan;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Simulation of one model with all settings resolved and checked. A plan is immutable, so workers can share
/// it. Each worker creates a [`Simulator`](crate::Simulator) from it.
#[derive(Debug)]
pub struct SimulationPlan {
    pub(crate) fmu: Fmu,
    pub(crate) options: ode::Options,
    /// Tolerance passed to the model: the requested tolerance, otherwise the tolerance of its default
    /// experiment.
    pub(crate) tolerance: Option<f64>,
    pub(crate) start: f64,
    pub(crate) end: f64,
    pub(crate) time_tolerance: f64,
    pub(crate) times: Vec<f64>,
    pub(crate) values: RunValues,
    pub(crate) inputs: InputPlan,
    pub(crate) clocks: ClockPlan,
    /// Longest approach to steady state before the simulation.
    pub(crate) steady: Option<f64>,
    outputs: Selection,
    /// All variables that a run sets, sorted.
    pub(crate) settings: Arc<[Setting]>,
    pub(crate) n_states: usize,
    pub(crate) n_indicators: usize,
    /// Nominal values of the states from the description.
    pub(crate) nominals: Vec<f64>,
    /// For each state, true if the description declares it unbounded.
    pub(crate) unbounded: Vec<bool>,
    pub(crate) completed_step_not_needed: bool,
    /// True if a step is completed before each row is read.
    pub(crate) completes_rows: bool,
    pub(crate) kind: InterfaceKind,
    /// Data for the Jacobian; empty for co-simulation.
    pub(crate) jacobian: JacobianPlan,
    /// Communication points of a co-simulation.
    pub(crate) communication: Option<Communication>,
    /// Shared by all plans that differ only in rows and inputs.
    family: Arc<()>,
    warned_of_nominals: AtomicBool,
}

/// Returns the length of a simulation, or 1 if it has none.
pub(crate) fn span_of(start: f64, end: f64) -> f64 {
    if end > start { end - start } else { 1.0 }
}

impl SimulationPlan {
    /// Resolves and checks a simulation of `fmu` without running code of the FMU.
    ///
    /// # Errors
    /// Returns an error in these cases:
    /// - This version cannot simulate the FMU.
    /// - A name is unknown. The error lists the nearest names.
    /// - A value has the wrong type or is not finite.
    /// - A variable cannot be set.
    /// - Times or other options are invalid.
    pub fn new(fmu: &Fmu, options: &SimulateOptions) -> Result<Self> {
        let kind = fmu.choose(options.run.kind)?;
        let interface = fmu.check_interface(kind)?;
        if options.steady.is_some() && kind == InterfaceKind::CoSimulation {
            return Err(FmiError::BadSetting(
                "a start from steady state requires model exchange, because a co-simulation does not provide its \
                 derivatives. Use kind = \"ME\", or a warm-up"
                    .to_owned(),
            ));
        }
        let description = fmu.description();
        // A missing binary is reported before a missing final time.
        let grid = options.grid(&description.default_experiment).map_err(|error| {
            let is_missing = fmu.needed_program().is_none();
            match is_missing.then(|| fmu.binary(interface, &CancelRequest::default())) {
                Some(Err(no_binary @ FmiError::NoBinary { .. })) => no_binary,
                _ => error,
            }
        })?;
        let communication = match kind {
            InterfaceKind::ModelExchange => None,
            InterfaceKind::CoSimulation => Some(Communication::new(
                options,
                &description.default_experiment,
                &interface.capabilities,
                &grid,
            )?),
        };
        if let Some(communication) = &communication
            && let Some(message) = communication.check_rows(&grid, options.between_steps)?
        {
            fmu.say_once(log::Level::Warn, "rows between steps", &message);
        }
        let steady = options.steady.map(|steady| steady.limit.unwrap_or(1e3 * span_of(grid.start, grid.end)));
        if let Some(limit) = steady.filter(|limit| !(limit.is_finite() && *limit > 0.0)) {
            let limit = Number(limit);
            return Err(FmiError::BadSetting(format!("steady_limit = {limit} must be positive and finite")));
        }
        let method = options.method_options(&description.default_experiment);
        method.check()?;
        let states_by_default = states(description, &Structure::default());
        let initial = InitialStates {
            names: &options.initial_states,
            positions: StatePositions::new(description, &states_by_default),
            are_set: kind == InterfaceKind::ModelExchange,
        };
        let (given, structure) =
            run_values::resolve_start_values(description, &options.start_values, &initial)?;
        let starts = Starts { description, structure: &structure, given: &given };
        let no_inputs = Inputs::default();
        let inputs = InputPlan::new(
            &starts,
            options.inputs.as_ref().unwrap_or(&no_inputs),
            grid.time_tolerance,
            communication.as_ref().is_some_and(|communication| communication.variable),
        )?;
        if let Some(communication) = &communication {
            let are_held = !communication.input_derivatives;
            let points = inputs.n_points_within(grid.start, grid.end, are_held);
            if let Some(message) = communication.check_inputs(&grid, options.run.step_size, points) {
                fmu.say_once(log::Level::Warn, "rows of inputs", &message);
            }
        }
        let has_events = kind == InterfaceKind::ModelExchange || interface.capabilities.uses_event_mode();
        let clocks = if has_events {
            ClockPlan::new(description, &inputs.clocks, &options.clock_intervals, grid.time_tolerance)?
        } else {
            ClockPlan::without_event_mode(description, &inputs.clocks, &options.clock_intervals)?
        };
        let states = states(description, &structure);
        let positions = StatePositions::new(description, &states);
        let initial = InitialStates { positions, ..initial };
        let values = RunValues::new(&starts, &options.parameters, &initial, &inputs.driven)?;
        let n_states = structure.states(description);
        let described = || {
            let variable = |i: usize| states.get(i).copied().flatten();
            (0..n_states).map(move |i| variable(i).map(|state| &description.variables[state]))
        };
        let completed_step_not_needed = interface.capabilities.completed_integrator_step_not_needed;
        let tool = description.generation_tool.as_deref();
        let is_openmodelica = tool.is_some_and(|tool| tool.contains("OpenModelica"));
        let mut plan = Self {
            fmu: fmu.clone(),
            options: method,
            tolerance: options.stated_tolerance(&description.default_experiment),
            start: grid.start,
            end: grid.end,
            time_tolerance: grid.time_tolerance,
            times: grid.times,
            settings: values.settings(&inputs),
            values,
            clocks,
            steady,
            inputs,
            outputs: Selection::default(),
            n_states,
            n_indicators: structure.indicators(description),
            nominals: described().map(|state| state.and_then(|state| state.nominal).unwrap_or(1.0)).collect(),
            unbounded: described().map(|state| state.is_some_and(|state| state.unbounded)).collect(),
            jacobian: match kind {
                InterfaceKind::ModelExchange => {
                    JacobianPlan::new(description, &structure, &interface.capabilities)
                }
                InterfaceKind::CoSimulation => JacobianPlan::default(),
            },
            completed_step_not_needed,
            completes_rows: !completed_step_not_needed && is_openmodelica,
            kind,
            communication,
            family: Arc::new(()),
            warned_of_nominals: AtomicBool::new(false),
        };
        plan.take_outputs(description, options.outputs.as_deref(), &states)?;
        if let Some(message) = plan.many_steps() {
            let message = &format!("{message}. Use a larger step_size or fewer rows");
            fmu.say_once(log::Level::Warn, "steps", message);
        }
        if !has_events && !plan.outputs.plan.clocks.is_empty() {
            let problem = "the recorded clocks tick in event mode, which this co-simulation does not support";
            return Err(FmiError::BadSetting(problem.to_owned()));
        }
        Ok(plan)
    }

    /// Returns a plan with other rows, and with other inputs of the same names. The integration settings and
    /// communication points stay unchanged. A simulator of this plan can continue with the new one.
    ///
    /// # Errors
    /// Returns the errors of [`new`](Self::new).
    pub fn with_rows(&self, options: &SimulateOptions) -> Result<Self> {
        Ok(Self {
            options: self.options.clone(),
            communication: self.communication.clone(),
            family: Arc::clone(&self.family),
            warned_of_nominals: AtomicBool::new(self.warned_of_nominals.load(Ordering::Relaxed)),
            ..Self::new(&self.fmu, options)?
        })
    }

    /// True if a simulator of this plan can continue with the other one. Both plans must set the same
    /// variables in the same way and record the same outputs.
    pub(crate) fn fits(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.family, &other.family)
            && self.settings == other.settings
            && self.parameter_names() == other.parameter_names()
            && self.output_names() == other.output_names()
            && self.inputs.driven.len() == other.inputs.driven.len()
    }

    fn take_outputs(
        &mut self,
        description: &ModelDescription,
        names: Option<&[String]>,
        states: &[Option<usize>],
    ) -> Result<()> {
        // A co-simulation exposes its states only as variables.
        let mut places: HashMap<u32, usize> = HashMap::new();
        if self.kind == InterfaceKind::ModelExchange {
            for (i, state) in states.iter().enumerate() {
                // The index of an array is the index of its first element.
                if let Some(state) = state {
                    places.entry(description.variables[*state].value_reference).or_insert(i);
                }
            }
        }
        let context =
            OutputContext { model: description, structure: &self.values.structure, states: &places };
        self.outputs = match names {
            Some(names) => Selection::of_names(&context, names)?,
            None => {
                let states: Vec<usize> = states.iter().copied().flatten().collect();
                Selection::default_of(&context, &states)
            }
        };
        Ok(())
    }

    /// Returns the name of the state to which a non-finite state or derivative belongs.
    pub(crate) fn name_of(&self, value: &ode::NotFinite) -> Option<String> {
        let description = self.fmu.description();
        match value.what {
            ode::Evaluated::State | ode::Evaluated::Derivative => {
                let state = states(description, self.structure()).get(value.index).copied()??;
                Some(description.variables[state].name.clone())
            }
            _ => None,
        }
    }

    getters! {
        /// Sizes of arrays.
        pub(crate) structure(self) -> &Structure = &self.values.structure;
        /// Model that is simulated.
        pub fmu(self) -> &Fmu = &self.fmu;
        /// Times of the rows.
        pub times(self) -> &[f64] = &self.times;
        /// Start time.
        pub start_time(self) -> f64 = self.start;
        /// Final time.
        pub final_time(self) -> f64 = self.end;
        /// Relative tolerance of the method.
        pub relative_tolerance(self) -> f64 = self.options.relative_tolerance;
        /// Number of continuous states.
        pub n_states(self) -> usize = self.n_states;
        /// Interface that runs the model.
        pub kind(self) -> InterfaceKind = self.kind;
        /// Names of the numeric outputs, in the order of [`Sample::outputs`](ode::Sample). In a sample they
        /// are followed by numbers that represent strings and other values. A
        /// [`Trajectory`](crate::Trajectory) contains these values.
        pub output_names(self) -> &[String] = &self.outputs.names;
        /// Indices in the description of the variables of the numeric outputs. All elements of an array have
        /// the same index.
        pub output_variables(self) -> &[usize] = &self.outputs.variables;
        /// Sources of the outputs.
        pub(crate) outputs(self) -> &OutputPlan = &self.outputs.plan;
        /// Recorded variables in the requested order.
        pub recorded(self) -> &[Recorded] = &self.outputs.plan.recorded;
    }

    /// Returns the communication step size of a co-simulation, or the mean row spacing if only the rows
    /// determine points. Returns `None` for model exchange.
    pub fn communication_step(&self) -> Option<f64> {
        let rows = self.times.len().saturating_sub(1).max(1) as f64;
        self.communication.as_ref().map(|c| c.step.unwrap_or((self.end - self.start) / rows))
    }

    /// Returns the spacing of the regular communication points of a co-simulation. Returns `None` if only
    /// rows and inputs determine points, or for model exchange.
    pub fn regular_communication_step(&self) -> Option<f64> {
        self.communication.as_ref()?.step
    }

    /// Returns a warning if a run makes more than 1e6 steps of one length, or a co-simulation has more than
    /// 1e6 rows.
    pub fn many_steps(&self) -> Option<String> {
        let fixed = || self.options.step_size.filter(|_| self.options.method.is_fixed_step());
        let step = self.communication_step().or_else(fixed)?;
        let rows = if self.communication.is_some() { self.times.len() as f64 } else { 0.0 };
        let steps = ((self.end - self.start) / step).max(rows);
        (steps > MANY_STEPS).then(|| {
            format!(
                "the simulation from {} to {} requires {} steps of at most {}, which may take a long time",
                Number(self.start),
                Number(self.end),
                Number(steps.round()),
                Number(step)
            )
        })
    }

    /// Returns an error for outputs that are not single numbers. Without them, each name has exactly one
    /// column.
    ///
    /// # Errors
    /// Returns [`FmiError::NotAnOutput`] with the name of the first such output.
    pub fn require_single_numbers(&self) -> Result<()> {
        let reason = |recorded: &Recorded| match () {
            () if !recorded.kind.is_number() => Some("it is a string or binary variable; expected a number"),
            () if !recorded.extents.is_empty() => {
                Some("it is an array; expected a scalar, such as one of its elements")
            }
            () => None,
        };
        match self.recorded().iter().find_map(|recorded| Some((recorded, reason(recorded)?))) {
            Some((recorded, reason)) => Err(FmiError::NotAnOutput { name: recorded.name.clone(), reason }),
            None => Ok(()),
        }
    }

    getters! {
        /// Names of the parameters, in the order in which a run expects their values.
        pub parameter_names(self) -> &[String] = &self.values.parameter_names;
        /// Default values of the parameters, in the same order.
        pub parameter_starts(self) -> &[f64] = &self.values.parameter_starts;
    }

    /// Replaces nominal values that are zero, NaN or infinite by 1, and negative ones by their absolute
    /// value. The first replacement is listed in the quirks of the FMU.
    pub(crate) fn correct_nominals(&self, nominals: &mut [f64]) {
        for (i, nominal) in nominals.iter_mut().enumerate() {
            let corrected = if nominal.is_finite() && *nominal != 0.0 { nominal.abs() } else { 1.0 };
            if corrected.to_bits() == nominal.to_bits() {
                continue;
            }
            if !self.warned_of_nominals.swap(true, Ordering::Relaxed) {
                let description = self.fmu.description();
                let state = states(description, self.structure()).get(i).copied().flatten();
                let name =
                    state.map_or_else(|| format!("state {i}"), |k| description.variables[k].name.clone());
                let message =
                    format!("the nominal value of {name} is {nominal}; {corrected} is used instead");
                self.fmu.note_quirk(QuirkKind::Range, message);
            }
            *nominal = corrected;
        }
    }
}
