//! The only loop: limit, step, locate, sample inside, commit, event, restart.

use crate::control::{Controller, Weights, initial_step, probe_step};
use crate::error::{ErrorKind, Report, SimulationError, Termination};
use crate::event::{ChatteringGuard, Domains};
use crate::explicit_rk::ExplicitRk;
use crate::observer::{EventRecord, Observer};
use crate::options::{AbsoluteTolerance, Method, Options, OptionsError};
use crate::sampling::{Here, Sampler};
use crate::stats::Stats;
use crate::stepper::{Stepper, Trial};
use crate::system::{CallError, CallResult, EventCause, EventOutcome, EventVisit, HybridSystem, InputStop};
use crate::tableau::{EULER, RK4, TSIT5};
use std::ops::ControlFlow;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Unit round-off of double precision.
const U: f64 = f64::EPSILON / 2.0;

/// Refused points in a row before a run gives up.
const MAX_DISCARDS: u32 = 12;

/// Integrates hybrid systems. Holds checked options and all work space, so that a second run of a system of the same
/// size allocates nothing.
///
/// ```
/// use ode::{CallResult, Driver, EventOutcome, HybridSystem, Ignore, Options};
///
/// /// x' = -x, x(0) = 1
/// struct Decay {
///     end: f64,
/// }
/// impl HybridSystem for Decay {
///     fn n_states(&self) -> usize {
///         1
///     }
///     fn start(&mut self, _t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
///         x[0] = 1.0;
///         Ok(EventOutcome::default())
///     }
///     fn derivatives(&mut self, _t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
///         dx[0] = -x[0];
///         Ok(())
///     }
///     fn step_completed(&mut self, _t: f64, x: &[f64]) -> CallResult<ode::StepAction> {
///         self.end = x[0];
///         Ok(ode::StepAction::default())
///     }
/// }
/// let mut driver = Driver::new(Options { relative_tolerance: 1e-9, ..Options::default() })?;
/// let mut decay = Decay { end: f64::NAN };
/// driver.run(&mut decay, 0.0, 1.0, &[], &mut Ignore)?;
/// assert!((decay.end - (-1f64).exp()).abs() < 1e-8);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Driver {
    options: Options,
    method: MethodState,
    space: Space,
}

/// The stepper behind [`Method`].
#[derive(Debug)]
enum MethodState {
    Tsit5(ExplicitRk<7>),
    Rk4(ExplicitRk<5>),
    Euler(ExplicitRk<2>),
}

/// Work space that outlives a run.
#[derive(Debug, Default)]
struct Space {
    x: Vec<f64>,
    x_new: Vec<f64>,
    x_mid: Vec<f64>,
    slope: Vec<f64>,
    nominals: Vec<f64>,
    weights: Weights,
    domains: Domains,
    sampler: Sampler,
}

impl Driver {
    /// Checks the options.
    ///
    /// # Errors
    /// [`OptionsError`] names the option and its value.
    pub fn new(options: Options) -> Result<Self, OptionsError> {
        options.check()?;
        let method = match options.method {
            Method::Auto | Method::Tsit5 => MethodState::Tsit5(ExplicitRk::new(&TSIT5)),
            Method::Rk4 => MethodState::Rk4(ExplicitRk::new(&RK4)),
            Method::Euler => MethodState::Euler(ExplicitRk::new(&EULER)),
        };
        Ok(Self { options, method, space: Space::default() })
    }

