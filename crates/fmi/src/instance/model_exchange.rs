//! The two running modes of model exchange: event mode with its iteration, and continuous-time mode.

use super::core::Core;
use super::phases::{ContinuousTime, EventMode, Instance, Readable, Running, Terminated};
use crate::error::{FmiError, Result};
use crate::sys::{EventInfo, RawInstance};
use ode::EventOutcome;

/// Maximum number of rounds of an event iteration before it counts as endless.
pub const MAX_EVENT_ITERATIONS: u32 = 100;

impl Core {
    /// Updates the discrete states until they settle.
    ///
    /// Flags that the model reports in any round are combined. A next event time equal to `time` causes one
    /// more round, even if it is earlier by at most `tolerance`. This does not apply to co-simulation with
    /// event mode, because the model keeps its own time there. A next event time earlier than `time -
    /// tolerance` is returned unchanged. `before_round` inspects the model before each round, and may end the
    /// iteration.
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
    /// Returns the names of the continuous states, in the order of the state vector. A name is `None` for a
    /// state that is not a variable. In FMI 1.0 the FMU reports the states (`fmiGetStateValueReferences`),
    /// and its answer may change after an event. In later versions the description defines them.
    ///
    /// # Errors
    /// Returns an error if the FMU returns one or has no such function.
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
        /// Returns an error if the length of the slice differs from the length of the state vector, or if the
        /// FMU returns an error.
        get_continuous_states(states: &mut [f64]) -> ();
        /// Computes the event indicators.
        ///
        /// # Errors
        /// Returns an error if the length of the slice differs from the number of indicators, or if the FMU
        /// returns an error.
        get_event_indicators(indicators: &mut [f64]) -> ();
        /// Computes the derivatives of the states.
        ///
        /// # Errors
        /// Returns an error if the length of the slice differs from the length of the state vector, or if the
        /// FMU returns an error.
        get_derivatives(derivatives: &mut [f64]) -> ();
        /// Reads the nominal values of the states as reported by the FMU.
        ///
        /// # Errors
        /// Returns an error if the length of the slice differs from the length of the state vector, or if the
        /// FMU returns an error.
        get_nominals(nominals: &mut [f64]) -> ();
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn terminate(self) -> Result<Instance<Terminated>> {
        self.step_to(RawInstance::terminate)
    }
}

impl Instance<EventMode> {
    /// Updates the discrete states until they settle, in at most `limit` rounds (see
    /// [`MAX_EVENT_ITERATIONS`]). Clocks with known intervals tick when they are due. The caller must set
    /// triggered clocks.
    ///
    /// # Errors
    /// Returns [`FmiError::EventIteration`] if the states do not settle. Also returns an error if the FMU
    /// does.
    pub fn update_discrete_states(&mut self, limit: u32) -> Result<EventOutcome> {
        let core = self.core();
        let time = core.raw.time().unwrap_or(0.0);
        core.settle_events(time, core.progress.time_tolerance(time), limit)
    }

    /// Enters continuous-time mode.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn enter_continuous_time(self) -> Result<Instance<ContinuousTime>> {
        self.step_to(RawInstance::enter_continuous_time_mode)
    }
}

impl Instance<ContinuousTime> {
    calls! {
        /// Sets the time.
        ///
        /// # Errors
        /// Returns an error if the FMU does.
        set_time(time: f64) -> ();
        /// Sets the continuous states.
        ///
        /// # Errors
        /// Returns an error if the length of the slice differs from the length of the state vector, or if the
        /// FMU returns an error.
        set_continuous_states(states: &[f64]) -> ();
        /// Sets the time and the states, and computes the derivatives. An integrator needs these three calls
        /// for each evaluation. Inputs stay unchanged.
        ///
        /// # Errors
        /// Returns an error if the length of a slice differs from the length of the state vector, or if the
        /// FMU returns an error.
        right_hand_side(time: f64, states: &[f64], derivatives: &mut [f64]) -> ();
    }

    /// Reports to the model that a step is complete and that the instance will not return to an earlier time.
    /// The first flag is true if the model requests event mode, the second if it requests the end of the
    /// simulation.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn completed_integrator_step(&mut self) -> Result<(bool, bool)> {
        self.core().progress.before_inputs = None;
        self.core().call(RawInstance::completed_integrator_step)
    }

    /// Enters event mode.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn enter_event_mode(self) -> Result<Instance<EventMode>> {
        self.step_to(RawInstance::enter_event_mode)
    }
}
