//! One component of an FMU: the sole owner of its pointer, with every call checked before and after.

use super::buffers::ValueBuffers;
use super::fault::{Failed, Fault, Outcome, Sizes};
use super::slots::SavedStates;
use crate::description::Interval;
use crate::error::{FmiError, LogLine, Status};
use crate::sys::call::Call;
use crate::sys::callbacks::Callbacks;
use crate::sys::environment::{CallEnvironment, OneCall, restore_default};
use crate::sys::library::Library;
use crate::sys::types::{Component, EventInfo, Experiment, IntervalAnswer, Qualifier, Request};
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::Arc;

/// Log lines that an error carries.
const LINES_IN_ERRORS: usize = 8;

/// So many right-hand sides of a component are looked at call by call, for what the calls do to the floating-point mode.
const LOOKED_INTO: u8 = 8;

/// A live component.
pub(crate) struct RawInstance {
    pub(super) component: Component,
    /// After `Fatal`: nothing is called any more.
    pub(super) dead: bool,
    pub(super) sizes: Sizes,
    /// Co-simulation: made to have its events handled between steps.
    pub(super) event_mode: bool,
    /// A reference may stand for several values.
    pub(super) has_arrays: bool,
    /// For messages: the time last set.
    pub(super) time: Option<f64>,
    /// Right-hand sides that are still looked at call by call.
    pub(super) to_look_into: u8,
    pub(super) saved: SavedStates,
    pub(super) buffers: Box<ValueBuffers>,
    pub(super) orders: Vec<i32>,
    // What the component may reach; given up by hand, after it, and not at all when it is dead.
    pub(super) callbacks: ManuallyDrop<Callbacks>,
    pub(super) library: ManuallyDrop<Arc<Library>>,
}

// SAFETY: the component and its saved states are owned by this value alone and all calls take `&mut self`, so calls never
// overlap, and the pointers of its buffers are followed during a call only; FMI lets the calls of an instance come from different threads one after the other (FMI 2.0.x, section 2.1.1).
// All other fields are `Send` by themselves. `Sync` stays absent.
unsafe impl Send for RawInstance {}

impl std::fmt::Debug for RawInstance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RawInstance")
            .field("dead", &self.dead)
            .field("time", &self.time)
            .finish_non_exhaustive()
    }
}

impl RawInstance {
    /// Makes a component.
    pub(crate) fn new(library: &Arc<Library>, request: &Request<'_>, sizes: Sizes) -> Result<Self, FmiError> {
        if library.shared().is_fatal() {
            return Err(FmiError::LibraryUnusable { library: library.path().to_owned() });
        }
        let _environment = CallEnvironment::enter();
        let callbacks = library.callbacks(request.log_filter);
        // SAFETY: the callbacks are never freed: they are leaked, or go back to the library.
        let component = unsafe { library.binding().instantiate(request, &callbacks) };
        if component.is_null() {
            let (log, dropped) = callbacks.log().last(LINES_IN_ERRORS);
            library.retire(callbacks);
            return Err(FmiError::from(Failed {
                call: library.binding().name(Call::Instantiate),
                status: Status::Error,
                time: None,
                log,
                dropped,
            }));
        }
        library.shared().set_used();
        Ok(Self {
            component,
            dead: false,
            sizes,
            event_mode: request.event_mode,
            has_arrays: library.binding().values().has_arrays(),
            time: None,
            to_look_into: LOOKED_INTO,
            saved: SavedStates::default(),
            buffers: Box::default(),
            orders: Vec::new(),
            callbacks: ManuallyDrop::new(callbacks),
            library: ManuallyDrop::new(Arc::clone(library)),
        })
    }

    /// Whether a call of this instance, or of another of the same loaded copy of the library, returned `Fatal`.
    pub(crate) fn is_dead(&self) -> bool {
        self.dead || self.library.shared().is_fatal()
    }

