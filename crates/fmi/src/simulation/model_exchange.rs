//! Model-exchange instance as the hybrid system that the driver integrates, with FMI's order of calls.

use crate::description::{QuirkKind, Variable};
use crate::error::{FmiError, Result};
use crate::instance::Core;
use crate::simulation::inputs::{InputPlan, InputState};
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::{Mode, Running};
use crate::simulation::shared_observer::SharedObserver;
use crate::simulation::variable_elements::RunInput;
use crate::sys::{Direction, Fault, RawInstance};
use ode::{
    CallError, CallResult, ErrorKind, EventCause, EventOutcome, EventVisit, HybridSystem, InputStop,
    JacobianPattern, Report, SimulationError, StepAction, Stopped, Termination,
};
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// System of one worker: the instance and all data written during a run.
#[derive(Debug)]
pub(crate) struct System {
    pub(crate) running: Running,
    /// Continuous inputs last sent to the FMU; empty while they are unknown. FMUs may allow an input to be
    /// set only once per time instant (FMI 2.0.x, section 2.2.7, `canHandleMultipleSetPerTimeInstant`).
    sent: Vec<f64>,
    /// Point last set in the FMU, if known.
    set_time: Option<f64>,
    /// True if `states` were set in the FMU.
    has_states: bool,
    states: Vec<f64>,
    /// Point last committed. After a run, `get` refers to this point.
    last_time: f64,
    last_states: Vec<f64>,
    initial_states: Vec<InitialState>,
    /// True if the derivatives were computed at the point last set.
    is_evaluated: bool,
    /// Buffer for derivatives that are computed only to update other variables.
    unused: Vec<f64>,
    /// Combined results of the steps completed at rows, to be returned at the end of the step.
    row_actions: StepAction,
    /// Time of the last event as seen by the model. It is later than the driver's time by at most a rounding
    /// error. The model never returns to an earlier time.
    floor: f64,
    /// True if there are states but no continuous inputs, so that time and states define the point.
    is_point_of_states: bool,
}

/// Initial state of a run.
#[derive(Debug, Clone, Copy)]
struct InitialState {
    /// Index among the initial states of the plan.
    index: usize,
    /// Index in the state vector.
    position: usize,
    value: f64,
    /// Value in the state vector, with opposite sign for a negated alias.
    state: f64,
}

const NOT_THE_STATE: &str =
    "differs from the continuous state that it represents according to the model description";

/// True if both numbers have the same bits. This distinguishes signed zeros, and NaN equals itself.
fn same_bits(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits()
}

