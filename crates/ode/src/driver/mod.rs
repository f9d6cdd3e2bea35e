//! The integration loop: limits, step, event location, samples inside the step, acceptance, events, restart.

use crate::auto::Auto;
use crate::error::{ErrorKind, Evaluated, NotFinite, Report, SimulationError, Termination};
use crate::explicit_rk::{Dop853, ExplicitRk};
use crate::implicit::{Formula, Multistep, Radau5};
use crate::observer::Observer;
use crate::options::{AbsoluteTolerance, Method, Options, OptionsError};
use crate::sampling::Sampler;
use crate::stepper::Stepper;
use crate::system::{CallError, CallResult, EventCause, EventOutcome, HybridSystem};
use crate::tableau::{Euler, Rk4, Tsit5};

mod backward;
mod chattering;
mod end_conditions;
mod event_handling;
mod events_in_step;
mod failure_reasons;
mod returns_after_event;
mod run;
mod samples;
mod sliding;
mod step;
mod timed_system;
mod trial;

use backward::{BackwardObserver, turned, turned_end};
pub use end_conditions::{EndConditions, Stopped};
use run::{Exit, Run, Space, Step, Task, finish, no_retreat};
use timed_system::{CallWatch, TimedSystem};
use trial::{Found, Inside, Shrink, Tried};

/// Tolerance of an event location as a multiple of the time tolerance. An indicator within it counts as near
/// zero, because its value does not determine the time of its event any better.
const LOCATED: f64 = 8.0;

/// Rounding of times matters if it changes a step by more than this fraction.
const COARSE: f64 = 1e-8;

/// Integrates hybrid systems. Stores checked options and all work space, so a second run of a system of the
/// same size does not allocate.
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
    stepper: Box<dyn Stepper>,
    space: Space,
    stopwatch: CallWatch,
    /// Work space of runs backward in time.
    turned_times: Vec<f64>,
    turned_slopes: Vec<f64>,
}

impl Driver {
    /// Creates a driver after checking the options.
    ///
    /// # Errors
    /// Returns [`OptionsError`] with the option and its value.
    pub fn new(options: Options) -> Result<Self, OptionsError> {
        options.check()?;
        let stepper: Box<dyn Stepper> = match options.method {
            Method::Auto => Box::new(Auto::new(options.rtol_or_like())),
            Method::Tsit5 => Box::new(ExplicitRk::<7, Tsit5>::new()),
            Method::Radau5 => Box::<Radau5>::default(),
            Method::Dop853 => Box::new(ExplicitRk::<16, Dop853>::new()),
            Method::Adams => Box::new(Multistep::new(Formula::Adams, false)),
            Method::Bdf => Box::new(Multistep::new(Formula::Bdf, options.exclude_algebraic)),
            Method::Rk4 => Box::new(ExplicitRk::<5, Rk4>::new()),
            Method::Euler => Box::new(ExplicitRk::<2, Euler>::new()),
        };
        let (turned_times, turned_slopes) = (Vec::new(), Vec::new());
        Ok(Self {
            options,
            stepper,
            space: Space::default(),
            stopwatch: CallWatch::new(),
            turned_times,
            turned_slopes,
        })
    }

