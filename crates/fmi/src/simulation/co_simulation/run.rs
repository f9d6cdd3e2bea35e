//! Loop over communication points, with inputs and events between two steps.

use super::state::{Call, CoSimulationState};
use crate::description::QuirkKind;
use crate::error::{FmiError, Status};
use crate::instance::StepOutcome;
use crate::libraries::StopTime;
use crate::simulation::plan::{Communication, SimulationPlan};
use crate::simulation::running::Running;
use crate::simulation::shared_observer::SharedObserver;
use crate::sys::{Fault, RawInstance};
use base::Number;
use ode::{ErrorKind, EventCause, EventOutcome, EventRecord, Observer, Stats, Stopped, Termination};

/// Maximum number of consecutive steps without progress.
const MAX_DISCARDS: u32 = 12;

/// Maximum number of events at one time.
const MAX_EVENTS_HERE: u32 = 100;

/// Fraction of a step by which a model may miss the step's end because it adds up internal steps.
const INTERNAL_TIME_TOLERANCE: f64 = 1e-6;

/// Number of step lengths that are remembered.
const LENGTHS: usize = 4;

/// Reason for leaving the loop.
pub(super) enum Exit {
    Normal(Termination),
    Error(ErrorKind),
}

impl From<FmiError> for Exit {
    fn from(error: FmiError) -> Self {
        match error {
            FmiError::Stopped(stopped) => stopped.into(),
            error => Exit::Error(ErrorKind::Model(Box::new(error))),
        }
    }
}

impl From<Stopped> for Exit {
    fn from(stopped: Stopped) -> Self {
        match stopped {
            Stopped::Cancelled => Exit::Error(ErrorKind::Cancelled),
            Stopped::TimedOut(limit) => Exit::Error(ErrorKind::TimedOut(limit)),
            Stopped::ByObserver => Exit::Normal(Termination::StoppedByObserver),
        }
    }
}

pub(super) type Step<T> = Result<T, Exit>;

/// State that changes during one run.
pub(super) struct Run<'a, 'o> {
    pub(super) stepping: &'a mut CoSimulationState,
    pub(super) plan: &'a SimulationPlan,
    pub(super) communication: &'a Communication,
    pub(super) max_steps: Option<u64>,
    pub(super) outside: &'a SharedObserver<'o>,
    pub(super) t: f64,
    /// Origin of the regular points: the start, or the time at which a model with steps of one length
    /// returned early.
    pub(super) origin: f64,
    /// Number of regular points passed. `on_grid` is true if the run is at the last of them.
    pub(super) passed: u64,
    pub(super) on_grid: bool,
    pub(super) next_row: usize,
    /// Lengths of previous steps, the last one first.
    pub(super) lengths: [f64; LENGTHS],
    /// Maximum length of the next step after a rejected step.
    pub(super) longest: f64,
    /// Time event that the model announced.
    pub(super) next_event: Option<f64>,
    pub(super) discards: u32,
    /// True if the model receives input values but no derivatives, so it holds them over a step.
    pub(super) holds_inputs: bool,
    /// True if the model was found at a time other than the end of a step.
    pub(super) is_elsewhere: bool,
    pub(super) tried: f64,
    pub(super) stats: Stats,
}

/// Side of a step.
#[derive(Clone, Copy)]
pub(super) enum StepSide {
    Before,
    After,
}

/// Next communication point.
#[derive(Debug, Clone, Copy)]
struct Target {
    time: f64,
    step: f64,
    /// True if the point is the next regular point.
    regular: bool,
}

impl Run<'_, '_> {
    /// Makes a call into the model and measures its time.
    pub(super) fn timed<T>(&mut self, call: Call, make: impl FnOnce(&mut Self) -> T) -> T {
        let timing = match call {
            Call::Events => self.stepping.stopwatch.start_timed(call as usize),
            _ => self.stepping.stopwatch.start(call as usize),
        };
        let answer = make(self);
        self.stepping.stopwatch.stop(timing);
        answer
    }