impl System {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let n = plan.n_states;
        Self {
            sent: Vec::with_capacity(plan.inputs.continuous.start().len()),
            set_time: None,
            has_states: false,
            is_evaluated: false,
            unused: vec![0.0; n],
            row_actions: StepAction::default(),
            states: vec![0.0; n],
            last_time: plan.start,
            last_states: vec![0.0; n],
            initial_states: Vec::new(),
            floor: f64::NEG_INFINITY,
            is_point_of_states: false,
            running: Running::new(plan),
        }
    }

    /// Brings a new instance into event mode at the start time. Sets values and inputs, and initializes.
    pub(crate) fn initialize(&mut self, raw: RawInstance, input: RunInput<'_>) -> Result<()> {
        let (start, end) = (self.running.plan.start, self.running.plan.end);
        let mut core = self.running.begin(raw, input, Some(end))?;
        self.take_initial_states(&mut core, input)?;
        self.sent.clone_from(&self.running.inputs.continuous);
        self.is_point_of_states =
            self.running.plan.n_states > 0 && self.running.plan.inputs.continuous.is_empty();
        self.running.current.core = Some(core);
        self.set_time = None;
        self.has_states = false;
        self.row_actions = StepAction::default();
        self.floor = f64::NEG_INFINITY;
        self.last_time = start;
        Ok(())
    }

    /// Collects the initial states of a run. A variable that is not a state must already have its value.
    fn take_initial_states(&mut self, core: &mut Core, input: RunInput<'_>) -> Result<()> {
        let (plan, list) = (&self.running.plan, &mut self.initial_states);
        list.clear();
        if plan.values.initial.required.is_empty() {
            return Ok(());
        }
        let is_described = plan.fmu().description().fmi_version.major > 1;
        let references = if is_described { Vec::new() } else { core.call(RawInstance::state_references)? };
        for (index, required) in plan.values.initial.required.iter().enumerate() {
            let Some(position) = required.position(plan.fmu(), &references) else {
                required.check(core, plan.fmu(), required.value(input.parameters))?;
                continue;
            };
            let value = required.value(input.parameters);
            let is_negated = plan.fmu().description().variables[required.place.variable].negated;
            let state = if is_negated { -value } else { value };
            list.push(InitialState { index, position, value, state });
        }
        Ok(())
    }

    /// Sets the initial states that differ from the model's values, in continuous-time mode. The model is in
    /// event mode before and afterwards. Returns true if any state differed.
    fn set_initial_states(&mut self, x: &mut [f64]) -> CallResult<bool> {
        let mut differs = false;
        for InitialState { position, state, .. } in &self.initial_states {
            if let Some(x) = x.get_mut(*position) {
                differs |= !same_bits(*x, *state);
                *x = *state;
            }
        }
        if !differs {
            return Ok(false);
        }
        self.running.current.enter(Mode::Continuous, RawInstance::enter_continuous_time_mode)?;
        self.call(|raw| raw.set_continuous_states(x))?;
        self.prepare_reading()?;
        let Self { running: Running { plan, current, .. }, initial_states, .. } = self;
        let required = &plan.values.initial.required;
        let checked = current.core().and_then(|core| {
            // The order of the state vector may differ from the description.
            initial_states.iter().try_for_each(|one| required[one.index].check(core, plan.fmu(), one.value))
        });
        checked.map_err(|error| current.fail(error))?;
        self.enter_event_mode()?;
        Ok(true)
    }

    /// Returns the value of a variable at the point last committed.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<crate::Value> {
        self.running.current.trusted()?;
        let (time, states) = (self.last_time, self.last_states.clone());
        match self.set_point(time, &states).and_then(|()| self.prepare_reading()) {
            Err(CallError::Failed(error)) => return Err(unbox(error)),
            // The point was valid when the step was completed, so its value is still the best available one.
            Ok(()) | Err(CallError::Discard) => {}
        }
        self.running.current.core()?.value(variable)
    }

    /// Makes a raw call. See [`Current::call`](crate::simulation::running::Current::call).
    #[inline]
    fn call<T>(&mut self, body: impl FnOnce(&mut RawInstance) -> Result<T, Fault>) -> CallResult<T> {
        self.running.current.call(body)
    }

    /// Updates the variables to the point last set, before they are read. Some FMUs compute them only
    /// together with the derivatives. FMUs from OpenModelica compute variables that do not affect a
    /// derivative only when a step is completed. Completing steps at rows is allowed, because steps may end
    /// at any time and rows are in time order.
    fn prepare_reading(&mut self) -> CallResult<()> {
        if self.running.current.mode != Mode::Continuous || self.unused.is_empty() {
            return Ok(());
        }
        if !self.is_evaluated {
            let Self { running, unused, .. } = self;
            match running.current.call(|raw| raw.get_derivatives(unused)) {
                // A point without valid derivatives may have other valid variables.
                Ok(()) | Err(CallError::Discard) => self.is_evaluated = true,
                Err(error) => return Err(error),
            }
        }
        if self.running.plan.completes_rows {
            self.row_actions = self.complete_step(self.row_actions)?;
        }
        Ok(())
    }

    /// Reports a completed step to the model. Returns its requests combined with earlier ones.
    fn complete_step(&mut self, before: StepAction) -> CallResult<StepAction> {
        let (event, terminate) = self.call(RawInstance::completed_integrator_step)?;
        Ok(StepAction { event: event | before.event, terminate: terminate | before.terminate })
    }

    /// Sets time, continuous inputs and states. Values that are bit-for-bit unchanged are not set again.
    fn set_point(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        let t = t.max(self.floor);
        if !self.set_time.is_some_and(|set| same_bits(set, t)) {
            self.is_evaluated = false;
            self.set_time = None;
            self.call(|raw| raw.set_time(t))?;
            self.set_inputs(t)?;
            self.set_time = Some(t);
        }
        if x.is_empty() {
            return Ok(());
        }
        let same = self.has_states && self.states.iter().zip(x).all(|(a, b)| same_bits(*a, *b));
        if !same {
            self.is_evaluated = false;
            self.has_states = false;
            self.call(|raw| raw.set_continuous_states(x))?;
            self.states.copy_from_slice(x);
            self.has_states = true;
        }
        Ok(())
    }

    /// Makes a raw call at a point. Without continuous inputs, the call itself sets time and states, unless
    /// both are bit-for-bit unchanged.
    #[inline(always)]
    fn at_point(
        &mut self,
        t: f64,
        x: &[f64],
        call: impl FnOnce(&mut RawInstance, Option<(f64, &[f64])>) -> Result<(), Fault>,
    ) -> CallResult<()> {
        let time = if t > self.floor { t } else { self.floor };
        let has_time = self.set_time.is_some_and(|set| same_bits(set, time));
        if !self.is_point_of_states || has_time && self.has_states && has(&self.states, x) {
            self.set_point(t, x)?;
            return self.call(|raw| call(raw, None));
        }
        self.is_evaluated = false;
        (self.set_time, self.has_states) = (None, false);
        self.call(|raw| call(raw, Some((time, x))))?;
        (self.set_time, self.has_states) = (Some(time), true);
        copy(&mut self.states, x);
        Ok(())
    }

    /// Sets the continuous inputs at `t`.
    fn set_inputs(&mut self, t: f64) -> CallResult<()> {
        let Self { running: Running { plan, inputs, current, .. }, sent, .. } = self;
        if plan.inputs.continuous.is_empty() {
            return Ok(());
        }
        if !inputs.continuous_at(&plan.inputs, t) {
            current.discarded = None;
            return Err(CallError::Discard);
        }
        if has(sent, &inputs.continuous) {
            return Ok(());
        }
        sent.clear();
        current.call(|raw| plan.inputs.continuous.send(raw, &inputs.continuous))?;
        sent.extend_from_slice(&inputs.continuous);
        Ok(())
    }

    /// Compares the recorded states with the variables that the description assigns to them. If they differ,
    /// the variables are recorded instead, because the order of the state vector may differ.
    fn compare_states(&mut self, x: &[f64]) -> CallResult<()> {
        if let Some((column, _)) = self.contradicted_state(x)? {
            self.running.buffers.reads_states = true;
            let plan = &self.running.plan;
            let name = &plan.output_names()[column];
            plan.fmu()
                .note_quirk(QuirkKind::Promise, format!("{name} {NOT_THE_STATE}; the variable is recorded"));
        }
        Ok(())
    }

    /// Returns the column and the value of a recorded state that differs from the state vector.
    fn contradicted_state(&mut self, x: &[f64]) -> CallResult<Option<(usize, f64)>> {
        let Running { plan, buffers, current, .. } = &mut self.running;
        if buffers.reads_states || !plan.outputs().has_states() {
            return Ok(None);
        }
        current.call(|raw| buffers.read_states(plan.outputs(), raw))?;
        Ok(buffers.contradiction(plan.outputs(), x))
    }

    /// Returns the report of a finished run after comparing the recorded states. If a state variable is not
    /// finite at the end, the recorded rows are wrong.
    ///
    /// # Errors
    /// Returns [`FmiError::StateNotFinite`] if a recorded state variable is not finite, and the errors of
    /// failed calls.
    pub(crate) fn compared_at_end(&mut self, report: Report) -> Result<Report, Box<SimulationError>> {
        if report.termination == Termination::StoppedByObserver {
            return Ok(report);
        }
        match self.compare_states_at_end() {
            Ok(()) | Err(CallError::Discard) => Ok(report),
            Err(CallError::Failed(error)) => Err(Box::new(SimulationError {
                kind: ErrorKind::Model(error),
                time: report.time,
                step: 0.0,
                worst_state: None,
                last_event: None,
                not_finite: None,
                undetermined: None,
                refusal: None,
                stats: report.stats,
            })),
        }
    }

    fn compare_states_at_end(&mut self) -> CallResult<()> {
        if self.running.buffers.reads_states || !self.running.plan.outputs().has_states() {
            return Ok(());
        }
        let x = self.last_states.clone();
        self.set_point(self.last_time, &x)?;
        let mut found = self.contradicted_state(&x)?;
        if found.is_some() {
            self.prepare_reading()?;
            found = self.contradicted_state(&x)?;
        }
        let Some((column, value)) = found else { return Ok(()) };
        let plan = &self.running.plan;
        let name = &plan.output_names()[column];
        if !value.is_finite() {
            return Err(CallError::failed(FmiError::StateNotFinite { name: name.clone(), value }));
        }
        plan.fmu().note_quirk(
            QuirkKind::Promise,
            format!("at the end of a simulation, {name} {NOT_THE_STATE}; the state is recorded"),
        );
        Ok(())
    }

    fn commit(&mut self, t: f64, x: &[f64]) {
        self.last_time = t;
        copy(&mut self.last_states, x);
    }

    /// Enters continuous-time mode from event mode, unless the model has ended the simulation.
    fn leave_event_mode(&mut self, outcome: &EventOutcome) -> CallResult<()> {
        if outcome.terminate {
            return Ok(());
        }
        self.running.current.enter(Mode::Continuous, RawInstance::enter_continuous_time_mode)
    }

    fn enter_event_mode(&mut self) -> CallResult<()> {
        self.running.current.enter(Mode::Event, RawInstance::enter_event_mode)
    }

    /// Applies the input jumps that are due at `t`, in event mode.
    fn jump(&mut self, t: f64) -> CallResult<()> {
        let Self { running: Running { plan, inputs, current, .. }, sent, .. } = self;
        inputs.pass(&plan.inputs, t);
        if !inputs.continuous_at(&plan.inputs, t) {
            return Err(CallError::Discard);
        }
        let set = current.in_event_mode().and_then(|core| {
            inputs.set_held(core, &plan.inputs)?;
            inputs.set_parameters(core, &plan.inputs)?;
            send(&plan.inputs, inputs, sent, core)
        });
        set.map_err(|error| current.fail(error))
    }

    fn iterate_events(&mut self, t: f64, outside: &SharedObserver<'_>) -> CallResult<EventOutcome> {
        let Running { plan, current, clocks, buffers, .. } = &mut self.running;
        let recorded = &plan.outputs().clocks;
        let settled = current
            .in_event_mode()
            .and_then(|core| clocks.iterate_events(&plan.clocks, core, t, (recorded, buffers), outside));
        settled.map_err(|error| current.fail(error))
    }

    fn read_states(&mut self, x: &mut [f64]) -> CallResult<()> {
        if x.is_empty() {
            return Ok(());
        }
        self.call(|raw| raw.get_continuous_states(x))?;
        all_finite(x)
    }
}

