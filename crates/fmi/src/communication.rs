//! Co-simulation: the loop over communication points, which delivers the same samples as the integration of a model.
//!
//! Regular points are `start + k * step`, never sums, and the step is passed as the same constant each time: a
//! difference of times, wrong in its last digit, makes some FMUs slow and changes the results of others. Where the FMU
//! takes steps of any length, requested times and the instants of inputs are communication points too; where it does
//! not, samples between two points are interpolated, and the last step may reach beyond the final time.

use crate::assign::Assignments;
use crate::co_simulation::StepOutcome;
use crate::description::{Capabilities, DefaultExperiment, Variable};
use crate::digest::Digest;
use crate::error::FmiError;
use crate::input::InputState;
use crate::instance::{CoSimulation, Core, Instance, Instantiated, StepMode};
use crate::options::{Grid, SimulateOptions};
use crate::outputs::OutputBuffers;
use crate::plan::SimulationPlan;
use crate::sys::RawInstance;
use ode::{
    ErrorKind, EventCause, EventOutcome, EventRecord, Limits, Observer, Report, Sample, Side,
    SimulationError, Stats, Termination,
};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// More steps than this are taken for a mistake.
const MAX_STEPS: f64 = 1e9;

/// Steps of which nothing was computed, in a row, before a run gives up.
const MAX_DISCARDS: u32 = 12;

/// Events at one instant before a run gives up.
const MAX_EVENTS_HERE: u32 = 100;

/// The communication points of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Communication {
    /// Distance of the regular points; `None`: only requested times and inputs make points.
    step: Option<f64>,
    /// Whether there may be other points.
    variable: bool,
    /// The stop time may be told: no step leads beyond it.
    pub(crate) ends_exactly: bool,
    /// The FMU extrapolates inputs from their derivatives.
    input_derivatives: bool,
    /// Events are handled between steps.
    event_mode: bool,
}

impl Communication {
    pub(crate) fn new(
        options: &SimulateOptions,
        experiment: &DefaultExperiment,
        capabilities: &Capabilities,
        grid: &Grid,
    ) -> Result<Self, FmiError> {
        let span = grid.end - grid.start;
        let makes_sense = |step: &f64| step.is_finite() && *step > grid.same && span / *step <= MAX_STEPS;
        if let Some(step) = options.step_size.filter(|step| !makes_sense(step)) {
            let problem = format!(
                "step_size = {step} from {} to {}: it must be positive, finite, and not make more than {MAX_STEPS:e} steps",
                grid.start, grid.end
            );
            return Err(FmiError::BadSetting { problem });
        }
        let variable = capabilities.can_handle_variable_communication_step_size;
        let suggested = experiment.step_size.filter(makes_sense);
        let step = options.step_size.or(suggested).or(grid.interval.filter(makes_sense));
        // 500 steps where nobody says anything, as many as there are rows by default.
        let step = if variable { step } else { step.or(Some(span / 500.0).filter(makes_sense)) };
        // Where nobody asks for a step, one that the model can make.
        let step = match (capabilities.fixed_internal_step_size, options.step_size) {
            (Some(internal), None) => step.map(|step| (step / internal).round().max(1.0) * internal),
            _ => step,
        };
        if let (Some(internal), Some(step)) = (capabilities.fixed_internal_step_size, step) {
            let multiple = (step / internal).round();
            if multiple < 1.0 || (step - multiple * internal).abs() > 1e-9 * step {
                let (lower, upper) =
                    ((step / internal).floor() * internal, (step / internal).ceil() * internal);
                let next = if lower > 0.0 { format!("{lower} and {upper}") } else { upper.to_string() };
                let problem = format!(
                    "a communication step of {step} is no multiple of the model's own step {internal}; next to it: {next}"
                );
                return Err(FmiError::BadSetting { problem });
            }
        }
        Ok(Self {
            step,
            variable,
            ends_exactly: variable,
            input_derivatives: capabilities.can_interpolate_inputs,
            event_mode: capabilities.uses_event_mode(),
        })
    }
}

/// What a run has of its FMU at the moment.
#[derive(Debug)]
enum Mode {
    /// Nothing: none was made yet, or it broke.
    Gone,
    /// An instance with a past, to be reset before its next use.
    Spare(RawInstance),
    Stepping(Instance<StepMode, CoSimulation>),
}