    pub(super) fn start(&mut self) -> Step<()> {
        let initial = self.timed(Call::Events, |run| run.stepping.run_initial_events(run.outside))?;
        self.next_event = initial.next_time;
        let raw = &self.stepping.running.current.core()?.raw;
        self.holds_inputs = !(self.communication.input_derivatives && raw.can_set_input_derivatives());
        self.sample_here()?;
        if initial.terminate {
            return Err(Exit::Normal(Termination::StoppedByModel));
        }
        self.reached_end()
    }

    /// Makes one communication step with its inputs, samples and events.
    pub(super) fn advance(&mut self) -> Step<()> {
        self.check_limits()?;
        let target = self.target();
        self.tried = target.step;
        self.check_ticks(&target)?;
        // Outputs on both sides of a row are needed only if the model cannot stop at the row.
        let row_inside = self.row_before(target.time).is_some();
        if row_inside {
            self.read(StepSide::Before)?;
        }
        if !self.plan.inputs.driven.is_empty() {
            self.timed(Call::Inputs, |run| run.set_inputs(&target))?;
        }
        let outcome = self.timed(Call::Step, |run| {
            let Running { current, .. } = &mut run.stepping.running;
            let outcome = current.core()?.do_step(run.t, target.step, &|| run.outside.check());
            current.broken |= outcome.is_err();
            outcome
        });
        let outcome = match outcome {
            Err(error) => {
                if error.call_failure().is_some_and(|failure| failure.status == Status::Error) {
                    self.note_last_step(&target, true);
                }
                return Err(error.into());
            }
            Ok(outcome) => outcome,
        };
        if outcome.complete {
            self.note_last_step(&target, false);
            self.discards = 0;
            self.longest = f64::INFINITY;
            self.check_internal_time(&target, &outcome);
            self.arrive(target.time, target.regular, row_inside, &outcome)?;
        } else {
            self.cut_short(&target, &outcome, row_inside)?;
        }
        if outcome.terminate {
            return Err(Exit::Normal(Termination::StoppedByModel));
        }
        self.reached_end()
    }

    /// Handles a step computed only partly or not at all.
    fn cut_short(&mut self, target: &Target, outcome: &StepOutcome, row_inside: bool) -> Step<()> {
        let StepOutcome { reached, early, terminate, event, may_have_ended, .. } = *outcome;
        let time_tolerance = self.plan.time_tolerance;
        let can_retry = self.communication.variable;
        let reached = reached.map_or(self.t, |reached| reached.clamp(self.t, target.time));
        if reached > self.t + time_tolerance && (can_retry || early || terminate || may_have_ended) {
            // The model has reached this time and continues from it.
            self.discards = 0;
            let regular = target.regular && reached >= target.time - time_tolerance;
            self.arrive(reached, regular, row_inside, outcome)?;
            if !can_retry && !regular {
                (self.origin, self.passed, self.on_grid) = (reached, 0, true);
            }
            return if can_retry || early || terminate {
                Ok(())
            } else {
                Err(Exit::Normal(Termination::StoppedByModel))
            };
        }
        if (terminate || !can_retry) && !event && self.note_last_step(target, true) {
            let core = self.stepping.running.current.core()?;
            return Err(core.error(Fault::Discard(core.raw.step_function())).into());
        }
        if terminate {
            return Ok(());
        }
        if event {
            // The event is at the current time, so the step is repeated after it. The number of repetitions
            // is limited.
            self.discards += 1;
            if self.discards > MAX_EVENTS_HERE {
                let events = self.discards.into();
                return Err(Exit::Error(ErrorKind::Chattering { events, within: 0.0, indicator: 0 }));
            }
            return self.arrive_at(self.t, outcome);
        }
        self.stats.rejected_steps += 1;
        self.discards += 1;
        if !can_retry || self.discards > MAX_DISCARDS {
            if may_have_ended && self.stats.accepted_steps > 0 {
                return Err(Exit::Normal(Termination::StoppedByModel));
            }
            let core = self.stepping.running.current.core()?;
            let call = core.raw.step_function();
            return Err(match early {
                true => FmiError::NoProgress { call, time: self.t }.into(),
                false => core.error(Fault::Discard(call)).into(),
            });
        }
        self.longest = 0.5 * target.step;
        Ok(())
    }

