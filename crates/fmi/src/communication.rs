//! Co-simulation: the loop over communication points, which delivers the same samples as the integration of a model.
//! Which points these are says [`Communication`].

use crate::assign::Assignments;
use crate::clocks::{ClockState, Tick};
use crate::co_simulation::StepOutcome;
use crate::description::Variable;
use crate::digest::Digest;
use crate::error::FmiError;
use crate::input::InputState;
use crate::instance::{CoSimulation, Core, Instance, Instantiated, StepMode};
use crate::intermediate::Between;
use crate::outputs::OutputBuffers;
use crate::plan::SimulationPlan;
use crate::points::Communication;
use crate::sys::{Fault, RawInstance};
use ode::{
    ErrorKind, EventCause, EventOutcome, EventRecord, Limits, Observer, Report, Sample, Seconds, Side,
    SimulationError, Stats, Stopwatch, Termination,
};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Steps of which nothing was computed, in a row, before a run gives up.
const MAX_DISCARDS: u32 = 12;

/// Events at one instant before a run gives up.
const MAX_EVENTS_HERE: u32 = 100;

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
    clocks: ClockState,
    /// Rows of outputs at the beginning and the end of a step, and one in between.
    before: Vec<f64>,
    after: Vec<f64>,
    between: Vec<f64>,
    slopes: Vec<f64>,
    /// Derivatives of outputs at the end of a step, where there are some.
    ends: Vec<f64>,
    /// Inputs on their way during a step.
    intermediate: Vec<f64>,
    /// Values of parameters on their way.
    signed: Vec<f64>,
    /// What the initial events told.
    initial: EventOutcome,
    /// Running digest of all samples; only while reset is checked.
    digest: Option<Digest>,
    stopwatch: Stopwatch<{ Call::KINDS }>,
}

