//! An instance of an FMU that is driven call by call, in any of its phases. Calls and answers are values that
//! can be sent to another process.

use crate::error::{FmiError, Result};
use crate::fmu::Fmu;
use crate::instance::{
    CoSimulation, ContinuousTime, EventMode, Initialization, Instance, Instantiated, Integrated,
    Linearization, MAX_EVENT_ITERATIONS, SavedState, StepMode, StepOutcome, Terminated,
};
use crate::macros::words;
use crate::simulators::InstanceOptions;
use crate::sys::InterfaceKind;
use crate::value::Value;
use base::RunContext;
use ode::{EventOutcome, Method, Observer, Options, Sample};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::ControlFlow;

/// Reason reported if the instance was freed after a call into the FMU failed.
const LOST: &str = "the instance was freed because a call into it failed; create a new instance";

/// A call of a [`DrivenInstance`]. The input vector is passed separately.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub enum InstanceCall {
    /// Returns the phase; answered with [`InstanceAnswer::Phase`].
    Phase,
    /// Returns the time of the next time event or tick; answered with [`InstanceAnswer::Time`].
    NextEvent,
    /// Reads variables; answered with [`InstanceAnswer::Values`].
    Get(Vec<String>),
    /// Sets variables in the given order.
    Set(Vec<(String, Value)>),
    /// Sets the experiment up and enters initialization mode.
    EnterInitialization {
        /// Start time.
        start_time: f64,
        /// Stop time, if it should be passed to the FMU.
        stop_time: Option<f64>,
        /// Relative tolerance, if it should be passed to the FMU.
        tolerance: Option<f64>,
    },
    /// Ends the initialization.
    ExitInitialization,
    /// Updates the discrete states until they settle; answered with [`InstanceAnswer::Events`].
    UpdateDiscreteStates,
    /// Enters continuous-time mode.
    EnterContinuousTime,
    /// Enters event mode.
    EnterEventMode,
    /// Sets the time.
    SetTime(f64),
    /// Sets the continuous states to the vector.
    SetStates,
    /// Returns the continuous states in the vector.
    States,
    /// Returns the derivatives of the states in the vector.
    Derivatives,
    /// Returns the nominal values of the states in the vector.
    Nominals,
    /// Returns the event indicators in the vector.
    EventIndicators,
    /// Returns the names of the states; answered with [`InstanceAnswer::Names`].
    StateNames,
    /// Completes a step of an integrator; answered with [`InstanceAnswer::StepEnd`].
    CompletedIntegratorStep,
    /// Integrates to `end`; answered with [`InstanceAnswer::Reached`].
    Integrate {
        /// Current time of the instance.
        start: f64,
        /// End of the integration.
        end: f64,
        /// Integration method.
        method: Method,
        /// Relative tolerance of the adaptive methods.
        relative_tolerance: f64,
        /// Step size of the fixed-step methods.
        step_size: Option<f64>,
    },
    /// Performs a co-simulation step; answered with [`InstanceAnswer::Step`].
    DoStep {
        /// Current time of the instance.
        time: f64,
        /// Length of the step.
        step: f64,
    },
    /// Handles the events of a co-simulation at this time; answered with [`InstanceAnswer::Events`].
    HandleEvents(f64),
    /// Sets the derivatives of these inputs. The vector contains their values.
    SetInputDerivatives(Vec<u32>),
    /// Multiplies the input vector by the derivatives. Returns the result, of length `n`, in the vector.
    Derivative {
        /// Value references of the unknowns.
        unknowns: Vec<u32>,
        /// Value references of the knowns.
        knowns: Vec<u32>,
        /// Length of the result.
        n: usize,
        /// Requests the adjoint derivative instead of the directional derivative.
        is_adjoint: bool,
    },
    /// Linearizes the model; answered with [`InstanceAnswer::Linearization`]. If true, finite differences are
    /// always used.
    Linearize(bool),
    /// Saves the state; answered with [`InstanceAnswer::State`]. Drops the states with these numbers first,
    /// so that their memory can be reused.
    SaveState(Vec<u64>),
    /// Restores the state with this number.
    RestoreState(u64),
    /// Switches logging on or off, for these categories. An empty list means all categories.
    SetLogging(bool, Vec<String>),
    /// Returns the last lines of the log; answered with [`InstanceAnswer::Log`].
    Log,
    /// Ends the simulation.
    Terminate,
    /// Resets the instance to the phase after instantiation.
    Reset,
    /// Frees the instance.
    Close,
}