    /// Handles an accepted step: samples inside it, then samples at its end before and after the inputs
    /// change.
    fn arrive(&mut self, time: f64, regular: bool, row_inside: bool, outcome: &StepOutcome) -> Step<()> {
        self.stats.accepted_steps += 1;
        if row_inside {
            self.read(StepSide::After)?;
            self.timed(Call::Outputs, Self::read_slopes)?;
            self.sample_inside(time)?;
        }
        self.passed += u64::from(regular);
        self.on_grid = regular;
        self.arrive_at(time, outcome)
    }

    /// Delivers samples and handles events at a communication point.
    ///
    /// With event mode, inputs change here. Otherwise they are set after the row is read, immediately before
    /// the next step. FMI 2.0.5, section 4.2.4, leaves outputs undefined if they are read after inputs were
    /// set and before a step. A model that ends the simulation here has no further events.
    fn arrive_at(&mut self, time: f64, outcome: &StepOutcome) -> Step<()> {
        self.t = time;
        self.sample_left()?;
        let event_mode = self.stepping.running.current.core()?.raw.has_event_mode();
        let ended = event_mode && !outcome.terminate && self.handle_events(outcome.event)?;
        self.sample_here()?;
        if ended {
            return Err(Exit::Normal(Termination::StoppedByModel));
        }
        Ok(())
    }

    /// Records whether a step to the stop time was rejected. Returns true if the next run handles the stop
    /// time differently, so this run is repeated.
    fn note_last_step(&mut self, target: &Target, is_refused: bool) -> bool {
        let CoSimulationState { stop, is_stop_time_passed, .. } = *self.stepping;
        if target.time < stop - self.plan.time_tolerance {
            return false;
        }
        let mut knowledge = self.plan.fmu().reset_knowledge(self.plan.kind);
        let before = knowledge.stop_time;
        knowledge.stop_time = before.after_last_step(is_stop_time_passed, is_refused);
        let now = knowledge.stop_time;
        drop(knowledge);
        if before != now && now == StopTime::Withheld {
            let message = format!(
                "the model rejects the last step if it receives the stop time {}, so the stop time is not \
                 passed to it",
                Number(stop)
            );
            self.plan.fmu().note_quirk(QuirkKind::Promise, message);
        }
        before != now
    }

    /// Records the first step that the model reports as complete although its time is not the end of the
    /// step. Its values then belong to another time.
    fn check_internal_time(&mut self, target: &Target, outcome: &StepOutcome) {
        let Some(reached) = outcome.reached.filter(|_| !self.is_elsewhere) else { return };
        let tolerance = self.plan.time_tolerance.max(INTERNAL_TIME_TOLERANCE * target.step);
        self.is_elsewhere = (reached - target.time).abs() > tolerance;
        if self.is_elsewhere {
            let message = format!(
                "after a complete step from {} to {}, the model is at {} (lastSuccessfulTime), and the \
                 recorded values belong to that time. To avoid this, use a communication step (step_size) \
                 that is a multiple of the internal step of the model",
                Number(self.t),
                Number(target.time),
                Number(reached)
            );
            self.plan.fmu().note_quirk(QuirkKind::Promise, message);
        }
    }

    fn reached_end(&self) -> Step<()> {
        if self.t >= self.plan.end - self.plan.time_tolerance {
            return Err(Exit::Normal(Termination::Finished));
        }
        Ok(())
    }

    /// Checks the limits as the integration driver does before each step.
    fn check_limits(&mut self) -> Step<()> {
        self.outside.check()?;
        if let Some(most) = self.max_steps
            && self.stats.accepted_steps + self.stats.rejected_steps >= most
        {
            return Err(Exit::Error(ErrorKind::TooManySteps(most)));
        }
        Ok(())
    }