/// One worker's co-simulation: the instance and everything that is written during a run.
#[derive(Debug)]
pub(crate) struct Stepping {
    plan: Arc<SimulationPlan>,
    mode: Mode,
    /// An FMU call failed: the instance is not used again.
    broken: bool,
    inputs: InputState,
    buffers: OutputBuffers,
    /// Rows of outputs at the beginning and the end of a step, and one in between.
    before: Vec<f64>,
    after: Vec<f64>,
    between: Vec<f64>,
    slopes: Vec<f64>,
    /// Values of parameters on their way.
    signed: Vec<f64>,
    /// What the initial events told.
    initial: EventOutcome,
    /// Running digest of all samples; only while reset is checked.
    digest: Option<Digest>,
}

impl Stepping {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let row = || vec![0.0; plan.outputs().len()];
        Self {
            mode: Mode::Gone,
            broken: false,
            inputs: InputState::new(&plan.inputs),
            buffers: OutputBuffers::new(plan.outputs()),
            before: row(),
            after: row(),
            between: row(),
            slopes: vec![0.0; plan.inputs.continuous.start.len()],
            signed: Vec::new(),
            initial: EventOutcome::default(),
            digest: None,
            plan,
        }
    }

    /// Starts collecting a digest of what the FMU answers.
    pub(crate) fn begin_digest(&mut self) {
        self.digest = Some(Digest::default());
    }

    /// Ends collecting.
    pub(crate) fn end_digest(&mut self) -> Option<u64> {
        self.digest.take().map(Digest::value)
    }

    /// Takes an instance that will have to be reset.
    pub(crate) fn adopt(&mut self, raw: RawInstance) {
        self.broken = false;
        self.mode = Mode::Spare(raw);
    }

    /// Ends the run of the instance, if there is one that is still good for another run, and gives it up.
    pub(crate) fn retire(&mut self) -> Option<RawInstance> {
        let instance = match std::mem::replace(&mut self.mode, Mode::Gone) {
            Mode::Gone => return None,
            Mode::Spare(raw) => return Some(raw),
            Mode::Stepping(instance) => instance,
        };
        instance.pass_log_on();
        if self.broken {
            return None;
        }
        instance.terminate().ok().map(|instance| instance.into_raw().0)
    }

    /// Brings a fresh instance to its first communication point: values, inputs, initialization.
    pub(crate) fn initialize(&mut self, raw: RawInstance, parameters: &[f64]) -> Result<(), FmiError> {
        let plan = Arc::clone(&self.plan);
        self.initialize_with(raw, &plan.start_values, parameters)
    }

    /// The same with other start values for the variables that have some in the plan.
    pub(crate) fn initialize_with(
        &mut self,
        raw: RawInstance,
        start_values: &Assignments,
        parameters: &[f64],
    ) -> Result<(), FmiError> {
        let plan = Arc::clone(&self.plan);
        self.mode = Mode::Gone;
        self.broken = false;
        let mut instance: Instance<Instantiated, CoSimulation> = Instance::from_raw(raw, plan.fmu().clone());
        plan.set_up(instance.core(), start_values, parameters, &mut self.signed)?;
        let ends_exactly = plan.communication.as_ref().is_some_and(|c| c.ends_exactly);
        let mut instance = instance.enter_initialization(
            plan.start,
            ends_exactly.then_some(plan.end),
            Some(plan.options.relative_tolerance),
        )?;
        self.inputs.begin(&plan.inputs, plan.start);
        if !self.inputs.continuous_at(&plan.inputs, plan.start) {
            return Err(self.inputs.bad_function_value(plan.start));
        }
        self.inputs.set_held(instance.core(), &plan.inputs)?;
        instance.core().set_reals(&plan.inputs.continuous.references, &self.inputs.continuous)?;
        let (instance, outcome) = instance.begin_steps(plan.same)?;
        self.initial = outcome;
        self.mode = Mode::Stepping(instance);
        Ok(())
    }

    /// Value of a variable at the last communication point.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<crate::Value, FmiError> {
        if self.broken {
            return Err(no_instance());
        }
        let core = self.core()?;
        if core.raw.is_stale() {
            return Err(FmiError::Disturbed { library: core.raw.library_path() });
        }
        core.value(variable)
    }

    pub(crate) fn core(&mut self) -> Result<&mut Core, FmiError> {
        match &mut self.mode {
            Mode::Stepping(instance) => Ok(instance.core()),
            Mode::Gone | Mode::Spare(_) => Err(no_instance()),
        }
    }

    /// Runs from the start to the end.
    ///
    /// # Errors
    /// [`FmiError::Simulation`] says why, where and with which numbers; samples delivered before it stay valid.
    pub(crate) fn run(&mut self, limits: &Limits, observer: &mut dyn Observer) -> Result<Report, FmiError> {
        let plan = Arc::clone(&self.plan);
        let Some(communication) = &plan.communication else { return Err(no_instance()) };
        let mut run = Run {
            stepping: self,
            plan: &plan,
            communication,
            limits,
            observer,
            t: plan.start,
            passed: 0,
            on_grid: true,
            next_row: 0,
            longest: f64::INFINITY,
            next_event: None,
            discards: 0,
            tried: 0.0,
            stats: Stats::default(),
            began: Instant::now(),
        };
        let exit = match run.start() {
            Ok(()) => loop {
                if let Err(exit) = run.advance() {
                    break exit;
                }
            },
            Err(exit) => exit,
        };
        let (time, step, stats) = (run.t.min(plan.end), run.tried, run.stats);
        match exit {
            Exit::Normal(termination) => Ok(Report { termination, time, stats }),
            Exit::Error(kind) => {
                self.broken |= matches!(kind, ErrorKind::Model(_));
                let error = SimulationError { kind, time, step, worst_state: None, last_event: None, stats };
                Err(FmiError::Simulation(Box::new(error)))
            }
        }
    }
}