/// Answer to an [`InstanceCall`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum InstanceAnswer {
    /// The call succeeded. Its result, if any, is in the vector.
    Done,
    /// The phase.
    Phase(InstancePhase),
    /// A time, if there is one.
    Time(Option<f64>),
    /// Values in the order of the names.
    Values(Vec<Value>),
    /// Result of an event iteration.
    Events(EventOutcome),
    /// True if the model requests event mode, and true if it requests the end of the simulation.
    StepEnd(bool, bool),
    /// Time reached, and true if the model ended the simulation at that time.
    Reached(f64, bool),
    /// Result of a step.
    Step(StepOutcome),
    /// Names of the states that are variables.
    Names(Vec<Option<String>>),
    /// The linear system.
    Linearization(Linearization),
    /// Number of a saved state.
    State(u64),
    /// Lines of the log, and number of dropped lines.
    Log(Vec<String>, u64),
}

words! {
    /// Phase of a [`DrivenInstance`].
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    pub enum InstancePhase {
        /// Instantiated or reset.
        Instantiated = "instantiated",
        /// Initialization mode.
        Initialization = "initialization",
        /// Event mode (model exchange).
        Event = "event",
        /// Continuous-time mode (model exchange).
        Continuous = "continuous",
        /// Between two steps (co-simulation).
        Step = "step",
        /// The simulation has ended.
        Terminated = "terminated",
        /// Freed.
        Closed = "closed",
    }
}

/// An instance with its phase.
#[derive(Debug)]
enum State {
    Made(Instance<Instantiated>),
    Initialization(Instance<Initialization>),
    Event(Instance<EventMode>),
    Continuous(Instance<ContinuousTime>),
    Terminated(Instance<Terminated>),
    SlaveMade(Instance<Instantiated, CoSimulation>),
    SlaveInitialization(Instance<Initialization, CoSimulation>),
    Step(Instance<StepMode, CoSimulation>),
    SlaveTerminated(Instance<Terminated, CoSimulation>),
    /// Freed, with the reason.
    Freed(&'static str),
}

impl State {
    fn phase(&self) -> InstancePhase {
        match self {
            Self::Made(_) | Self::SlaveMade(_) => InstancePhase::Instantiated,
            Self::Initialization(_) | Self::SlaveInitialization(_) => InstancePhase::Initialization,
            Self::Event(_) => InstancePhase::Event,
            Self::Continuous(_) => InstancePhase::Continuous,
            Self::Step(_) => InstancePhase::Step,
            Self::Terminated(_) | Self::SlaveTerminated(_) => InstancePhase::Terminated,
            Self::Freed(_) => InstancePhase::Closed,
        }
    }

    /// Returns the error for a call that is not allowed in the current phase.
    fn refuse(&self, call: &'static str, needed: &'static str) -> FmiError {
        match self {
            Self::Freed(reason) => FmiError::Freed(reason),
            other => FmiError::WrongPhase { call, phase: other.phase().name(), needed },
        }
    }
}

/// Runs an expression with the instance if it is in one of these phases. Otherwise, the call is rejected.
macro_rules! within {
    ($state:expr, $call:literal, $needed:literal, [$($phase:ident),+], $instance:ident => $body:expr) => {
        match &mut $state {
            $(State::$phase($instance) => $body,)+
            #[allow(unreachable_patterns)]
            other => Err(other.refuse($call, $needed)),
        }
    };
}

/// Runs an expression with the instance in any phase.
macro_rules! anywhere {
    ($state:expr, $instance:ident => $body:expr) => {
        within!($state, "", "", [
            Made, Initialization, Event, Continuous, Terminated, SlaveMade, SlaveInitialization, Step, SlaveTerminated
        ], $instance => $body)
    };
}

/// Runs an expression with the instance in the phases in which values can be read.
macro_rules! readable {
    ($state:expr, $call:literal, $instance:ident => $body:expr) => {
        within!($state, $call, "initialization or later", [
            Initialization, Event, Continuous, Terminated, SlaveInitialization, Step, SlaveTerminated
        ], $instance => $body)
    };
}

/// Moves the instance from one phase to another. If that fails, the instance is freed.
macro_rules! lead {
    ($state:expr, $call:literal, $needed:literal, {$($from:ident => $to:ident),+}, $instance:ident => $body:expr) => {
        match std::mem::replace(&mut $state, State::Freed(LOST)) {
            $(State::$from($instance) => {
                $state = State::$to($body?);
                Ok(InstanceAnswer::Done)
            })+
            other => {
                let refusal = other.refuse($call, $needed);
                $state = other;
                Err(refusal)
            }
        }
    };
}

/// An instance that is driven call by call. Calls that are not allowed in the current phase are rejected. If
/// a call that changes the phase fails, the instance is freed.
#[derive(Debug)]
pub struct DrivenInstance {
    state: State,
    /// Saved states by their numbers.
    saved: BTreeMap<u64, SavedState>,
    n_saved: u64,
}

impl DrivenInstance {
    /// Reason reported for a closed instance.
    pub const CLOSED: &'static str = "the instance has been closed";