    /// The options it was made with.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Integrates `system` from `start` to `end` and hands the samples at `times` to `observer`.
    ///
    /// `times` ascend and lie within the span; a time listed twice gives the left limit, then the value after the events
    /// of that instant; a time listed once gives the latter. Times are equal within
    /// `100 u max(|t|, end - start)`. Each run is independent of those before.
    ///
    /// # Errors
    /// [`SimulationError`] says why, where and with which numbers; samples delivered before it stay valid.
    pub fn run<S, O>(
        &mut self,
        system: &mut S,
        start: f64,
        end: f64,
        times: &[f64],
        observer: &mut O,
    ) -> Result<Report, Box<SimulationError>>
    where
        S: HybridSystem + ?Sized,
        O: Observer + ?Sized,
    {
        let Self { options, method, space } = self;
        match method {
            MethodState::Tsit5(s) => Run::new(options, s, space, system, (start, end), times, observer).run(),
            MethodState::Rk4(s) => Run::new(options, s, space, system, (start, end), times, observer).run(),
            MethodState::Euler(s) => Run::new(options, s, space, system, (start, end), times, observer).run(),
        }
    }
}

/// Why the loop is left.
enum Exit {
    Normal(Termination),
    Error(ErrorKind),
}

impl From<ErrorKind> for Exit {
    fn from(kind: ErrorKind) -> Self {
        Self::Error(kind)
    }
}

type Step<T> = Result<T, Exit>;

/// Outcome of one trial step.
enum Tried {
    /// Accepted up to its own end, or up to the event found inside.
    Accepted { error: f64 },
    /// Rejected by the error test.
    Rejected { error: f64 },
    /// The model refused a point of it.
    Discarded,
}

/// One run: everything that changes between `start` and `end`.
struct Run<'a, S: ?Sized, M, O: ?Sized> {
    options: &'a Options,
    stepper: &'a mut M,
    space: &'a mut Space,
    system: &'a mut S,
    times: &'a [f64],
    observer: &'a mut O,
    start: f64,
    end: f64,
    /// Times closer than this are one.
    same: f64,
    t: f64,
    /// Step size the controller proposes, before it is cut to hit a target.
    h: f64,
    h_tried: f64,
    fixed_step: Option<f64>,
    controller: Controller,
    next_time_event: Option<f64>,
    input_stop: Option<InputStop>,
    guard: ChatteringGuard,
    discards: u32,
    worst_state: Option<usize>,
    last_event: Option<f64>,
    stats: Stats,
    began: Option<Instant>,
}