    /// Options of this driver.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Integrates `system` from `start` to `end` and passes the samples at `times` to `observer`.
    ///
    /// The end may be before the start if the system [can run backward](HybridSystem::can_run_backward).
    /// Crossings of event indicators then follow the direction of the integration: a downward crossing has
    /// the higher value at the later time.
    ///
    /// `times` must be in the order of the integration and within the span. A time listed twice yields the
    /// left limit and then the value after the events of that instant. A time listed once yields only the
    /// latter. Times are equal if they differ by at most the [tolerance](crate::time_tolerance) of the span.
    /// Each run is independent of earlier runs.
    ///
    /// # Errors
    /// Returns [`SimulationError`] with the reason, the point of failure and the numbers at that point.
    /// Samples delivered before the error remain valid.
    pub fn run(
        &mut self,
        system: &mut dyn HybridSystem,
        start: f64,
        end: f64,
        times: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Report, Box<SimulationError>> {
        let Self { options, stepper, space, stopwatch, turned_times, turned_slopes } = self;
        let watch = EndConditions::new(options);
        let is_backward = end < start && system.can_run_backward();
        let system = &mut TimedSystem::new(system, watch, stopwatch, is_backward.then_some(turned_slopes));
        let mut ended = if is_backward {
            turned_times.clear();
            turned_times.extend(times.iter().map(|t| turned(*t)));
            let (start, end, observer) = (turned(start), turned(end), &mut BackwardObserver(observer));
            let task = Task { start, end, times: turned_times, observer, watch };
            turned_end(Run::new(options, &mut **stepper, space, system, task).run())
        } else {
            let task = Task { start, end, times, observer, watch };
            Run::new(options, &mut **stepper, space, system, task).run()
        };
        let stats = ended.as_mut().map_or_else(|error| &mut error.stats, |report| &mut report.stats);
        system.enter_times(stats);
        ended
    }
}

impl Run<'_> {
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
            Exit::Error(kind) => {
                self.look_for_reasons(&kind);
                Err(Box::new(SimulationError {
                    kind,
                    time: self.t,
                    step: self.h_tried,
                    worst_state: self.worst_state,
                    last_event: self.last_event,
                    not_finite: self.not_finite,
                    undetermined: self.undetermined,
                    refusal: None,
                    stats: self.stats,
                }))
            }
        }
    }

    /// Checks the span, starts the system, handles the events at the start, and delivers the samples there.
    fn begin(&mut self) -> Step<()> {
        let (start, end) = (self.start, self.end);
        if !(start.is_finite() && end.is_finite() && start <= end) {
            return Err(ErrorKind::Span { start, end }.into());
        }
        if let Some(index) =
            Sampler::first_bad_time(self.times, start - self.time_tolerance, end + self.time_tolerance)
        {
            return Err(ErrorKind::SampleTimes { index, time: self.times[index] }.into());
        }
        let (n, nz) = (self.system.n_states(), self.system.n_event_indicators());
        if let AbsoluteTolerance::PerState(list) = &self.options.absolute_tolerance
            && list.len() != n
        {
            return Err(ErrorKind::ToleranceCount { given: list.len(), states: n }.into());
        }
        let space = &mut *self.space;
        let Space { x, x_new, x_mid, jump, slope, nominals, .. } = &mut *space;
        for v in [x, x_new, x_mid, jump, slope, nominals] {
            v.clear();
            v.resize(n, 0.0);
        }
        let system = &*self.system;
        space.domains.begin(nz, |i| system.event_direction(i));
        space.sampler.begin(self.system.n_outputs(), self.time_tolerance);
        if let Some(m) = self.system.mass_matrix() {
            if m.len() != n * n || m.iter().any(|m| !m.is_finite()) {
                return Err(ErrorKind::MassMatrix { given: m.len(), states: n }.into());
            }
            if !self.stepper.properties().takes_mass_matrix {
                return Err(ErrorKind::MassMatrixNeedsImplicit.into());
            }
        }
        if self.system.has_residual() && !self.stepper.properties().takes_residual {
            return Err(ErrorKind::ResidualNeedsBdf.into());
        }
        self.stepper.begin(&*self.system).map_err(no_retreat)?;

        let given = if self.fixed_step.is_some() { self.fixed_step } else { self.options.max_step };
        if let Some(step) = given.filter(|step| start < end && *step <= 4.0 * self.time_tolerance) {
            return Err(ErrorKind::StepBelowRounding { step, least: 4.0 * self.time_tolerance }.into());
        }
        let outcome = self.system.start(start, &mut self.space.x);
        let outcome = self.with_states(outcome)?;
        if outcome.terminate {
            // The model is at the point where it requested the end. Only its outputs may be evaluated.
            self.sample_here(false)?;
            return finish(Termination::StoppedByModel);
        }
        self.read_nominals()?;
        self.take_event_time(outcome.next_time)?;
        self.input_stop = self.system.next_input_stop(self.t);
        self.evaluate_here(false)?;
        // Events announced for the start happen before the samples there.
        self.more_events_here(true)?;
        match self.options.first_step {
            Some(h) => self.h = h,
            None => self.estimate_step()?,
        }
        self.sample_here(false)?;
        self.reached_end()
    }

    /// Records a state that is not finite if the system could not provide its states.
    fn with_states(&mut self, outcome: CallResult<EventOutcome>) -> Step<EventOutcome> {
        if matches!(outcome, Err(CallError::Discard)) {
            self.not_finite = NotFinite::first(Evaluated::State, self.t, &self.space.x);
        }
        outcome.map_err(no_retreat)
    }

    /// Makes one accepted step, with its samples and events, or one rejected trial.
    fn advance(&mut self) -> Step<()> {
        self.check_limits()?;
        if self.fixed_step.is_none()
            && let Some(state) = self.space.weights.without_tolerance(&self.space.x)
        {
            return Err(ErrorKind::NoTolerance { state }.into());
        }
        let target = self.target();
        let h = self.step_towards(target);
        let hits_target = h == target - self.t;
        let end = if hits_target { target } else { self.t + h };
        // Far from zero, the resolution of times is coarse and the actual step is their difference. Otherwise
        // the proposed number is used unchanged.
        let between = end - self.t;
        let h = if (between - h).abs() > COARSE * h { between } else { h };
        self.h_tried = h;
        match self.attempt(end, h)? {
            Tried::Good => self.commit(end, h),
            Tried::Again { h, why } => self.shrink(h, why),
        }
    }

    /// Ends the run if the observer, the cancel flag or the time limit requires it.
    fn check_stop(&mut self) -> Step<()> {
        if self.observer.poll().is_break() {
            return Err(Stopped::ByObserver.into());
        }
        Ok(self.watch.check()?)
    }

    fn check_limits(&mut self) -> Step<()> {
        self.check_stop()?;
        let limits = &self.options.limits;
        let over = |limit: Option<u64>, count: u64| limit.filter(|l| count >= *l);
        if let Some(n) = over(limits.max_steps, self.stats.accepted_steps + self.stats.rejected_steps) {
            return Err(ErrorKind::TooManySteps(n).into());
        }
        if let Some(n) = over(limits.max_right_hand_sides, self.stats.right_hand_sides) {
            return Err(ErrorKind::TooManyRightHandSides(n).into());
        }
        Ok(())
    }

    /// Accepts a good step: locates an event inside, delivers samples, completes the step, and handles
    /// events.
    fn commit(&mut self, end: f64, h: f64) -> Step<()> {
        let found = match self.look_inside(end, h)? {
            Inside::Nothing => Found { at: end, end, h, before: None },
            Inside::Crossing(found) => found,
            // Treated like a refused step.
            Inside::Again { h, why } => return self.shrink(h, why),
        };
        let Found { at, end, h, before } = found;
        let inside = at != end;
        let crossed = self.space.domains.mark(at - self.t, LOCATED * self.time_tolerance);
        let mut cause = EventCause { state: crossed.is_some(), ..EventCause::default() };
        if !(self.show_outputs(at, end, h)? && self.sample_before(at, end, h)?) {
            let h = self.stepper.refused(h);
            return self.shrink(h, Shrink::Refused);
        }
        self.discards = 0;
        self.worst_state = None;
        self.show_step(at, end, h);
        if let Some(before) = before {
            self.take_slope_before(before, end, h)?;
        }

        let theta = if inside { (at - self.t) / h } else { 1.0 };
        std::mem::swap(&mut self.space.x, &mut self.space.x_new);
        let h_next = self.next_step(h, theta);
        let began = std::mem::replace(&mut self.t, at);
        self.stats.accepted_steps += 1;

        let action = self.system.step_completed(at, &self.space.x).map_err(no_retreat)?;
        let stop = self.input_stop.filter(|stop| stop.time <= at + self.time_tolerance);
        cause.step = action.event;
        cause.time = self.next_time_event.is_some_and(|next| next <= at + self.time_tolerance);
        cause.input = stop.is_some_and(|stop| stop.jump);
        self.h = h_next;
        let eventful = cause != EventCause::default();
        self.watch_events(cause, crossed)?;
        if eventful {
            self.sample_left()?;
            if before.is_none() {
                self.take_slope(!inside && self.stepper.properties().evaluates_ends)?;
            }
        }
        if let Some(stop) = stop {
            self.h = self.stepper.kink(self.h);
            self.input_stop = self.system.next_input_stop(at.max(stop.time));
        }
        self.space.domains.settle();
        if eventful {
            self.visit_event(cause)?;
        } else {
            self.space.domains.advance(began);
        }
        let eventful = self.more_events_here(eventful)? || eventful;
        // A crossing this close belongs to this instant, so the samples are delivered after it.
        if !action.terminate && self.t < self.end - self.time_tolerance && self.is_about_to_cross()? {
            self.record_here(eventful)?;
        } else {
            self.sample_here(eventful)?;
        }
        if action.terminate {
            return finish(Termination::StoppedByModel);
        }
        self.reached_end()
    }

    /// Accepts the step up to `theta` and returns the proposed step size. A step shortened to end at a target
    /// does not reduce the proposal for the next one.
    fn next_step(&mut self, h: f64, theta: f64) -> f64 {
        if self.space.x.is_empty() {
            return if self.fixed_step.is_some() { h } else { self.step_without_states() };
        }
        let proposed = self.stepper.accept(h, theta);
        match self.fixed_step {
            Some(_) => h,
            None if h < self.h - self.time_tolerance => proposed.max(self.h),
            None => proposed,
        }
    }

    fn reached_end(&mut self) -> Step<()> {
        if self.t >= self.end - self.time_tolerance { finish(Termination::Finished) } else { Ok(()) }
    }
}