    /// Creates an instance. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::instantiate`].
    pub fn new(fmu: &Fmu, kind: InterfaceKind, options: &InstanceOptions) -> Result<Self> {
        let state = match kind {
            InterfaceKind::ModelExchange => State::Made(fmu.instantiate_with(options)?),
            InterfaceKind::CoSimulation => State::SlaveMade(fmu.instantiate_co_simulation(options)?),
        };
        Ok(Self { state, saved: BTreeMap::new(), n_saved: 0 })
    }

    /// Creates an instance already freed for this reason. Calls that require the instance fail with this
    /// reason.
    pub fn freed(reason: &'static str) -> Self {
        Self { state: State::Freed(reason), saved: BTreeMap::new(), n_saved: 0 }
    }

    /// Performs a call. `given` is the input vector; a returned vector is stored in `vector`. An integration
    /// ends with [`FmiError::Cancelled`] when the run context ends.
    ///
    /// # Errors
    /// Returns [`FmiError::WrongPhase`], [`FmiError::Freed`], and the errors of the corresponding method of
    /// [`Instance`].
    pub fn call(
        &mut self,
        call: InstanceCall,
        given: &[f64],
        vector: &mut Vec<f64>,
        context: &RunContext<'_>,
    ) -> Result<InstanceAnswer> {
        use InstanceAnswer as Answer;
        use InstanceCall as Call;
        let state = &mut self.state;
        match call {
            Call::Phase => Ok(Answer::Phase(state.phase())),
            Call::NextEvent => {
                let next = anywhere!(*state, instance => Ok::<_, FmiError>(instance.next_event()));
                Ok(Answer::Time(next.unwrap_or(None)))
            }
            Call::Get(names) => {
                let get = |name: &String| readable!(*state, "get", instance => instance.get(name));
                names.iter().map(get).collect::<Result<_>>().map(Answer::Values)
            }
            Call::Set(pairs) => {
                let set = |(name, value): (String, Value)| anywhere!(*state, instance => instance.set(&name, value));
                done(pairs.into_iter().try_for_each(set))
            }
            Call::EnterInitialization { start_time, stop_time, tolerance } => {
                lead!(*state, "enter_initialization", "instantiated", {
                    Made => Initialization, SlaveMade => SlaveInitialization
                }, instance => instance.enter_initialization(start_time, stop_time, tolerance))
            }
            Call::ExitInitialization => lead!(*state, "exit_initialization", "initialization", {
                Initialization => Event, SlaveInitialization => Step
            }, instance => instance.exit_initialization()),
            Call::UpdateDiscreteStates => within!(*state, "update_discrete_states", "event", [Event],
                instance => instance.update_discrete_states(MAX_EVENT_ITERATIONS))
            .map(Answer::Events),
            Call::EnterContinuousTime => lead!(*state, "enter_continuous_time", "event", {
                Event => Continuous
            }, instance => instance.enter_continuous_time()),
            Call::EnterEventMode => lead!(*state, "enter_event_mode", "continuous", {
                Continuous => Event
            }, instance => instance.enter_event_mode()),
            Call::SetTime(time) => done(within!(*state, "set_time", "continuous", [Continuous],
                instance => instance.set_time(time))),
            Call::SetStates => done(within!(*state, "setting the states", "continuous", [Continuous],
                instance => instance.set_continuous_states(given))),
            Call::States => {
                done(within!(*state, "reading the states", "event or continuous", [Event, Continuous],
                instance => instance.get_continuous_states(sized(vector, instance.fmu().description().n_states()))))
            }
            Call::Derivatives => {
                done(within!(*state, "derivatives", "event or continuous", [Event, Continuous],
                instance => instance.get_derivatives(sized(vector, instance.fmu().description().n_states()))))
            }
            Call::Nominals => done(within!(*state, "nominals", "event or continuous", [Event, Continuous],
                instance => instance.get_nominals(sized(vector, instance.fmu().description().n_states())))),
            Call::EventIndicators => {
                done(within!(*state, "event_indicators", "event or continuous", [Event, Continuous],
                instance => instance.get_event_indicators(sized(vector, instance.fmu().description().n_event_indicators))))
            }
            Call::StateNames => within!(*state, "state_names", "initialization or later",
                [Initialization, Event, Continuous, Terminated], instance => instance.state_names())
            .map(Answer::Names),
            Call::CompletedIntegratorStep => {
                within!(*state, "completed_integrator_step", "continuous", [Continuous],
                    instance => instance.completed_integrator_step())
                .map(|(event, terminate)| Answer::StepEnd(event, terminate))
            }
            Call::Integrate { start, end, method, relative_tolerance, step_size } => {
                let options = Options { method, relative_tolerance, step_size, ..Options::default() };
                self.integrate(start, end, options, context)
            }
            Call::DoStep { time, step } => within!(*state, "do_step", "step", [Step],
                instance => instance.do_step(time, step))
            .map(Answer::Step),
            Call::HandleEvents(time) => within!(*state, "handle_events", "step", [Step],
                instance => instance.handle_events(time))
            .map(Answer::Events),
            Call::SetInputDerivatives(references) => {
                done(within!(*state, "set_input_derivatives", "step", [Step],
                instance => instance.set_input_derivatives(&references, given)))
            }
            Call::Derivative { unknowns, knowns, n, is_adjoint: false } => {
                done(readable!(*state, "directional_derivative",
                    instance => instance.directional_derivative(&unknowns, &knowns, given, sized(vector, n))))
            }
            Call::Derivative { unknowns, knowns, n, is_adjoint: true } => {
                done(readable!(*state, "adjoint_derivative",
                    instance => instance.adjoint_derivative(&unknowns, &knowns, given, sized(vector, n))))
            }
            Call::Linearize(differences) => within!(*state, "linearize", "continuous", [Continuous],
                instance => instance.linearize(differences))
            .map(Answer::Linearization),
            Call::SaveState(dropped) => {
                self.saved.retain(|number, _| !dropped.contains(number));
                let saved = anywhere!(*state, instance => instance.save_state())?;
                self.n_saved += 1;
                self.saved.insert(self.n_saved, saved);
                Ok(Answer::State(self.n_saved))
            }
            Call::RestoreState(number) => {
                let saved = self.saved.get(&number);
                done(
                    anywhere!(*state, instance => instance.restore_state(saved.ok_or(FmiError::ForeignState)?)),
                )
            }
            Call::SetLogging(on, categories) => {
                done(anywhere!(*state, instance => match categories.is_empty() {
                    true => instance.set_logging(on),
                    false => instance.log_categories(&categories),
                }))
            }
            Call::Log => {
                let (lines, left_out) = anywhere!(*state, instance => Ok::<_, FmiError>(instance.log()))?;
                Ok(Answer::Log(lines.iter().map(ToString::to_string).collect(), left_out))
            }
            Call::Terminate => lead!(*state, "terminate", "event, continuous or step", {
                Event => Terminated, Continuous => Terminated, Step => SlaveTerminated
            }, instance => instance.terminate()),
            Call::Reset => lead!(*state, "reset", "", {
                Made => Made, Initialization => Made, Event => Made, Continuous => Made, Terminated => Made,
                SlaveMade => SlaveMade, SlaveInitialization => SlaveMade, Step => SlaveMade,
                SlaveTerminated => SlaveMade
            }, instance => instance.reset()),
            Call::Close => {
                *state = State::Freed(Self::CLOSED);
                Ok(Answer::Done)
            }
        }
    }