    /// The file of its library.
    pub(crate) fn library_path(&self) -> PathBuf {
        self.library.path().to_owned()
    }

    /// Co-simulation: whether it was made to have its events handled between steps.
    pub(crate) fn has_event_mode(&self) -> bool {
        self.event_mode
    }

    /// The time last set.
    pub(crate) fn time(&self) -> Option<f64> {
        self.time
    }

    /// The last lines the FMU logged, and how many earlier ones were dropped.
    pub(crate) fn log(&self) -> (Vec<LogLine>, u64) {
        self.callbacks.log().last(usize::MAX)
    }

    /// Forgets the log.
    pub(crate) fn clear_log(&mut self) {
        self.callbacks.log().clear();
    }

    /// What an error about `call` carries.
    pub(crate) fn failed(&self, call: &'static str, status: Status) -> Failed {
        let (log, dropped) = self.callbacks.log().last(LINES_IN_ERRORS);
        Failed { call, status, time: self.time, log, dropped }
    }

    /// The one place where a status becomes a result.
    pub(super) fn check(&mut self, call: Call, status: Status) -> Outcome {
        match status {
            Status::Ok | Status::Warning => Ok(()),
            _ => self.not_ok(call, status),
        }
    }

    #[cold]
    fn not_ok(&mut self, call: Call, status: Status) -> Outcome {
        let name = self.library.binding().name(call);
        match status {
            Status::Ok | Status::Warning => Ok(()),
            Status::Discard => Err(Fault::Discard(name)),
            Status::Missing => Err(Fault::Missing(name)),
            Status::Fatal => {
                self.dead = true;
                self.library.shared().set_fatal();
                Err(Fault::Failed(Box::new(self.failed(name, status))))
            }
            Status::Error | Status::Pending | Status::Unknown(_) => {
                Err(Fault::Failed(Box::new(self.failed(name, status))))
            }
        }
    }

    /// Refuses calls on a dead component, or into a library that is not to be trusted any more.
    #[inline]
    pub(super) fn alive(&self, call: Call) -> Outcome {
        if self.dead || self.library.shared().is_fatal() { self.not_alive(call) } else { Ok(()) }
    }

    #[cold]
    fn not_alive(&self, call: Call) -> Outcome {
        match self.dead {
            true => {
                Err(Fault::Failed(Box::new(self.failed(self.library.binding().name(call), Status::Fatal))))
            }
            false => Err(Fault::Unusable(self.library_path())),
        }
    }

    /// As many values as references, or more where references may stand for arrays (how many is the caller's to know:
    /// the FMU is told the number of values).
    pub(super) fn lengths(&self, call: Call, references: usize, values: usize) -> Outcome {
        if self.has_arrays { Ok(()) } else { self.length(call, references, values) }
    }

    pub(super) fn length(&self, call: Call, expected: usize, found: usize) -> Outcome {
        if expected == found {
            Ok(())
        } else {
            Err(Fault::Length { call: self.library.binding().name(call), expected, found })
        }
    }
}

impl RawInstance {
    pub(crate) fn set_debug_logging(&mut self, on: bool) -> Outcome {
        run!(self, Call::SetDebugLogging, |b, c| b.set_debug_logging(c, on))
    }

    pub(crate) fn setup_experiment(&mut self, experiment: &Experiment) -> Outcome {
        self.time = Some(experiment.start);
        run!(self, Call::SetupExperiment, |b, c| b.setup_experiment(c, experiment))
    }

    pub(crate) fn enter_initialization(&mut self, experiment: &Experiment) -> Outcome {
        run!(self, Call::EnterInitialization, |b, c| b.enter_initialization(c, experiment))
    }

    pub(crate) fn enter_configuration(&mut self) -> Outcome {
        run!(self, Call::EnterConfiguration, |b, c| b.enter_configuration(c))
    }

    pub(crate) fn exit_configuration(&mut self) -> Outcome {
        run!(self, Call::ExitConfiguration, |b, c| b.exit_configuration(c))
    }