/// Copies a vector of the same length. Up to four numbers are copied without a function call.
#[inline]
fn copy(to: &mut [f64], from: &[f64]) {
    match (to, from) {
        ([a], [x]) => *a = *x,
        ([a, b], [x, y]) => (*a, *b) = (*x, *y),
        ([a, b, c], [x, y, z]) => (*a, *b, *c) = (*x, *y, *z),
        ([a, b, c, d], [w, x, y, z]) => (*a, *b, *c, *d) = (*w, *x, *y, *z),
        (to, from) => to.copy_from_slice(from),
    }
}

/// True if the inputs of the FMU are already bit-for-bit equal to these.
fn has(sent: &[f64], inputs: &[f64]) -> bool {
    sent.len() == inputs.len() && sent.iter().zip(inputs).all(|(a, b)| same_bits(*a, *b))
}

/// Sets the continuous inputs, unless the FMU already has them.
fn send(plan: &InputPlan, inputs: &InputState, sent: &mut Vec<f64>, core: &mut Core) -> Result<()> {
    if has(sent, &inputs.continuous) {
        return Ok(());
    }
    sent.clear();
    plan.continuous.set(core, &inputs.continuous)?;
    sent.extend_from_slice(&inputs.continuous);
    Ok(())
}

#[inline]
fn all_finite(values: &[f64]) -> CallResult<()> {
    // The product of zero and a non-finite number is NaN.
    if values.iter().fold(0.0, |sum, value| sum + 0.0 * value) == 0.0 {
        Ok(())
    } else {
        Err(CallError::Discard)
    }
}

