//! The system as seen by a run. Its calls are timed, and evaluations fail after the run was cancelled or its
//! time limit was reached, so that long steps end too. In a run backward in time, the time is reversed:
//! `dx/ds = -f(-s, x)` with `s = -t`.

use super::backward::{negate, turned};
use super::end_conditions::EndConditions;
use crate::sparsity::JacobianPattern;
use crate::stats::{Seconds, Stats};
use crate::stopwatch::Stopwatch;
use crate::system::{
    Argument, CallError, CallResult, Direction, EventOutcome, EventVisit, HybridSystem, InputStop, StepAction,
};
use std::time::Instant;

/// Calls that run the model. Each has a separate kind for the stopwatch.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Call {
    Derivatives,
    Jacobian,
    DirectionalDerivative,
    EventIndicators,
    Outputs,
    StepCompleted,
    Nominals,
    Start,
    HandleEvent,
}

impl Call {
    const KINDS: usize = Self::HandleEvent as usize + 1;

    /// True for the calls that a step makes often. They fail when the run must end.
    const fn is_evaluation(self) -> bool {
        matches!(
            self,
            Self::Derivatives | Self::Jacobian | Self::DirectionalDerivative | Self::EventIndicators
        )
    }

    /// True for rare calls whose durations can differ widely.
    const fn is_seldom(self) -> bool {
        matches!(self, Self::Nominals | Self::Start | Self::HandleEvent)
    }
}

/// A system with timed calls and end conditions.
pub(crate) struct TimedSystem<'a> {
    system: &'a mut dyn HybridSystem,
    watch: EndConditions<'a>,
    began: Instant,
    stopwatch: &'a mut CallWatch,
    /// Slopes with respect to the time of the system, in a run backward in time.
    slopes: Option<&'a mut Vec<f64>>,
}

/// The stopwatch for the calls of a system; reused by later runs.
pub(crate) type CallWatch = Stopwatch<{ Call::KINDS }>;

impl<'a> TimedSystem<'a> {
    /// Creates the system for a run that starts now. `slopes` is work space for a run backward in time.
    pub(crate) fn new(
        system: &'a mut dyn HybridSystem,
        watch: EndConditions<'a>,
        stopwatch: &'a mut CallWatch,
        slopes: Option<&'a mut Vec<f64>>,
    ) -> Self {
        stopwatch.reset();
        Self { system, watch, began: Instant::now(), stopwatch, slopes }
    }

    /// Converts between the time of the run and the time of the system, in both directions.
    #[inline]
    fn at(&self, t: f64) -> f64 {
        if self.slopes.is_some() { turned(t) } else { t }
    }

    /// Converts derivatives with respect to time from the system to the run.
    #[inline]
    fn turn(&self, derivatives: &mut [f64]) {
        if self.slopes.is_some() {
            negate(derivatives);
        }
    }

    fn outcome(&self, outcome: EventOutcome) -> EventOutcome {
        EventOutcome { next_time: outcome.next_time.map(|t| self.at(t)), ..outcome }
    }

    /// Stores the times of the run, which ends now.
    pub(crate) fn enter_times(&self, stats: &mut Stats) {
        let seconds = self.began.elapsed().as_secs_f64();
        stats.seconds = Seconds::new(seconds);
        stats.seconds_in_model = Seconds::new(self.stopwatch.seconds().min(seconds));
    }
}

/// Makes a call that runs the model. `$turned` contains the derivatives with respect to time that the call
/// fills in.
macro_rules! watched {
    ($self:ident, $call:ident, $answer:expr $(, $turned:ident)?) => {{
        if const { Call::$call.is_evaluation() } {
            $self.watch.check().map_err(CallError::failed)?;
        }
        let kind = Call::$call as usize;
        let timing = if const { !Call::$call.is_seldom() } && $self.stopwatch.skips(kind) {
            None
        } else {
            Some($self.stopwatch.start_timed(kind))
        };
        let answer = $answer;
        if let Some(timing) = timing {
            $self.stopwatch.stop(timing);
        }
        $($self.turn($turned);)?
        answer
    }};
}