    /// The sizes of the model's vectors as the FMU says them now, where it has a say.
    pub(crate) fn ask_sizes(&mut self) -> Result<Option<Sizes>, Fault> {
        let Sizes { mut states, mut indicators } = self.sizes;
        match run!(self, Call::CountStates, |b, c| b.count_states(c, &mut states)) {
            Err(Fault::Missing(_)) => return Ok(None),
            outcome => outcome?,
        }
        run!(self, Call::CountIndicators, |b, c| b.count_indicators(c, &mut indicators))?;
        Ok(Some(Sizes { states, indicators }))
    }

    /// Changes the sizes of the model's vectors, after the structure of the model was.
    pub(crate) fn set_sizes(&mut self, sizes: Sizes) {
        self.sizes = sizes;
    }

    pub(crate) fn exit_initialization(&mut self) -> Outcome {
        run!(self, Call::ExitInitialization, |b, c| b.exit_initialization(c))
    }

    pub(crate) fn terminate(&mut self) -> Outcome {
        // Most often between two runs, where nobody else looks at the process.
        let _environment = CallEnvironment::enter();
        run!(self, Call::Terminate, |b, c| b.terminate(c))
    }

    pub(crate) fn reset(&mut self) -> Outcome {
        let _environment = CallEnvironment::enter();
        self.time = None;
        run!(self, Call::Reset, |b, c| b.reset(c))
    }

    pub(crate) fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Outcome {
        self.lengths(Call::DirectionalDerivative, knowns.len(), seed.len())?;
        self.lengths(Call::DirectionalDerivative, unknowns.len(), sensitivity.len())?;
        run!(self, Call::DirectionalDerivative, |b, c| {
            b.directional_derivative(c, unknowns, knowns, seed, sensitivity)
        })
    }

    pub(crate) fn enter_event_mode(&mut self) -> Outcome {
        run!(self, Call::EnterEventMode, |b, c| b.enter_event_mode(c))
    }

    pub(crate) fn new_discrete_states(&mut self, info: &mut EventInfo) -> Outcome {
        self.callbacks.log().go_on();
        run!(self, Call::NewDiscreteStates, |b, c| b.new_discrete_states(c, info))
    }

    pub(crate) fn enter_continuous_time_mode(&mut self) -> Outcome {
        run!(self, Call::EnterContinuousTimeMode, |b, c| b.enter_continuous_time_mode(c))
    }

    /// Returns whether the model wants an event, and whether it wants to end.
    pub(crate) fn completed_integrator_step(&mut self) -> Result<(bool, bool), Fault> {
        self.callbacks.log().go_on();
        let (mut event, mut terminate) = (false, false);
        let no_set_state_prior = !self.saved.may_be_restored();
        run!(self, Call::CompletedIntegratorStep, |b, c| {
            b.completed_integrator_step(c, no_set_state_prior, &mut event, &mut terminate)
        })?;
        Ok((event, terminate))
    }

    pub(crate) fn set_time(&mut self, time: f64) -> Outcome {
        self.callbacks.log().go_on();
        self.time = Some(time);
        run!(self, Call::SetTime, |b, c| b.set_time(c, time))
    }

    pub(crate) fn set_continuous_states(&mut self, states: &[f64]) -> Outcome {
        self.length(Call::SetContinuousStates, self.sizes.states, states.len())?;
        run!(self, Call::SetContinuousStates, |b, c| b.set_continuous_states(c, states))
    }

    pub(crate) fn get_continuous_states(&mut self, states: &mut [f64]) -> Outcome {
        self.length(Call::GetContinuousStates, self.sizes.states, states.len())?;
        run!(self, Call::GetContinuousStates, |b, c| b.get_continuous_states(c, states))
    }