/// Extracts the FMU's error from the driver's boxed error.
pub(crate) fn unbox(error: Box<dyn std::error::Error + Send + Sync>) -> FmiError {
    match error.downcast::<FmiError>().map_err(|error| error.downcast::<Stopped>()) {
        Ok(error) => *error,
        Err(Ok(stopped)) => FmiError::Stopped(*stopped),
        Err(Err(other)) => FmiError::BadSetting(other.to_string()),
    }
}

/// System in a run that may be ended from outside.
pub(crate) struct Integration<'a> {
    pub(crate) system: &'a mut System,
    pub(crate) outside: &'a SharedObserver<'a>,
    /// True if the system has been started and brought to rest.
    pub(crate) is_settled: bool,
}

impl Deref for Integration<'_> {
    type Target = System;

    fn deref(&self) -> &System {
        self.system
    }
}

impl DerefMut for Integration<'_> {
    fn deref_mut(&mut self) -> &mut System {
        self.system
    }
}

impl Integration<'_> {
    /// Returns the positions of the states with given initial values.
    pub(crate) fn given_states(&self) -> impl Iterator<Item = usize> + '_ {
        self.initial_states.iter().map(|one| one.position)
    }

    /// Handles the initial events if only initial values are needed.
    pub(crate) fn initial_events(&mut self) -> Result<()> {
        let mut states = vec![0.0; self.running.plan.n_states];
        let start = self.running.plan.start;
        match self.start(start, &mut states) {
            // States that are not finite can still be read.
            Ok(_) | Err(CallError::Discard) => Ok(()),
            Err(CallError::Failed(error)) => Err(unbox(error)),
        }
    }
}

