//! The two running modes of model exchange: event mode with its iteration, and continuous-time mode.

use super::core::Core;
use super::phases::{ContinuousTime, EventMode, Instance, Readable, Running, Terminated};
use crate::error::{FmiError, Result};
use crate::sys::{EventInfo, RawInstance};
use ode::EventOutcome;

/// Rounds of an event iteration before it counts as endless.
pub const MAX_EVENT_ITERATIONS: u32 = 100;

impl Core {
    /// Updates the discrete states until they settle. What the model says in any of the rounds counts: flags
    /// of early rounds are not lost. A next event time that is `time` itself is one more round, unless the
    /// model keeps its own time (co-simulation), which may be before that; one that lies before `time` by
    /// more than `tolerance` is passed on. `before_round` looks at the model, and may end the iteration.
    pub(crate) fn iterate_events(
        &mut self,
        time: f64,
        tolerance: f64,
        limit: u32,
        before_round: &mut dyn FnMut(&mut Core) -> Result<()>,
    ) -> Result<EventOutcome> {
        let mut outcome = EventOutcome::default();
        for _ in 0..limit {
            before_round(self)?;
            let mut info = EventInfo::default();
            self.call(|raw| raw.new_discrete_states(&mut info))?;
            outcome.states_changed |= info.values_changed;
            outcome.nominals_changed |= info.nominals_changed;
            outcome.terminate |= info.terminate;
            outcome.next_time = info.next_event_time;
            if outcome.terminate {
                return Ok(outcome);
            }
            let due = !self.raw.has_event_mode()
                && info.next_event_time.is_some_and(|next| next <= time && time - next <= tolerance);
            if !info.new_discrete_states_needed && !due {
                return Ok(outcome);
            }
        }
        Err(FmiError::EventIteration { time, limit })
    }
}

impl<P: Readable> Instance<P> {
    /// Names of the continuous states, in the order of the state vector; `None` for those that are no
    /// variables. In FMI 1.0 the FMU is asked (`fmiGetStateValueReferences`), and may answer otherwise after
    /// an event; in the others the description says it.
    ///
    /// # Errors
    /// The FMU refuses, or has no such function.
    pub fn state_names(&mut self) -> Result<Vec<Option<String>>> {
        let fmu = self.fmu().clone();
        if fmu.description().fmi_version.major > 1 {
            let names = fmu.description().state_names().into_iter();
            return Ok(names.map(|name| name.map(str::to_owned)).collect());
        }
        let references = self.core().call(RawInstance::state_references)?;
        let name = |reference| fmu.real_variable(reference).map(|variable| variable.name.clone());
        Ok(references.into_iter().map(name).collect())
    }
}

/// Declares methods that make one call.
macro_rules! calls {
    ($($(#[$doc:meta])* $name:ident($($argument:ident: $type:ty),*) -> $outcome:ty;)+) => {$(
        $(#[$doc])*
        pub fn $name(&mut self, $($argument: $type),*) -> Result<$outcome> {
            self.core().call(|raw| raw.$name($($argument),*))
        }
    )+};
}

impl<P: Running> Instance<P> {
    calls! {
        /// Reads the continuous states.
        ///
        /// # Errors
        /// The slice has not the length of the state vector; the FMU refuses.
        get_continuous_states(states: &mut [f64]) -> ();
        /// Computes the event indicators.
        ///
        /// # Errors
        /// The slice has not as many elements as there are indicators; the FMU refuses.
        get_event_indicators(indicators: &mut [f64]) -> ();
        /// Computes the derivatives of the states.
        ///
        /// # Errors
        /// The slice has not the length of the state vector; the FMU refuses.
        get_derivatives(derivatives: &mut [f64]) -> ();
        /// Reads the nominal values of the states as the FMU gives them.
        ///
        /// # Errors
        /// The slice has not the length of the state vector; the FMU refuses.
        get_nominals(nominals: &mut [f64]) -> ();
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn terminate(self) -> Result<Instance<Terminated>> {
        self.step_to(RawInstance::terminate)
    }
}

impl Instance<EventMode> {
    /// Updates the discrete states until they settle, at most `limit` rounds (see [`MAX_EVENT_ITERATIONS`]).
    /// Clocks whose intervals are known tick when they are due; those that are triggered are set by hand.
    ///
    /// # Errors
    /// [`FmiError::EventIteration`] when they do not settle; the FMU refuses.
    pub fn update_discrete_states(&mut self, limit: u32) -> Result<EventOutcome> {
        let core = self.core();
        let time = core.raw.time().unwrap_or(0.0);
        core.settle_events(time, core.progress.time_tolerance(time), limit)
    }

    /// Goes on in continuous time.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn enter_continuous_time(self) -> Result<Instance<ContinuousTime>> {
        self.step_to(RawInstance::enter_continuous_time_mode)
    }
}

impl Instance<ContinuousTime> {
    calls! {
        /// Sets the time.
        ///
        /// # Errors
        /// The FMU refuses.
        set_time(time: f64) -> ();
        /// Sets the continuous states.
        ///
        /// # Errors
        /// The slice has not the length of the state vector; the FMU refuses.
        set_continuous_states(states: &[f64]) -> ();
        /// Sets time and states, and computes the derivatives: what an integrator wants, in one go. Inputs
        /// stay as they are.
        ///
        /// # Errors
        /// A slice has not the length of the state vector; the FMU refuses.
        right_hand_side(time: f64, states: &[f64], derivatives: &mut [f64]) -> ();
    }

    /// Says that a step has been completed, and that the instance will not be taken back behind it. Returns
    /// whether the model wants to enter event mode, and whether it wants to end the simulation.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn completed_integrator_step(&mut self) -> Result<(bool, bool)> {
        self.core().progress.before_inputs = None;
        self.core().call(RawInstance::completed_integrator_step)
    }

    /// Enters event mode.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn enter_event_mode(self) -> Result<Instance<EventMode>> {
        self.step_to(RawInstance::enter_event_mode)
    }
}