impl<'a, S, M, O> Run<'a, S, M, O>
where
    S: HybridSystem + ?Sized,
    M: Stepper,
    O: Observer + ?Sized,
{
    fn new(
        options: &'a Options,
        stepper: &'a mut M,
        space: &'a mut Space,
        system: &'a mut S,
        (start, end): (f64, f64),
        times: &'a [f64],
        observer: &'a mut O,
    ) -> Self {
        let span = end - start;
        let fixed_step = (!stepper.has_error_estimate()).then(|| options.step_size.unwrap_or(span / 500.0));
        let controller = Controller::new(stepper.order());
        Self {
            options,
            stepper,
            space,
            system,
            times,
            observer,
            start,
            end,
            same: 100.0 * U * start.abs().max(end.abs()).max(span),
            t: start,
            h: 0.0,
            h_tried: 0.0,
            fixed_step,
            controller,
            next_time_event: None,
            input_stop: None,
            guard: ChatteringGuard::new(span),
            discards: 0,
            worst_state: None,
            last_event: None,
            stats: Stats::default(),
            began: options.limits.timeout.map(|_| Instant::now()),
        }
    }

    fn run(mut self) -> Result<Report, Box<SimulationError>> {
        let exit = match self.begin() {
            Ok(()) => loop {
                if let Err(exit) = self.advance() {
                    break exit;
                }
            },
            Err(exit) => exit,
        };
        self.stats.samples = self.space.sampler.delivered();
        match exit {
            Exit::Normal(termination) => Ok(Report { termination, time: self.t, stats: self.stats }),
            Exit::Error(kind) => Err(Box::new(SimulationError {
                kind,
                time: self.t,
                step: self.h_tried,
                worst_state: self.worst_state,
                last_event: self.last_event,
                stats: self.stats,
            })),
        }
    }

    /// Checks the span, starts the system, lets the events at the start happen, delivers the samples there.
    fn begin(&mut self) -> Step<()> {
        let (start, end) = (self.start, self.end);
        if !(start.is_finite() && end.is_finite() && start <= end) {
            return Err(ErrorKind::Span { start, end }.into());
        }
        if let Some(index) = Sampler::first_bad_time(self.times, start - self.same, end + self.same) {
            return Err(ErrorKind::SampleTimes { index, time: self.times[index] }.into());
        }
        let (n, nz) = (self.system.n_states(), self.system.n_event_indicators());
        if let AbsoluteTolerance::PerState(list) = &self.options.absolute_tolerance
            && list.len() != n
        {
            return Err(ErrorKind::ToleranceCount { given: list.len(), states: n }.into());
        }
        let space = &mut *self.space;
        for v in [&mut space.x, &mut space.x_new, &mut space.x_mid, &mut space.slope, &mut space.nominals] {
            v.clear();
            v.resize(n, 0.0);
        }
        space.domains.resize(nz);
        space.sampler.begin(self.system.n_outputs());
        self.stepper.resize(n);

        if let Some(step) = self.fixed_step
            && start < end
            && step <= 4.0 * self.same
        {
            self.h_tried = step;
            return Err(ErrorKind::StepTooSmall { discarded: false }.into());
        }
        let outcome = self.system.start(start, &mut self.space.x).map_err(no_retreat)?;
        if outcome.terminate {
            // The model is still where it asked to end: nothing but its outputs may be asked for.
            self.sample_here(false)?;
            return finish(Termination::StoppedByModel);
        }
        self.read_nominals()?;
        self.take_event_time(outcome.next_time)?;
        self.input_stop = self.system.next_input_stop(self.t);
        self.evaluate_here()?;
        // Events announced for the very start belong to it: samples there see them done.
        self.more_events_here()?;
        match self.options.initial_step {
            Some(h) => self.h = h,
            None => self.estimate_step()?,
        }
        self.sample_here(false)?;
        self.reached_end()
    }

    /// One accepted step with everything that belongs to it, or one rejected trial.
    fn advance(&mut self) -> Step<()> {
        self.check_limits()?;
        let target = self.target();
        let h = self.step_towards(target);
        let hits_target = h == target - self.t;
        let end = if hits_target { target } else { self.t + h };
        self.h_tried = h;
        match self.attempt(end, h)? {
            Tried::Accepted { error } => self.commit(end, h, error),
            Tried::Rejected { error } => {
                self.stats.rejected_steps += 1;
                let (x, x_new) = (&self.space.x, &self.space.x_new);
                self.worst_state = self.space.weights.worst(x, x_new, self.stepper.error());
                let factor = self.controller.rejected(error);
                self.shrink(h * factor, false)
            }
            Tried::Discarded => self.retry_after_discard(h),
        }
    }

    /// The model refused a point of the step: a smaller one.
    fn retry_after_discard(&mut self, h: f64) -> Step<()> {
        self.stats.rejected_steps += 1;
        self.discards += 1;
        self.worst_state = None;
        let factor = self.controller.discarded();
        self.shrink(h * factor, true)
    }

    fn check_limits(&mut self) -> Step<()> {
        if self.observer.poll().is_break() {
            return finish(Termination::StoppedByObserver);
        }
        let limits = &self.options.limits;
        let over = |limit: Option<u64>, count: u64| limit.filter(|l| count >= *l);
        if let Some(cancel) = &self.options.cancel
            && cancel.load(Ordering::Relaxed)
        {
            return Err(ErrorKind::Cancelled.into());
        }
        if let Some(n) = over(limits.max_steps, self.stats.accepted_steps + self.stats.rejected_steps) {
            return Err(ErrorKind::TooManySteps(n).into());
        }
        if let Some(n) = over(limits.max_right_hand_sides, self.stats.right_hand_sides) {
            return Err(ErrorKind::TooManyRightHandSides(n).into());
        }
        if let (Some(limit), Some(began)) = (limits.timeout, self.began)
            && began.elapsed() >= limit
        {
            return Err(ErrorKind::TimedOut(limit).into());
        }
        Ok(())
    }

    /// The next instant that a step must hit exactly: the end, a time event, a kink or jump of an input.
    fn target(&self) -> f64 {
        let mut target = self.end;
        for stop in [self.next_time_event, self.input_stop.map(|s| s.time)].into_iter().flatten() {
            if stop > self.t + self.same && stop < target - self.same {
                target = stop;
            }
        }
        target
    }

    /// The step to try: what the controller proposes, cut or stretched so that no sliver is left before the target.
    fn step_towards(&self, target: f64) -> f64 {
        let remaining = target - self.t;
        if let Some(step) = self.fixed_step {
            // Grid points are start + k * step, never sums; an event does not shift them. The one we stand on, up to
            // rounding, is not the next.
            let mut k = ((self.t - self.start) / step).floor() + 1.0;
            while self.start + k * step <= self.t + self.same {
                k += 1.0;
            }
            let grid = self.start + k * step;
            return if grid >= target - self.same { remaining } else { grid - self.t };
        }
        if self.space.x.is_empty() && self.space.domains.len() == 0 {
            return remaining;
        }
        let h = self.h.min(self.options.max_step.unwrap_or(f64::INFINITY));
        if remaining < 1.1 * h && (self.options.max_step.is_none_or(|m| remaining <= m)) {
            remaining
        } else if remaining < 2.0 * h {
            0.5 * remaining
        } else {
            h
        }
    }

    /// Tries the step and reads the event indicators at its end.
    fn attempt(&mut self, end: f64, h: f64) -> Step<Tried> {
        let space = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x: &space.x };
        let tried =
            self.stepper.try_step(self.system, trial, &space.weights, &mut space.x_new, &mut self.stats);
        let error = match tried {
            Ok(error) if error.is_nan() => return Ok(Tried::Discarded),
            Ok(error) if error > 1.0 => return Ok(Tried::Rejected { error }),
            Ok(error) => error,
            Err(CallError::Discard) => return Ok(Tried::Discarded),
            Err(CallError::Failed(e)) => return Err(ErrorKind::Model(e).into()),
        };
        if space.domains.len() > 0 {
            self.stats.event_indicators += 1;
            match read_indicators(self.system, end, &space.x_new, &mut space.domains.end) {
                Ok(()) => {}
                Err(CallError::Discard) => return Ok(Tried::Discarded),
                Err(CallError::Failed(e)) => return Err(ErrorKind::Model(e).into()),
            }
        }
        Ok(Tried::Accepted { error })
    }

    /// Goes on with a smaller step, unless it would be too small to mean anything.
    fn shrink(&mut self, h: f64, discarded: bool) -> Step<()> {
        let span = self.end - self.start;
        let least = 16.0 * U * self.t.abs().max(1e-6 * span);
        let hopeless = self.fixed_step.is_some() || (discarded && self.discards > MAX_DISCARDS);
        if h < least || hopeless {
            return Err(ErrorKind::StepTooSmall { discarded }.into());
        }
        self.h = h;
        Ok(())
    }

    /// The step is good: locate an event inside, sample, complete it, handle events, go on.
    fn commit(&mut self, end: f64, h: f64, error: f64) -> Step<()> {
        let mut at = end;
        let mut inside = false;
        let mut cause = EventCause::default();
        if self.space.domains.changed() {
            match self.locate(end, h)? {
                Some(time) => {
                    inside = time != end;
                    at = time;
                }
                // The model refused a point in between: as if the step had been refused.
                None => return self.retry_after_discard(h),
            }
            cause.state = true;
        }
        let crossed = self.space.domains.mark();
        if !self.sample_before(at, end, h)? {
            return self.retry_after_discard(h);
        }
        self.discards = 0;
        self.worst_state = None;

        // Slopes at both sides of an event decide whether the method must be restarted.
        let theta = if inside { (at - self.t) / h } else { 1.0 };
        self.stepper.interpolate_slope(theta, &mut self.space.slope);
        std::mem::swap(&mut self.space.x, &mut self.space.x_new);
        let h_next = if self.fixed_step.is_some() { h } else { self.next_step(h, error) };
        if !inside {
            self.stepper.accept();
        }
        self.t = at;
        self.stats.accepted_steps += 1;

        let action = self.system.step_completed(at, &self.space.x).map_err(no_retreat)?;
        let stop = self.input_stop.filter(|stop| stop.time <= at + self.same);
        cause.step = action.event;
        cause.time = self.next_time_event.is_some_and(|next| next <= at + self.same);
        cause.input = stop.is_some_and(|stop| stop.jump);
        self.h = h_next;
        let eventful = cause != EventCause::default();
        if eventful {
            if cause.state
                && let Some(within) = self.guard.record(at)
            {
                let events = ChatteringGuard::EVENTS as u64;
                let indicator = crossed.unwrap_or_default();
                return Err(ErrorKind::Chattering { events, within, indicator }.into());
            }
            self.sample_left()?;
        }
        if let Some(stop) = stop {
            self.input_stop = self.system.next_input_stop(at.max(stop.time));
        }
        if eventful {
            self.visit_event(cause)?;
        } else {
            self.space.domains.advance();
        }
        let eventful = self.more_events_here()? || eventful;
        self.sample_here(eventful)?;
        if action.terminate {
            return finish(Termination::StoppedByModel);
        }
        self.reached_end()
    }

    /// The step size to propose after an accepted step; a step that was cut to hit a target does not make the next one
    /// smaller than the one proposed before.
    fn next_step(&mut self, h: f64, error: f64) -> f64 {
        if self.space.x.is_empty() {
            return self.h;
        }
        let proposed = h * self.controller.accepted(error);
        if h < self.h { proposed.max(self.h) } else { proposed }
    }

    /// Finds the first crossing in the step. `None`: the model refused a point inside.
    fn locate(&mut self, end: f64, h: f64) -> Step<Option<f64>> {
        let Space { x, x_new, x_mid, domains, .. } = &mut *self.space;
        let trial = Trial { t: self.t, end, h, x };
        let tolerance = (100.0 * U * (self.t.abs() + h)).max(4.0 * U * end.abs());
        let (stepper, system) = (&*self.stepper, &mut *self.system);
        let found = domains.locate(self.t, end, tolerance, |t, z| {
            stepper.interpolate(trial, (t - trial.t) / h, x_mid);
            read_indicators(system, t, x_mid, z)
        });
        let located = match found {
            Ok(located) => located,
            Err(CallError::Discard) => return Ok(None),
            Err(CallError::Failed(e)) => return Err(ErrorKind::Model(e).into()),
        };
        self.stats.event_indicators += located.evaluations;
        // An event this close to the end of the step is one with whatever happens there.
        if end - located.time <= self.same {
            if located.time != end {
                self.stats.event_indicators += 1;
                read_indicators(system, end, x_new, &mut domains.end).map_err(no_retreat)?;
            }
            return Ok(Some(end));
        }
        stepper.interpolate(trial, (located.time - trial.t) / h, x_new);
        Ok(Some(located.time))
    }

    /// Lets the events at the current time happen, restarts the method where they changed something.
    fn visit_event(&mut self, cause: EventCause) -> Step<()> {
        if let Some(n) = self.options.limits.max_events
            && self.stats.events >= n
        {
            return Err(ErrorKind::TooManyEvents(n).into());
        }
        let space = &mut *self.space;
        space.x_mid.copy_from_slice(&space.x);
        // Of two instants within rounding the model is shown the later one, or its time event would not be due.
        if let Some(next) = self.next_time_event.filter(|_| cause.time) {
            self.t = self.t.max(next.min(self.end));
        }
        let visit = EventVisit { time: self.t, cause, crossings: &space.domains.crossings };
        let outcome = self.system.handle_event(&visit, &mut space.x).map_err(no_retreat)?;
        space.domains.clear_marks();
        self.count(cause);
        self.last_event = Some(self.t);
        self.observer.event(&EventRecord { time: self.t, cause });
        self.take_event_time(outcome.next_time)?;
        if outcome.nominals_changed {
            self.read_nominals()?;
        }
        if outcome.terminate {
            self.sample_here(true)?;
            return finish(Termination::StoppedByModel);
        }
        self.resume(outcome)
    }

    fn count(&mut self, cause: EventCause) {
        let stats = &mut self.stats;
        stats.events += 1;
        stats.state_events += u64::from(cause.state);
        stats.time_events += u64::from(cause.time);
        stats.step_events += u64::from(cause.step);
        stats.input_events += u64::from(cause.input);
    }

    /// After an event: reads the right-hand side and the indicators anew. When neither the states (their values before
    /// are in `x_mid`) nor the slope have changed to speak of, the step size is kept; otherwise a new one is estimated.
    fn resume(&mut self, outcome: EventOutcome) -> Step<()> {
        let before = self.h;
        let Space { x, x_mid, weights, .. } = &*self.space;
        // Written so that a NaN counts as a change.
        let same_states = !outcome.states_changed || weights.distance(x, x, x_mid) < 1e-3;
        self.evaluate_here()?;
        if before == 0.0 {
            return Ok(()); // still at the start: the first step is estimated when its events are over
        }
        let Space { x, slope, weights, .. } = &*self.space;
        let same_slope = before * weights.distance(x, self.stepper.derivative(), slope) < 0.1;
        if !(same_states && same_slope) || outcome.nominals_changed {
            self.stats.restarts += 1;
            self.controller.restart();
            self.estimate_step()?;
            self.h = self.h.min(before);
        }
        Ok(())
    }

    /// Right-hand side and event indicators at the current point.
    fn evaluate_here(&mut self) -> Step<()> {
        let space = &mut *self.space;
        if !space.x.is_empty() {
            self.stepper.restart(self.system, self.t, &space.x, &mut self.stats).map_err(no_retreat)?;
        }
        if space.domains.len() > 0 {
            self.stats.event_indicators += 1;
            read_indicators(self.system, self.t, &space.x, &mut space.domains.base).map_err(no_retreat)?;
        }
        Ok(())
    }

    fn estimate_step(&mut self) -> Step<()> {
        let span = self.end - self.start;
        let space = &mut *self.space;
        if self.fixed_step.is_some() {
            return Ok(());
        }
        if space.x.is_empty() {
            // Without states nothing measures an error; indicators of time alone are looked at this often.
            self.h = span / 500.0;
            return Ok(());
        }
        let room = (self.target() - self.t).max(0.0);
        let space = &mut *self.space;
        let dx = self.stepper.derivative();
        let probe = probe_step(&space.weights, &space.x, dx, span).min(room);
        if probe.is_nan() || probe <= 0.0 {
            self.h = 1e-6 * span;
            return Ok(());
        }
        for ((p, x), d) in space.x_mid.iter_mut().zip(&space.x).zip(dx) {
            *p = x + probe * d;
        }
        self.stats.right_hand_sides += 1;
        self.h = match self.system.derivatives(self.t + probe, &space.x_mid, &mut space.x_new) {
            Ok(()) => initial_step(&space.weights, self.stepper.order(), &space.x, dx, &space.x_new, probe),
            Err(CallError::Discard) => 0.01 * probe,
            Err(CallError::Failed(e)) => return Err(ErrorKind::Model(e).into()),
        };
        if !self.h.is_finite() || self.h <= 0.0 {
            self.h = 0.01 * probe;
        }
        Ok(())
    }

    fn read_nominals(&mut self) -> Step<()> {
        let space = &mut *self.space;
        self.system.nominals(&mut space.nominals).map_err(no_retreat)?;
        let options = self.options;
        space.weights.set(options.relative_tolerance, &options.absolute_tolerance, &space.nominals);
        Ok(())
    }

    fn take_event_time(&mut self, next: Option<f64>) -> Step<()> {
        if let Some(next) = next
            && (next.is_nan() || next < self.t - self.same)
        {
            return Err(ErrorKind::EventInThePast(next).into());
        }
        self.next_time_event = next;
        Ok(())
    }

    /// Time events and input stops that fall on the current instant although the step did not end for them: announced
    /// for it by the start or by an event, or too close to it to be hit on their own. Whether there was any event.
    fn more_events_here(&mut self) -> Step<bool> {
        let mut visits = 0;
        loop {
            let time = self.next_time_event.is_some_and(|next| next <= self.t + self.same);
            let stop = self.input_stop.filter(|stop| stop.time <= self.t + self.same);
            if let Some(stop) = stop {
                self.input_stop = self.system.next_input_stop(stop.time);
            }
            let input = stop.is_some_and(|stop| stop.jump);
            if time || input {
                visits += 1;
                if visits > ChatteringGuard::EVENTS {
                    return Err(ErrorKind::TimeEventLoop(ChatteringGuard::EVENTS as u64).into());
                }
                self.space.slope.copy_from_slice(self.stepper.derivative());
                self.sample_left()?;
                self.visit_event(EventCause { time, input, ..EventCause::default() })?;
            } else if stop.is_none() {
                return Ok(visits > 0);
            }
        }
    }

    /// Samples strictly inside the step, up to (not including) `at`. `false`: the model refused one of these points;
    /// nothing is committed, so a smaller step can follow.
    fn sample_before(&mut self, at: f64, end: f64, h: f64) -> Step<bool> {
        while let Some(t) = self.space.sampler.due_before(self.times, at - self.same) {
            let Space { x, x_mid, sampler, .. } = &mut *self.space;
            let theta = ((t - self.t) / h).clamp(0.0, 1.0);
            self.stepper.interpolate(Trial { t: self.t, end, h, x }, theta, x_mid);
            let here = Here { t, x: x_mid, same: 0.0, record: false };
            match sampler.deliver(self.system, self.times, &here, self.observer) {
                Err(CallError::Discard) => return Ok(false),
                flow => follow(flow)?,
            }
        }
        Ok(true)
    }

    /// The left limit at the current time, where somebody wants it: the time is listed twice, or events are recorded.
    fn sample_left(&mut self) -> Step<()> {
        let Space { x, sampler, .. } = &mut *self.space;
        let here = Here { t: self.t, x, same: self.same, record: self.options.record_events };
        follow(sampler.deliver_left(self.system, self.times, &here, self.observer))
    }

    /// All samples still due at the current time, after everything that happened there.
    fn sample_here(&mut self, after_event: bool) -> Step<()> {
        let Space { x, sampler, .. } = &mut *self.space;
        let record = after_event && self.options.record_events;
        let here = Here { t: self.t, x, same: self.same, record };
        follow(sampler.deliver_here(self.system, self.times, &here, self.observer))
    }

    fn reached_end(&mut self) -> Step<()> {
        if self.t >= self.end - self.same { finish(Termination::Finished) } else { Ok(()) }
    }
}

fn finish(termination: Termination) -> Step<()> {
    Err(Exit::Normal(termination))
}

/// The observer's word on a sample.
fn follow(flow: CallResult<ControlFlow<()>>) -> Step<()> {
    match flow.map_err(no_retreat)? {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => finish(Termination::StoppedByObserver),
    }
}

/// Event indicators; a value that is not finite counts as refused.
fn read_indicators<S: HybridSystem + ?Sized>(
    system: &mut S,
    t: f64,
    x: &[f64],
    z: &mut [f64],
) -> Result<(), CallError> {
    system.event_indicators(t, x, z)?;
    if z.iter().all(|z| z.is_finite()) { Ok(()) } else { Err(CallError::Discard) }
}

/// A call that has no smaller step to fall back to: the model's own start, its state after an event, a sample.
fn no_retreat(error: CallError) -> Exit {
    match error {
        CallError::Discard => ErrorKind::DiscardedAtRestart.into(),
        CallError::Failed(e) => ErrorKind::Model(e).into(),
    }
}