impl Stepping {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let row = || vec![0.0; plan.outputs().len()];
        Self {
            mode: Mode::Gone,
            broken: false,
            inputs: InputState::new(&plan.inputs),
            buffers: OutputBuffers::new(plan.outputs()),
            clocks: ClockState::default(),
            before: row(),
            after: row(),
            between: row(),
            slopes: vec![0.0; plan.inputs.continuous.start.len()],
            ends: Vec::with_capacity(plan.outputs().smooth.0.len()),
            intermediate: Vec::with_capacity(plan.inputs.intermediate.0.len()),
            signed: Vec::new(),
            initial: EventOutcome::default(),
            digest: None,
            stopwatch: Stopwatch::new(),
            plan,
        }
    }

    /// The outputs as they were read last.
    pub(crate) fn buffers(&self) -> &OutputBuffers {
        &self.buffers
    }

    /// Seconds since the start in input functions of the user.
    pub(crate) fn seconds_elsewhere(&self) -> f64 {
        self.inputs.seconds_in_functions()
    }

    /// The ticks of all clocks in the last run.
    pub(crate) fn take_ticks(&mut self) -> Vec<Tick> {
        std::mem::take(&mut self.clocks.ticks)
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
        self.buffers.begin();
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
        self.clocks.begin(&plan.clocks, instance.core(), plan.start)?;
        let Self { clocks, buffers, .. } = self;
        let (instance, outcome) = instance.begin_steps(|core, time| {
            let recorded = &plan.outputs().clocks;
            clocks.settle(&plan.clocks, core, time, (recorded, buffers)).map(|(outcome, _)| outcome)
        })?;
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
        self.stopwatch.reset();
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
        let seconds = run.began.elapsed().as_secs_f64();
        run.stats.seconds = Seconds::new(seconds);
        run.stats.seconds_in_model = Seconds::new(run.stepping.stopwatch.seconds().min(seconds));
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

/// The calls into the model, by kinds for the stopwatch.
#[derive(Clone, Copy)]
enum Call {
    /// A communication step.
    Step,
    /// Outputs and their derivatives.
    Outputs,
    /// Inputs, and what they are computed from.
    Inputs,
    /// A visit of event mode: timed each.
    Events,
}

impl Call {
    const KINDS: usize = Self::Events as usize + 1;
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
    /// Makes a call into the model, and times it.
    fn timed<T>(&mut self, call: Call, make: impl FnOnce(&mut Self) -> T) -> T {
        let timing = match call {
            Call::Events => self.stepping.stopwatch.start_timed(call as usize),
            _ => self.stepping.stopwatch.start(call as usize),
        };
        let elsewhere = self.stepping.seconds_elsewhere();
        let answer = make(self);
        let elsewhere = self.stepping.seconds_elsewhere() - elsewhere;
        self.stepping.stopwatch.stop(timing, elsewhere);
        answer
    }

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
        self.check_ticks(&target)?;
        // Only a model that cannot stop at a row makes it necessary to look on both sides of it.
        let row_inside = self.row_before(target.time).is_some();
        if row_inside {
            self.read(Place::Before)?;
        }
        if self.communication.input_derivatives && !self.plan.inputs.continuous.references.is_empty() {
            self.timed(Call::Inputs, |run| run.set_input_derivatives(&target))?;
        }
        let (limits, began, cancel) = (*self.limits, self.began, &self.plan.options.cancel);
        let goes_on = || {
            limits.timeout.is_none_or(|limit| began.elapsed() < limit)
                && !cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed))
        };
        let step = self.timed(Call::Step, |run| {
            let Stepping { inputs, mode, intermediate, .. } = &mut *run.stepping;
            let Mode::Stepping(instance) = mode else { return Err(no_instance()) };
            let mut between = Between { plan: &run.plan.inputs, inputs, values: intermediate, goes_on };
            instance.core().do_step((run.t, target.step), &mut between, &mut { goes_on })
        });
        let Some(outcome) = step? else {
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
            self.timed(Call::Outputs, Self::read_slopes)?;
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
        let ended = self.communication.event_mode && self.set_inputs_at_events(event)?;
        if !self.communication.event_mode && !self.plan.inputs.driven.is_empty() {
            self.timed(Call::Inputs, Self::set_inputs)?;
        }
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

    /// Refuses to step over a tick: a model that takes steps of one length only may not be able to stop there.
    fn check_ticks(&self, target: &Target) -> Step<()> {
        let (clocks, same) = (&self.stepping.clocks, self.plan.same);
        match clocks.next(&self.plan.clocks) {
            Some(tick) if tick < target.time - same && !self.communication.variable => {
                let name = self.plan.clocks.name_of_next(clocks).unwrap_or_default();
                let problem = format!(
                    "the clock {name} ticks at {tick}, within the step from {} to {}, and the model takes no steps of \
                     other lengths than {}: choose a step that meets the ticks",
                    self.t, target.time, target.step
                );
                Err(FmiError::BadSetting { problem }.into())
            }
            _ => Ok(()),
        }
    }

    /// The next requested time, if it lies between here and `limit`.
    fn row_before(&self, limit: f64) -> Option<f64> {
        let row = self.plan.times.get(self.next_row).copied();
        row.filter(|row| *row > self.t + self.plan.same && *row < limit - self.plan.same)
    }

    fn set_input_derivatives(&mut self, target: &Target) -> Step<()> {
        let inputs = &self.plan.inputs;
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
        let jumped = self.timed(Call::Inputs, Self::compute_inputs)?;
        let cause = EventCause {
            input: jumped,
            step: event,
            time: self.next_event.is_some_and(|next| next <= self.t + self.plan.same),
            state: false,
        };
        if cause == EventCause::default() {
            self.timed(Call::Inputs, Self::set_continuous_inputs)?;
            return Ok(false);
        }
        let outcome = self.timed(Call::Events, Self::visit_event_mode)?;
        self.next_event = outcome.next_time.filter(|next| *next > self.t + self.plan.same);
        self.stats.events += 1;
        self.stats.input_events += u64::from(cause.input);
        self.stats.step_events += u64::from(cause.step);
        self.stats.time_events += u64::from(cause.time);
        self.observer.event(&EventRecord { time: self.t, cause });
        Ok(outcome.terminate)
    }

    fn visit_event_mode(&mut self) -> Step<EventOutcome> {
        let Stepping { inputs, mode, clocks, buffers, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        let core = instance.core();
        core.call(RawInstance::enter_event_mode)?;
        inputs.set_held(core, &self.plan.inputs)?;
        core.set_reals(&self.plan.inputs.continuous.references, &inputs.continuous)?;
        Ok(core.settle(self.t, |core, time| {
            let recorded = &self.plan.outputs().clocks;
            clocks.settle(&self.plan.clocks, core, time, (recorded, buffers)).map(|(outcome, _)| outcome)
        })?)
    }

    /// Inputs from this point on, where the model has none.
    fn set_inputs(&mut self) -> Step<()> {
        self.compute_inputs()?;
        let Stepping { inputs, mode, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        inputs.set_held(instance.core(), &self.plan.inputs)?;
        self.set_continuous_inputs()
    }

    /// Goes on to the inputs at this point; whether any of them jumped.
    fn compute_inputs(&mut self) -> Step<bool> {
        let inputs = &mut self.stepping.inputs;
        let jumped = inputs.pass(&self.plan.inputs, self.t);
        if inputs.continuous_at(&self.plan.inputs, self.t) {
            Ok(jumped)
        } else {
            Err(inputs.bad_function_value(self.t).into())
        }
    }

    fn set_continuous_inputs(&mut self) -> Step<()> {
        let Stepping { inputs, mode, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        let references = &self.plan.inputs.continuous.references;
        Ok(instance.core().set_reals(references, &inputs.continuous)?)
    }

    /// Reads the outputs where the model stands.
    fn read(&mut self, place: Place) -> Step<()> {
        self.timed(Call::Outputs, |run| run.read_into(place))
    }

    fn read_into(&mut self, place: Place) -> Step<()> {
        let time = self.t;
        let Stepping { mode, buffers, before, after, .. } = &mut *self.stepping;
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        let outputs = self.plan.outputs();
        instance.core().call(|raw| buffers.read(outputs, raw))?;
        let row = match place {
            Place::Before => before,
            Place::After => after,
        };
        buffers.row(outputs, time, self.plan.same, &[], row);
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

    /// Reads the derivatives of outputs at the end of a step, if the FMU offers them.
    fn read_slopes(&mut self) -> Step<()> {
        let references = &self.plan.outputs().smooth.1;
        let Stepping { mode, ends, .. } = &mut *self.stepping;
        ends.clear();
        if !self.communication.output_derivatives || references.is_empty() {
            return Ok(());
        }
        let Mode::Stepping(instance) = mode else { return Err(no_instance().into()) };
        ends.resize(references.len(), 0.0);
        match instance.core().raw.get_output_derivatives(references, ends) {
            Ok(()) => {}
            // Offered, but not there: then without them.
            Err(Fault::Missing(_) | Fault::Discard(_)) => ends.clear(),
            Err(fault) => return Err(instance.core().error(fault).into()),
        }
        if ends.iter().any(|slope| !slope.is_finite()) {
            ends.clear();
        }
        Ok(())
    }

    /// Samples between here and `end`: held where the variable is not continuous, else linear, or where the derivative at
    /// the end is known the parabola that has it (that at the start may be another one, if the inputs jump there).
    fn sample_inside(&mut self, end: f64) -> Step<()> {
        while let Some(time) = self.row_before(end) {
            let theta = (time - self.t) / (end - self.t);
            let Stepping { before, after, between, .. } = &mut *self.stepping;
            for (i, value) in between.iter_mut().enumerate() {
                let outputs = self.plan.outputs();
                if outputs.is_tick(i) {
                    *value = 0.0;
                    continue;
                }
                *value = match (outputs.is_time(i), outputs.is_continuous(i)) {
                    (true, _) => time,
                    (_, true) => before[i] + theta * (after[i] - before[i]),
                    (_, false) => before[i],
                };
            }
            let Stepping { before, after, between, ends, .. } = &mut *self.stepping;
            for (column, slope) in self.plan.outputs().smooth.0.iter().zip(ends.iter()) {
                let (rise, back) = (slope * (end - self.t), theta - 1.0);
                let bend = before[*column] - after[*column] + rise;
                between[*column] = after[*column] + back * (rise + back * bend);
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