fn no_instance() -> FmiError {
    FmiError::BadSetting { problem: "there is no running instance".to_owned() }
}

/// Why the loop is left.
enum Exit {
    Normal(Termination),
    Error(ErrorKind),
}

impl From<FmiError> for Exit {
    fn from(error: FmiError) -> Self {
        Exit::Error(ErrorKind::Model(Box::new(error)))
    }
}

type Step<T> = Result<T, Exit>;

/// One run: everything that changes between the start and the end.
struct Run<'a> {
    stepping: &'a mut Stepping,
    plan: &'a SimulationPlan,
    communication: &'a Communication,
    limits: &'a Limits,
    observer: &'a mut dyn Observer,
    t: f64,
    /// Regular points passed, and whether the run stands on the last of them.
    passed: u64,
    on_grid: bool,
    next_row: usize,
    /// Longest step after one was refused.
    longest: f64,
    /// The time event that the model announced.
    next_event: Option<f64>,
    discards: u32,
    tried: f64,
    stats: Stats,
    began: Instant,
}

/// The next communication point.
#[derive(Debug, Clone, Copy)]
struct Target {
    time: f64,
    step: f64,
    /// It is the next regular point.
    regular: bool,
}

impl Run<'_> {
    fn start(&mut self) -> Step<()> {
        let initial = self.stepping.initial;
        self.next_event = initial.next_time;
        self.sample_here()?;
        if initial.terminate {
            return Err(Exit::Normal(Termination::StoppedByModel));
        }
        self.reached_end()
    }

    /// One communication step with everything that belongs to it.
    fn advance(&mut self) -> Step<()> {
        self.check_limits()?;
        let target = self.target();
        self.tried = target.step;
        // Only a model that cannot stop at a row makes it necessary to look on both sides of it.
        let row_inside = self.row_before(target.time).is_some();
        if row_inside {
            self.read(Place::Before)?;
        }
        self.set_input_derivatives(&target)?;
        let (limits, began, cancel) = (*self.limits, self.began, &self.plan.options.cancel);
        let mut keep_waiting = || {
            limits.timeout.is_none_or(|limit| began.elapsed() < limit)
                && !cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed))
        };
        let Some(outcome) = self.stepping.core()?.do_step(self.t, target.step, &mut keep_waiting)? else {
            self.stepping.broken = true;
            self.check_limits()?;
            return Err(Exit::Error(ErrorKind::Cancelled));
        };
        if outcome.complete {
            self.discards = 0;
            self.longest = f64::INFINITY;
            self.arrive(target.time, target.regular, row_inside, outcome.event)?;
        } else {
            self.cut_short(&target, &outcome, row_inside)?;
        }
        if outcome.terminate {
            return Err(Exit::Normal(Termination::StoppedByModel));
        }
        self.reached_end()
    }

    /// A step of which only a part was computed, or nothing.
    fn cut_short(&mut self, target: &Target, outcome: &StepOutcome, row_inside: bool) -> Step<()> {
        let StepOutcome { reached, terminate, event, may_have_ended, .. } = *outcome;
        let same = self.plan.same;
        let can_retry = self.communication.variable;
        let reached = reached.map_or(self.t, |reached| reached.clamp(self.t, target.time));
        if reached > self.t + same && (can_retry || terminate || may_have_ended) {
            // The model stands there and goes on from there.
            self.discards = 0;
            let regular = target.regular && reached >= target.time - same;
            self.arrive(reached, regular, row_inside, event && !terminate)?;
            return if can_retry || terminate {
                Ok(())
            } else {
                Err(Exit::Normal(Termination::StoppedByModel))
            };
        }
        if terminate {
            return Ok(());
        }
        if event {
            // An event right here: the step begins once more behind it, but not for ever.
            self.discards += 1;
            if self.discards > MAX_EVENTS_HERE {
                let events = self.discards.into();
                return Err(Exit::Error(ErrorKind::Chattering { events, within: 0.0, indicator: 0 }));
            }
            return self.arrive_at(self.t, true);
        }
        self.stats.rejected_steps += 1;
        self.discards += 1;
        if !can_retry || self.discards > MAX_DISCARDS {
            if may_have_ended && self.stats.accepted_steps > 0 {
                return Err(Exit::Normal(Termination::StoppedByModel));
            }
            let core = self.stepping.core()?;
            let fault = core.raw.step_refused();
            return Err(core.error(fault).into());
        }
        self.longest = 0.5 * target.step;
        Ok(())
    }

    /// The step is good: samples inside of it, then those at its end, before and after the inputs change.
    fn arrive(&mut self, time: f64, regular: bool, row_inside: bool, event: bool) -> Step<()> {
        self.stats.accepted_steps += 1;
        if row_inside {
            self.read(Place::After)?;
            self.sample_inside(time)?;
        }
        self.passed += u64::from(regular);
        self.on_grid = regular;
        self.arrive_at(time, event)
    }

    /// The model stands at a communication point: samples, inputs and events.
    fn arrive_at(&mut self, time: f64, event: bool) -> Step<()> {
        self.t = time;
        self.sample_left()?;
        let ended = if self.communication.event_mode {
            self.set_inputs_at_events(event)?
        } else {
            self.set_inputs()?
        };
        if self.stepping.digest.is_some() {
            // Steps between requested times count too.
            self.read(Place::After)?;
            let Stepping { digest, after, .. } = &mut *self.stepping;
            digest.iter_mut().for_each(|digest| digest.note(after));
        }
        self.sample_here()?;
        if ended {
            return Err(Exit::Normal(Termination::StoppedByModel));
        }
        Ok(())
    }

    fn reached_end(&self) -> Step<()> {
        if self.t >= self.plan.end - self.plan.same {
            return Err(Exit::Normal(Termination::Finished));
        }
        Ok(())
    }

    /// As the driver of integrations does before each step.
    fn check_limits(&mut self) -> Step<()> {
        if self.observer.poll().is_break() {
            return Err(Exit::Normal(Termination::StoppedByObserver));
        }
        if self.plan.options.cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed)) {
            return Err(Exit::Error(ErrorKind::Cancelled));
        }
        if let Some(most) = self.limits.max_steps
            && self.stats.accepted_steps + self.stats.rejected_steps >= most
        {
            return Err(Exit::Error(ErrorKind::TooManySteps(most)));
        }
        if let Some(limit) = self.limits.timeout.filter(|limit| self.began.elapsed() >= *limit) {
            return Err(Exit::Error(ErrorKind::TimedOut(limit)));
        }
        Ok(())
    }

    fn target(&self) -> Target {
        let (plan, same) = (self.plan, self.plan.same);
        let grid = self.communication.step.map(|step| (plan.start + (self.passed + 1) as f64 * step, step));
        if !self.communication.variable
            && let Some((time, step)) = grid
        {
            return Target { time, step, regular: true };
        }
        let mut time = plan.end;
        if let Some((next, _)) = grid.filter(|(next, _)| *next < time + same) {
            time = next.min(time);
        }
        let input = plan.inputs.next_stop(self.t).map(|stop| stop.time);
        let event = self.next_event.filter(|next| *next > self.t + same);
        let retry = Some(self.t + self.longest);
        for stop in [self.row_before(time - same), input, event, retry].into_iter().flatten() {
            if stop < time - same {
                time = stop;
            }
        }
        let regular = grid.is_some_and(|(next, _)| (next - time).abs() <= same);
        let step = match grid {
            // From one regular point to the next, unless rounding would lead beyond the end.
            Some((_, step)) if regular && self.on_grid && self.t + step <= plan.end => step,
            _ => time - self.t,
        };
        Target { time, step, regular }
    }

    /// The next requested time, if it lies between here and `limit`.
    fn row_before(&self, limit: f64) -> Option<f64> {
        let row = self.plan.times.get(self.next_row).copied();
        row.filter(|row| *row > self.t + self.plan.same && *row < limit - self.plan.same)
    }

    fn set_input_derivatives(&mut self, target: &Target) -> Step<()> {
        let inputs = &self.plan.inputs;
        if !self.communication.input_derivatives || inputs.continuous.references.is_empty() {
            return Ok(());
        }
        let Stepping { inputs: state, slopes, .. } = &mut *self.stepping;
        slopes.copy_from_slice(&state.continuous);
        if !state.continuous_at(inputs, target.time) {
            return Err(state.bad_function_value(target.time).into());
        }
        for (slope, end) in slopes.iter_mut().zip(&state.continuous) {
            *slope = (end - *slope) / target.step;
        }
        let slopes = std::mem::take(&mut self.stepping.slopes);
        let set = self.stepping.core().and_then(|core| {
            core.call(|raw| raw.set_input_derivatives(&inputs.continuous.references, &slopes))
        });
        self.stepping.slopes = slopes;
        match set {
            // Offered, but not there: then inputs are held, as for everybody else.
            Ok(()) | Err(FmiError::MissingFunction { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Inputs from this point on, where the model has an event mode: what jumps, does so there. Returns whether the
    /// model ends the simulation.
    fn set_inputs_at_events(&mut self, event: bool) -> Step<bool> {
        let (plan, same) = (&self.plan.inputs, self.plan.same);
        let Stepping { inputs, mode, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        let core = instance.core();
        let jumped = inputs.pass(plan, self.t);
        if !inputs.continuous_at(plan, self.t) {
            return Err(inputs.bad_function_value(self.t).into());
        }
        let cause = EventCause {
            input: jumped,
            step: event,
            time: self.next_event.is_some_and(|next| next <= self.t + same),
            state: false,
        };
        if cause == EventCause::default() {
            core.set_reals(&plan.continuous.references, &inputs.continuous)?;
            return Ok(false);
        }
        core.call(RawInstance::enter_event_mode)?;
        inputs.set_held(core, plan)?;
        core.set_reals(&plan.continuous.references, &inputs.continuous)?;
        let outcome = core.settle(self.t, same)?;
        self.next_event = outcome.next_time.filter(|next| *next > self.t + same);
        self.stats.events += 1;
        self.stats.input_events += u64::from(cause.input);
        self.stats.step_events += u64::from(cause.step);
        self.stats.time_events += u64::from(cause.time);
        self.observer.event(&EventRecord { time: self.t, cause });
        Ok(outcome.terminate)
    }

    /// Inputs from this point on. The model never ends a simulation here.
    fn set_inputs(&mut self) -> Step<bool> {
        let plan = &self.plan.inputs;
        if plan.driven.is_empty() {
            return Ok(false);
        }
        let Stepping { inputs, mode, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        inputs.pass(plan, self.t);
        if !inputs.continuous_at(plan, self.t) {
            return Err(inputs.bad_function_value(self.t).into());
        }
        inputs.set_held(instance.core(), plan)?;
        instance.core().set_reals(&plan.continuous.references, &inputs.continuous)?;
        Ok(false)
    }

    /// Reads the outputs where the model stands.
    fn read(&mut self, place: Place) -> Step<()> {
        let time = self.t;
        let Stepping { mode, buffers, before, after, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        let outputs = self.plan.outputs();
        instance.core().call(|raw| buffers.read(outputs, raw))?;
        let row = match place {
            Place::Before => before,
            Place::After => after,
        };
        buffers.row(outputs, time, &[], row);
        Ok(())
    }

    /// Whether the next requested time is listed once more.
    fn twice(&self) -> bool {
        let times = &self.plan.times;
        times.get(self.next_row + 1).is_some_and(|next| *next == times[self.next_row])
    }

    fn is_here(&self) -> bool {
        self.plan.times.get(self.next_row).is_some_and(|row| *row <= self.t + self.plan.same)
    }

    /// Samples between here and `end`: linear where the variable is continuous, held where it is not.
    fn sample_inside(&mut self, end: f64) -> Step<()> {
        while let Some(time) = self.row_before(end) {
            let theta = (time - self.t) / (end - self.t);
            let Stepping { before, after, between, .. } = &mut *self.stepping;
            for (i, value) in between.iter_mut().enumerate() {
                let is_time = self.plan.outputs().is_time(i);
                *value = match (is_time, self.plan.outputs().is_continuous(i)) {
                    (true, _) => time,
                    (_, true) => before[i] + theta * (after[i] - before[i]),
                    (_, false) => before[i],
                };
            }
            let row = std::mem::take(&mut self.stepping.between);
            let flow = self.deliver(&row);
            self.stepping.between = row;
            flow?;
        }
        Ok(())
    }

    /// The limit from the left, where somebody wants it.
    fn sample_left(&mut self) -> Step<()> {
        if self.is_here() && self.twice() {
            self.read(Place::After)?;
            self.deliver_after()?;
        }
        Ok(())
    }

    /// All samples still due at this point.
    fn sample_here(&mut self) -> Step<()> {
        if !self.is_here() {
            return Ok(());
        }
        self.read(Place::After)?;
        while self.is_here() {
            self.deliver_after()?;
        }
        Ok(())
    }

    fn deliver_after(&mut self) -> Step<()> {
        let row = std::mem::take(&mut self.stepping.after);
        let flow = self.deliver(&row);
        self.stepping.after = row;
        flow
    }

    /// Hands the next row to the observer.
    fn deliver(&mut self, outputs: &[f64]) -> Step<()> {
        let index = self.next_row;
        let side = if self.twice() { Side::Left } else { Side::Right };
        self.next_row += 1;
        self.stats.samples += 1;
        if let Some(digest) = &mut self.stepping.digest {
            digest.note(outputs);
        }
        let sample = Sample { time: self.plan.times[index], index: Some(index), side, states: &[], outputs };
        match self.observer.sample(&sample) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Exit::Normal(Termination::StoppedByObserver)),
        }
    }
}

/// On which side of a step.
#[derive(Clone, Copy)]
enum Place {
    Before,
    After,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        SimulateOptions::new().final_time(10.0).ncp(100).grid(&DefaultExperiment::default()).unwrap()
    }

    fn capabilities(variable: bool) -> Capabilities {
        Capabilities { can_handle_variable_communication_step_size: variable, ..Capabilities::default() }
    }

    fn communication(
        step: Option<f64>,
        suggested: Option<f64>,
        variable: bool,
    ) -> Result<Communication, FmiError> {
        let options = SimulateOptions { step_size: step, ..SimulateOptions::default() };
        let experiment = DefaultExperiment { step_size: suggested, ..DefaultExperiment::default() };
        Communication::new(&options, &experiment, &capabilities(variable), &grid())
    }

    #[test]
    fn the_step_is_that_of_the_options_the_experiment_the_rows() {
        let step = |step, suggested| communication(step, suggested, false).unwrap().step;
        assert_eq!(step(Some(0.3), Some(0.2)), Some(0.3));
        assert_eq!(step(None, Some(0.2)), Some(0.2));
        assert_eq!(step(None, Some(-1.0)), Some(0.1));
        assert_eq!(step(None, None), Some(0.1));
    }

    #[test]
    fn without_regular_rows_only_fixed_steps_need_a_length() {
        let times = SimulateOptions::new().times([0.0, 1.0, 4.0]);
        let grid = times.grid(&DefaultExperiment::default()).unwrap();
        let step = |variable| {
            Communication::new(&times, &DefaultExperiment::default(), &capabilities(variable), &grid)
                .unwrap()
                .step
        };
        assert_eq!((step(true), step(false)), (None, Some(4.0 / 500.0)));
    }

    #[test]
    fn steps_that_lead_nowhere_are_refused() {
        for step in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-12] {
            let problem = communication(Some(step), None, true).unwrap_err().to_string();
            assert!(problem.contains("step_size"), "{problem}");
        }
    }
}