impl HybridSystem for Integration<'_> {
    fn n_states(&self) -> usize {
        self.running.plan.n_states
    }

    fn n_event_indicators(&self) -> usize {
        self.running.plan.n_indicators
    }

    fn n_outputs(&self) -> usize {
        self.running.plan.outputs().len()
    }

    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        if nominals.is_empty() {
            return Ok(());
        }
        match self.call(|raw| raw.get_nominals(nominals)) {
            Ok(()) => {}
            Err(CallError::Discard) => nominals.copy_from_slice(&self.running.plan.nominals),
            Err(error) => return Err(error),
        }
        self.running.plan.correct_nominals(nominals);
        Ok(())
    }

    fn is_unbounded(&self, state: usize) -> bool {
        self.running.plan.unbounded[state]
    }

    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        if self.is_settled {
            // Events that the model announces for later, and discrete variables, belong to the states at rest.
            copy(x, &self.last_states);
            let visit = EventVisit { time: t0, cause: EventCause::default(), crossings: &[] };
            let outcome = self.handle_event(&visit, x)?;
            return Ok(EventOutcome { states_changed: true, ..outcome });
        }
        let mut outcome = self.system.iterate_events(t0, self.outside)?;
        self.read_states(x)?;
        if !outcome.terminate && self.set_initial_states(x)? {
            let EventOutcome { nominals_changed, .. } = outcome;
            outcome = self.system.iterate_events(t0, self.outside)?;
            outcome.nominals_changed |= nominals_changed;
            self.read_states(x)?;
        }
        self.compare_states(x)?;
        self.leave_event_mode(&outcome)?;
        self.commit(t0, x);
        // The model is at its start time with its states and the inputs set in initialization mode. They can
        // be set again only in continuous-time mode.
        self.set_time = outcome.terminate.then_some(t0);
        self.has_states = outcome.terminate;
        self.states.copy_from_slice(x);
        Ok(EventOutcome { states_changed: true, ..outcome })
    }

    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        self.at_point(t, x, |raw, point| raw.derivatives_at(point, dx))?;
        self.is_evaluated = true;
        all_finite(dx)?;
        Ok(())
    }

    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.running.plan.jacobian.pattern.as_ref()
    }

    fn directional_derivative(
        &mut self,
        t: f64,
        x: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        if self.running.plan.jacobian.directional.is_none() {
            return Ok(false);
        }
        self.set_point(t, x)?;
        let Running { plan, current, .. } = &mut self.running;
        let Some(sides) = &plan.jacobian.directional else { return Ok(false) };
        let along = Direction { unknowns: &sides.derivatives, knowns: &sides.states, seed };
        let is_there = current.call(|raw| {
            match raw.directional_derivative(along, derivative) {
                // The function is declared in the description but missing in the library.
                Err(Fault::Missing(_)) => Ok(false),
                outcome => outcome.map(|()| true),
            }
        })?;
        // Intermediate values of this call may belong to other points.
        self.is_evaluated = false;
        if !is_there {
            return Ok(false);
        }
        all_finite(derivative)?;
        Ok(true)
    }

    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        if z.is_empty() {
            return Ok(());
        }
        self.at_point(t, x, |raw, point| raw.indicators_at(point, z))?;
        Ok(())
    }

    /// A model must not return behind a completed step.
    fn outputs_in_order(&self) -> bool {
        self.running.plan.completes_rows
    }

    /// Reads the outputs. Values that are not finite are passed on, because the recipient decides how to
    /// treat them.
    fn outputs(&mut self, t: f64, x: &[f64], y: &mut [f64]) -> CallResult<()> {
        if self.running.plan.outputs().needs_fmu() || self.running.buffers.reads_states {
            self.set_point(t, x)?;
            self.prepare_reading()?;
            self.running.read_outputs()?;
        }
        let Running { plan, buffers, .. } = &mut self.running;
        buffers.row(plan.outputs(), t, plan.time_tolerance, x, y);
        Ok(())
    }

    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        self.commit(t, x);
        if self.running.plan.completed_step_not_needed {
            return Ok(StepAction::default());
        }
        self.set_point(t, x)?;
        let at_rows = std::mem::take(&mut self.row_actions);
        self.complete_step(at_rows)
    }

    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let t = visit.time.max(self.floor);
        self.set_point(t, x)?;
        self.floor = t;
        self.enter_event_mode()?;
        if visit.cause.input {
            self.jump(t)?;
        }
        let outcome = self.system.iterate_events(t, self.outside)?;
        if outcome.states_changed {
            self.read_states(x)?;
        }
        self.leave_event_mode(&outcome)?;
        self.commit(t, x);
        self.set_time = outcome.terminate.then_some(t);
        self.has_states = outcome.terminate;
        self.states.copy_from_slice(x);
        Ok(outcome)
    }

    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        self.running.plan.inputs.next_stop(t)
    }
}