    /// Integrates an instance in continuous-time mode.
    fn integrate(
        &mut self,
        start: f64,
        end: f64,
        options: Options,
        context: &RunContext<'_>,
    ) -> Result<InstanceAnswer> {
        // Checked before the instance is taken, because a wrong argument must not free the instance.
        options.check()?;
        let instance = match std::mem::replace(&mut self.state, State::Freed(LOST)) {
            State::Continuous(instance) => instance,
            other => {
                let refusal = other.refuse("do_step", "continuous");
                self.state = other;
                return Err(refusal);
            }
        };
        match instance.integrate_until(start, end, options, &mut Until(context))? {
            Integrated::Reached { instance } => {
                self.state = State::Continuous(instance);
                Ok(InstanceAnswer::Reached(end, false))
            }
            Integrated::Ended { instance, time } => {
                self.state = State::Event(instance);
                Ok(InstanceAnswer::Reached(time, true))
            }
        }
    }
}

fn done(outcome: Result<()>) -> Result<InstanceAnswer> {
    outcome.map(|()| InstanceAnswer::Done)
}

/// Resizes the vector to `n` zeros.
fn sized(vector: &mut Vec<f64>, n: usize) -> &mut [f64] {
    vector.clear();
    vector.resize(n, 0.0);
    vector
}

/// Ends an integration when the run context ends.
struct Until<'a>(&'a RunContext<'a>);

impl Observer for Until<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        if self.0.is_over() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