    fn target(&mut self) -> Target {
        let (plan, time_tolerance) = (self.plan, self.plan.time_tolerance);
        let grid = self.communication.step.map(|step| (self.origin + (self.passed + 1) as f64 * step, step));
        if !self.communication.variable
            && let Some((time, step)) = grid
        {
            return Target { time, step, regular: true };
        }
        let mut time = self.stop_before(plan.end);
        if let Some((next, _)) = grid.filter(|(next, _)| *next < time + time_tolerance) {
            time = next.min(time);
        }
        let input = plan.inputs.next_stop(self.t).map(|stop| stop.time);
        let input_row = plan.inputs.next_row(self.t).filter(|_| self.holds_inputs);
        let retry = Some(self.t + self.longest);
        let stops = [self.row_before(time - time_tolerance), input, input_row, retry];
        let stops = stops.into_iter().flatten().map(|stop| self.stop_before(stop));
        let event = self.next_event.filter(|next| *next > self.t + time_tolerance);
        for stop in stops.chain(event) {
            if stop < time - time_tolerance {
                time = stop;
            }
        }
        // For two times within rounding, the later one is used. Otherwise the model's time event would not be
        // due.
        if let Some(event) = event.filter(|event| *event <= plan.end) {
            time = if event - time <= time_tolerance { time.max(event) } else { time };
        }
        let regular = grid.is_some_and(|(next, _)| (next - time).abs() <= time_tolerance);
        let step = match grid {
            // Uses the constant step between regular points, unless rounding would exceed the end.
            Some((_, step))
                if regular
                    && self.on_grid
                    && self.t + step <= plan.end.max(time)
                    && self.reaches(event, time, step) =>
            {
                step
            }
            _ => self.length(time, event),
        };
        Target { time, step, regular }
    }

    /// Returns the stop for reaching `time`. If the model has an internal step size, the stop is a multiple
    /// of that size before or after `time`.
    fn stop_before(&self, time: f64) -> f64 {
        let Some((below, above)) =
            self.communication.steps_around(self.plan.start, time, self.plan.time_tolerance)
        else {
            return time;
        };
        if below > self.t + self.plan.time_tolerance { below } else { above }
    }

    /// True if a step of this length to `time` reaches the event announced by the model, to the last bit. The
    /// model has no event before its announced time.
    fn reaches(&self, event: Option<f64>, time: f64, length: f64) -> bool {
        event.is_none_or(|event| time < event || self.t + length >= event)
    }

    /// Returns the length of a step to `time`. A previous length is used again if it differs only by
    /// rounding.
    fn length(&mut self, time: f64, event: Option<f64>) -> f64 {
        let (mut length, most) = (time - self.t, self.plan.end.max(time));
        if !self.reaches(event, time, length) {
            length = length.next_up();
        }
        let is_same = |earlier: &&f64| {
            (**earlier - length).abs() <= self.plan.time_tolerance
                && self.t + **earlier <= most
                && self.reaches(event, time, **earlier)
        };
        if let Some(earlier) = self.lengths.iter().find(is_same) {
            return *earlier;
        }
        self.lengths.rotate_right(1);
        self.lengths[0] = length;
        length
    }

    /// Returns an error if the step would pass a tick. A model with steps of one length may not be able to
    /// stop at the tick.
    fn check_ticks(&self, target: &Target) -> Step<()> {
        let (clocks, time_tolerance) = (&self.stepping.running.clocks, self.plan.time_tolerance);
        match clocks.next(&self.plan.clocks) {
            Some(tick) if tick < target.time - time_tolerance && !self.communication.variable => {
                let name = clocks.name_of_next(&self.plan.clocks).unwrap_or_default();
                let problem = format!(
                    "the clock {name} ticks at {tick}, within the step from {} to {}, but the model supports \
                     only steps of {}. Choose a step_size whose steps end at the ticks",
                    self.t, target.time, target.step
                );
                Err(FmiError::BadSetting(problem).into())
            }
            _ => Ok(()),
        }
    }