impl HybridSystem for TimedSystem<'_> {
    fn n_states(&self) -> usize {
        self.system.n_states()
    }
    fn n_event_indicators(&self) -> usize {
        self.system.n_event_indicators()
    }
    fn event_direction(&self, indicator: usize) -> Direction {
        self.system.event_direction(indicator)
    }
    fn n_outputs(&self) -> usize {
        self.system.n_outputs()
    }
    fn outputs_in_order(&self) -> bool {
        self.system.outputs_in_order()
    }
    fn is_unbounded(&self, state: usize) -> bool {
        self.system.is_unbounded(state)
    }
    fn jacobian_pattern(&self) -> Option<&JacobianPattern> {
        self.system.jacobian_pattern()
    }
    fn has_jacobian(&self) -> bool {
        self.system.has_jacobian()
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        self.system.mass_matrix()
    }
    fn has_residual(&self) -> bool {
        self.system.has_residual()
    }
    fn slopes_at_start(&mut self, dx: &mut [f64]) {
        self.system.slopes_at_start(dx);
        self.turn(dx);
    }
    fn residual(&mut self, t: f64, x: &[f64], dx: &[f64], r: &mut [f64]) -> CallResult<()> {
        let t = self.at(t);
        watched!(
            self,
            Derivatives,
            self.system.residual(t, x, slopes_in_system_time(&mut self.slopes, dx), r)
        )
    }
    fn residual_jacobian(
        &mut self,
        t: f64,
        x: &[f64],
        dx: &[f64],
        argument: Argument,
        j: &mut [f64],
    ) -> CallResult<bool> {
        let t = self.at(t);
        let is_available = watched!(
            self,
            Jacobian,
            self.system.residual_jacobian(t, x, slopes_in_system_time(&mut self.slopes, dx), argument, j)
        )?;
        if argument == Argument::Slopes {
            self.turn(j);
        }
        Ok(is_available)
    }
    fn states_corrected(&mut self, t: f64, x: &[f64]) -> CallResult<()> {
        self.system.states_corrected(self.at(t), x)
    }
    fn next_input_stop(&mut self, t: f64) -> Option<InputStop> {
        // Input stops after the current time are not useful backward in time.
        if self.slopes.is_some() { None } else { self.system.next_input_stop(t) }
    }
    fn nominals(&mut self, nominals: &mut [f64]) -> CallResult<()> {
        watched!(self, Nominals, self.system.nominals(nominals))
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        let t0 = self.at(t0);
        watched!(self, Start, self.system.start(t0, x)).map(|outcome| self.outcome(outcome))
    }
    #[inline]
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        let t = self.at(t);
        watched!(self, Derivatives, self.system.derivatives(t, x, dx), dx)
    }
    fn jacobian(&mut self, t: f64, x: &[f64], j: &mut [f64]) -> CallResult<bool> {
        let t = self.at(t);
        watched!(self, Jacobian, self.system.jacobian(t, x, j), j)
    }
    fn jacobian_entries(&mut self, t: f64, x: &[f64], entries: &mut [f64]) -> CallResult<bool> {
        let t = self.at(t);
        watched!(self, Jacobian, self.system.jacobian_entries(t, x, entries), entries)
    }
    fn directional_derivative(
        &mut self,
        t: f64,
        x: &[f64],
        seed: &[f64],
        derivative: &mut [f64],
    ) -> CallResult<bool> {
        let t = self.at(t);
        watched!(
            self,
            DirectionalDerivative,
            self.system.directional_derivative(t, x, seed, derivative),
            derivative
        )
    }
    #[inline]
    fn event_indicators(&mut self, t: f64, x: &[f64], z: &mut [f64]) -> CallResult<()> {
        let t = self.at(t);
        watched!(self, EventIndicators, self.system.event_indicators(t, x, z))
    }
    fn outputs(&mut self, t: f64, x: &[f64], y: &mut [f64]) -> CallResult<()> {
        let t = self.at(t);
        watched!(self, Outputs, self.system.outputs(t, x, y))
    }
    fn step_completed(&mut self, t: f64, x: &[f64]) -> CallResult<StepAction> {
        let t = self.at(t);
        watched!(self, StepCompleted, self.system.step_completed(t, x))
    }
    fn handle_event(&mut self, visit: &EventVisit<'_>, x: &mut [f64]) -> CallResult<EventOutcome> {
        let visit = &EventVisit { time: self.at(visit.time), ..*visit };
        watched!(self, HandleEvent, self.system.handle_event(visit, x)).map(|outcome| self.outcome(outcome))
    }
}

/// Converts slopes of the run to slopes with respect to the time of the system.
fn slopes_in_system_time<'s>(turned: &'s mut Option<&mut Vec<f64>>, dx: &'s [f64]) -> &'s [f64] {
    match turned {
        None => dx,
        Some(slopes) => {
            slopes.clear();
            slopes.extend(dx.iter().map(|v| -v));
            slopes
        }
    }
}