    /// The derivatives at a point: sets the time, then the states, and reads them.
    pub(crate) fn right_hand_side(&mut self, time: f64, states: &[f64], derivatives: &mut [f64]) -> Outcome {
        self.length(Call::SetContinuousStates, self.sizes.states, states.len())?;
        self.length(Call::GetDerivatives, self.sizes.states, derivatives.len())?;
        self.alive(Call::SetTime)?;
        self.callbacks.log().go_on();
        self.time = Some(time);
        let one = OneCall::enter();
        let (mut looks_into, mut changes) = (self.to_look_into > 0, false);
        let (call, status) = loop {
            // SAFETY: the component is alive and ours alone (`&mut self`), both slices have as many places as it has
            // states.
            let answer = unsafe {
                let looks = looks_into.then_some(&mut changes);
                self.library.binding().right_hand_side(self.component, time, states, derivatives, looks)
            };
            changes |= restore_default();
            if looks_into || !changes {
                break answer;
            }
            // One of the calls has changed the mode, which may have acted in those after it.
            looks_into = true;
        };
        one.forget();
        if changes {
            self.to_look_into = u8::MAX;
        } else if looks_into && self.to_look_into < u8::MAX {
            // Who changes the mode does so from the first; looking takes as long as the calls of a small model.
            self.to_look_into -= 1;
        }
        self.check(call, status)
    }

    pub(crate) fn get_derivatives(&mut self, derivatives: &mut [f64]) -> Outcome {
        self.length(Call::GetDerivatives, self.sizes.states, derivatives.len())?;
        run!(self, Call::GetDerivatives, |b, c| b.get_derivatives(c, derivatives))
    }

    pub(crate) fn get_event_indicators(&mut self, indicators: &mut [f64]) -> Outcome {
        self.length(Call::GetEventIndicators, self.sizes.indicators, indicators.len())?;
        run!(self, Call::GetEventIndicators, |b, c| b.get_event_indicators(c, indicators))
    }

    pub(crate) fn get_nominals(&mut self, nominals: &mut [f64]) -> Outcome {
        self.length(Call::GetNominals, self.sizes.states, nominals.len())?;
        run!(self, Call::GetNominals, |b, c| b.get_nominals(c, nominals))
    }

    /// What the model says about the interval before the next tick of a clock.
    pub(crate) fn get_interval(&mut self, clock: u32, fraction: bool) -> Result<IntervalAnswer, Fault> {
        let mut answer =
            IntervalAnswer { qualifier: Qualifier::NotYetKnown, interval: Interval::Decimal(0.0) };
        run!(self, Call::GetInterval(fraction), |b, c| b.get_interval(c, clock, fraction, &mut answer))?;
        Ok(answer)
    }

    /// Gives a clock an interval.
    pub(crate) fn set_interval(&mut self, clock: u32, interval: Interval) -> Outcome {
        let fraction = matches!(interval, Interval::Fraction(..));
        run!(self, Call::SetInterval(fraction), |b, c| b.set_interval(c, clock, interval))
    }

    /// From the start to the first tick of a clock.
    pub(crate) fn get_shift(&mut self, clock: u32, fraction: bool, shift: &mut Interval) -> Outcome {
        run!(self, Call::GetShift(fraction), |b, c| b.get_shift(c, clock, fraction, shift))
    }
}

impl Drop for RawInstance {
    fn drop(&mut self) {
        if self.is_dead() {
            // Invariant 6: no further call, and what the component may still reach is leaked: library, callbacks, log.
            return;
        }
        let _environment = CallEnvironment::enter();
        let binding = self.library.binding();
        // SAFETY: the component is alive and made these states.
        unsafe { self.saved.free(binding, self.component) };
        // SAFETY: the component is alive, ours alone, and gone after this.
        unsafe { binding.free_instance(self.component) };
        // SAFETY: both are given up once; the library last.
        unsafe {
            self.library.retire(ManuallyDrop::take(&mut self.callbacks));
            ManuallyDrop::drop(&mut self.library);
        }
    }
}