    /// Returns the next requested time if it is between the current time and `limit`.
    pub(super) fn row_before(&self, limit: f64) -> Option<f64> {
        let row = self.plan.times.get(self.next_row).copied();
        row.filter(|row| *row > self.t + self.plan.time_tolerance && *row < limit - self.plan.time_tolerance)
    }

    fn set_input_derivatives(&mut self, target: &Target) -> Step<()> {
        let inputs = &self.plan.inputs;
        let CoSimulationState { running: Running { inputs: state, current, .. }, slopes, .. } =
            &mut *self.stepping;
        slopes.copy_from_slice(&state.continuous);
        if !state.continuous_at(inputs, target.time) {
            return Err(state.bad_function_value(target.time).into());
        }
        for (slope, end) in slopes.iter_mut().zip(&state.continuous) {
            *slope = (end - *slope) / target.step;
        }
        // FMI versions with this call have no other floating-point type.
        let (references, n) = inputs.continuous.reals();
        Ok(current.core()?.call(|raw| raw.set_input_derivatives(references, &slopes[..n]))?)
    }

    /// Handles the events at this point in event mode: events of the model, and input jumps. Returns true if
    /// the model ends the simulation.
    fn handle_events(&mut self, event: bool) -> Step<bool> {
        let jumped = self.stepping.running.inputs.pass(&self.plan.inputs, self.t);
        let cause = EventCause {
            input: jumped,
            step: event,
            time: self.next_event.is_some_and(|next| next <= self.t + self.plan.time_tolerance),
            state: false,
        };
        if cause == EventCause::default() {
            return Ok(false);
        }
        let outcome = self.timed(Call::Events, |run| run.visit_event_mode(jumped))?;
        self.next_event = outcome.next_time.filter(|next| *next > self.t);
        self.stats.events += 1;
        self.stats.input_events += u64::from(cause.input);
        self.stats.step_events += u64::from(cause.step);
        self.stats.time_events += u64::from(cause.time);
        let mut observer = self.outside;
        observer.event(&EventRecord { time: self.t, cause });
        Ok(outcome.terminate)
    }

    fn visit_event_mode(&mut self, jumped: bool) -> Step<EventOutcome> {
        self.compute_continuous()?;
        let Running { inputs, current, .. } = &mut self.stepping.running;
        let core = current.core()?;
        core.call(RawInstance::enter_event_mode)?;
        inputs.set_held(core, &self.plan.inputs)?;
        if jumped {
            inputs.set_parameters(core, &self.plan.inputs)?;
        }
        self.plan.inputs.continuous.set(core, &inputs.continuous)?;
        Ok(self.stepping.run_event_mode(self.t, self.outside)?)
    }

    /// Sets the inputs of the next step and their derivatives, and tunable parameters that have changed. With
    /// event mode, sets only the continuous inputs, because the others were set in event mode.
    fn set_inputs(&mut self, target: &Target) -> Step<()> {
        let event_mode = self.stepping.running.current.core()?.raw.has_event_mode();
        let jumped = !event_mode && self.stepping.running.inputs.pass(&self.plan.inputs, self.t);
        self.compute_continuous()?;
        let Running { inputs, current, .. } = &mut self.stepping.running;
        let core = current.core()?;
        if !event_mode {
            inputs.set_held(core, &self.plan.inputs)?;
        }
        if jumped {
            inputs.set_parameters(core, &self.plan.inputs)?;
        }
        let continuous = &self.plan.inputs.continuous;
        continuous.set(core, &inputs.continuous)?;
        if !self.holds_inputs && !continuous.is_empty() {
            self.set_input_derivatives(target)?;
        }
        Ok(())
    }

    /// Computes the continuous inputs at the current point.
    fn compute_continuous(&mut self) -> Step<()> {
        let inputs = &mut self.stepping.running.inputs;
        match inputs.continuous_at(&self.plan.inputs, self.t) {
            true => Ok(()),
            false => Err(inputs.bad_function_value(self.t).into()),
        }
    }
}
