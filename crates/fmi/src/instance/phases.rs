//! The phases of an instance as types, and the operations available in each phase.

use super::assignments::{self, Assignments};
use super::core::Core;
use super::progress::{Progress, note};
use crate::description::{Causality, Structure, Value, Variable, VariableKind};
use crate::error::{FmiError, LogLine, Result};
use crate::fmu::Fmu;
use crate::libraries::LoadedLibrary;
use crate::sys::{Direction, ElementDependency, Experiment, Fault, RawInstance, SavedSlot};
use std::marker::PhantomData;
use std::sync::Arc;

/// Instance of an FMU in the phase `P`, for model exchange or co-simulation.
///
/// An instance can be moved to another thread but not shared ([`Send`], not `Sync`). A phase change consumes
/// the instance and returns it in its new phase. If the FMU returns an error, the instance is freed, and the
/// error contains the FMU's last log lines. After `fatal` the instance is abandoned, because FMI forbids
/// freeing it.
///
/// After any other call has returned `error`, only [`reset`](Instance::reset) and
/// [`restore_state`](Instance::restore_state) are allowed. All other calls return [`FmiError::AfterError`].
#[derive(Debug)]
pub struct Instance<P, K = ModelExchange> {
    core: Box<Core>,
    _phase: PhantomData<(P, K)>,
}

/// Kind of an instance whose equations the importer integrates.
#[derive(Debug)]
pub enum ModelExchange {}
/// Kind of an instance that integrates itself.
#[derive(Debug)]
pub enum CoSimulation {}

/// Phase of an [`Instance`].
pub trait Phase: sealed::Sealed {
    /// Checks that the standard allows this variable to be set in this phase.
    ///
    /// # Errors
    /// Returns [`FmiError::NotSettable`] with the reason.
    fn check_settable(variable: &Variable) -> Result<()>;

    /// True if structural parameters can be set without entering another mode.
    #[doc(hidden)]
    fn is_configuration() -> bool {
        false
    }

    /// True if the experiment is not set up yet.
    #[doc(hidden)]
    fn is_before_setup() -> bool {
        false
    }

    /// True in continuous-time mode.
    #[doc(hidden)]
    fn is_continuous_time() -> bool {
        false
    }

    /// True between two communication points.
    #[doc(hidden)]
    fn is_step_mode() -> bool {
        false
    }
}

/// Phase in which values can be read: all but [`Instantiated`] (FMI 2.0.x, section 3.2.3).
pub trait Readable: Phase {}

/// Mode of model exchange after the initialization.
pub trait Running: Readable {}

mod sealed {
    /// Prevents further phases outside this module.
    pub trait Sealed {}
}

/// Declares the phases with their additional traits, settable variables and properties.
macro_rules! phases {
    ($($(#[$doc:meta])* $phase:ident($($trait:ident),*) |$variable:ident| $check:expr $(, $property:ident)?;)+) => {$(
        $(#[$doc])*
        #[derive(Debug)]
        pub enum $phase {}
        impl sealed::Sealed for $phase {}
        impl Phase for $phase {
            fn check_settable($variable: &Variable) -> Result<()> {
                $check
            }
            $(fn $property() -> bool {
                true
            })?
        }
        $(impl $trait for $phase {})*
    )+};
}
phases! {
    /// Created or reset, not yet initialized: parameters and start values are set here.
    Instantiated() |v| assignments::check_settable_at_start(v), is_before_setup;
    /// Initialization mode: inputs at the start time are set here.
    Initialization(Readable) |v| assignments::check_settable_in_initialization(v);
    /// Event mode: discrete states are updated here.
    EventMode(Readable, Running) |v| assignments::check_settable_when_discrete(
        v,
        "in event mode only inputs and tunable parameters can be set",
    );
    /// Continuous-time mode: time, states and continuous inputs are set here.
    ContinuousTime(Readable, Running) |v| assignments::check_settable_in_continuous_time(v), is_continuous_time;
    /// Between two communication points: inputs are set and steps are made here (co-simulation).
    StepMode(Readable) |v| assignments::check_settable_when_discrete(
        v,
        "between steps only inputs and tunable parameters can be set",
    ), is_step_mode;
    /// Reconfiguration mode: tunable structural parameters are set here.
    Reconfiguration(Readable) |v| assignments::check_settable_in_reconfiguration(v), is_configuration;
    /// Terminated: values can be read.
    Terminated(Readable) |v| Err(assignments::not_settable(v, "the simulation has ended"));
}

/// Saved state of an instance. Only the same instance can restore it. When it is dropped, the next saved
/// state uses its memory, which is freed with the instance.
#[derive(Debug)]
pub struct SavedState {
    slot: SavedSlot,
    /// Name of the phase in which the state was saved.
    phase: &'static str,
    /// Structural parameters, which determine the array sizes and are part of the state.
    structure: Structure,
    progress: Progress,
}

/// Returns the last part of the type's name.
fn phase_name<P>() -> &'static str {
    let path = std::any::type_name::<P>();
    path.rsplit("::").next().unwrap_or(path)
}

impl<P, K> Instance<P, K> {
    pub(crate) fn core(&mut self) -> &mut Core {
        &mut self.core
    }

    /// Changes the phase of the type. The caller has already made the call that enters the phase.
    pub(crate) fn into_phase<Q>(self) -> Instance<Q, K> {
        Instance { core: self.core, _phase: PhantomData }
    }

    /// Returns the raw instance and the FMU.
    pub(crate) fn into_raw(self) -> (RawInstance, Fmu) {
        let core = *self.core;
        (core.raw, core.fmu)
    }

    /// Makes a call that enters another phase.
    pub(crate) fn step_to<Q>(
        mut self,
        call: impl FnOnce(&mut RawInstance) -> Result<(), Fault>,
    ) -> Result<Instance<Q, K>> {
        self.core.call(call)?;
        Ok(self.into_phase())
    }

    /// Returns the FMU of this instance.
    pub fn fmu(&self) -> &Fmu {
        &self.core.fmu
    }

    /// Returns the next known time event of the model or tick of one of its clocks, as of the last events.
    pub fn next_event(&self) -> Option<f64> {
        self.core.progress.next_event
    }

    /// Returns the last lines that the FMU logged, oldest first, and the number of discarded lines. Discarded
    /// are earlier lines and lines beyond the rate limit (see [`InstanceOptions`](crate::InstanceOptions)).
    pub fn log(&self) -> (Vec<LogLine>, u64) {
        self.core.log()
    }

    /// Switches the FMU's logging on or off for all categories.
    ///
    /// # Errors
    /// Returns an error if the FMU returns one or has no such function.
    pub fn set_logging(&mut self, on: bool) -> Result<()> {
        self.core.set_logging(on, &[])
    }

    /// Switches the FMU's logging on for these categories, named as in
    /// [`ModelDescription::log_categories`](crate::ModelDescription::log_categories). Lines of other
    /// categories are kept only if their status is not ok. FMI 1.0 does not declare categories: the FMU logs
    /// all of them, and any name is accepted.
    ///
    /// # Errors
    /// Returns [`FmiError::BadSetting`] for a category that the description does not contain. Also returns an
    /// error if the FMU returns one or has no such function.
    pub fn log_categories<S: AsRef<str>>(&mut self, categories: &[S]) -> Result<()> {
        let categories: Vec<String> = categories.iter().map(|name| name.as_ref().to_owned()).collect();
        self.core.set_logging(true, &categories)
    }

    /// Saves the complete state of the instance. The saved state includes pending time events and clock
    /// ticks, and assigned values that are not yet in effect.
    ///
    /// # Errors
    /// Returns an error if the FMU does not support saved states, or returns an error.
    pub fn save_state(&mut self) -> Result<SavedState> {
        let slot = self.core.call(RawInstance::save_state)?;
        let (structure, progress) = (self.core.structure.clone(), self.core.progress.clone());
        Ok(SavedState { slot, phase: phase_name::<P>(), structure, progress })
    }

    fn check_origin(&self, state: &SavedState) -> Result<()> {
        if self.core.raw.owns(&state.slot) { Ok(()) } else { Err(FmiError::ForeignState) }
    }

    /// Returns the instance to its initial state. This function does not check that the FMU really resets its
    /// state. [`Simulator`](crate::Simulator) compares values after a reset.
    ///
    /// # Errors
    /// Returns an error if the FMU does not support reset, or returns an error. The instance is then freed.
    pub fn reset(self) -> Result<Instance<Instantiated, K>> {
        let mut fresh: Instance<Instantiated, K> = self.step_to(RawInstance::reset)?;
        // After a reset, structural parameters have their start values.
        if !fresh.core.structure.is_default() {
            fresh.core.configure(&Assignments::default(), &Structure::default())?;
        }
        fresh.core.progress = Progress::default();
        fresh.core.raw.clear_log();
        Ok(fresh)
    }
}

impl<P: Readable, K> Instance<P, K> {
    /// Reads a variable.
    ///
    /// # Errors
    /// Returns an error if there is no such variable, or the FMU returns an error.
    pub fn get(&mut self, name: &str) -> Result<Value> {
        let fmu = self.core.fmu.clone();
        let index = assignments::resolve(fmu.description(), name)?;
        if let Some((_, value)) = self.core.progress.waiting.iter().find(|(waiting, _)| *waiting == index) {
            return Ok(value.clone());
        }
        self.core.value(&fmu.description().variables[index])
    }

    /// Reads real variables by value reference in one call.
    ///
    /// # Errors
    /// Returns an error if the slices differ in length, or a reference does not belong to a variable of type
    /// Real. Also returns an error if the FMU returns an error.
    pub fn get_reals(&mut self, references: &[u32], values: &mut [f64]) -> Result<()> {
        self.core.check_reals("get_reals", references, values.len())?;
        self.core
            .raw
            .get_real(references, values)
            .map_err(|fault| self.core.error_about(fault, references, |kind| kind == VariableKind::Real))
    }

    /// Computes the derivative of `unknowns` in the direction `seed` in the space of `knowns`. References are
    /// value references of variables of type Real. An array occupies as many elements of `seed` or
    /// `sensitivity` as it has values.
    ///
    /// # Errors
    /// Returns an error if the slices differ in length, or a reference does not belong to a variable of type
    /// Real. Also returns an error if the FMU does not support directional derivatives, or returns an error.
    pub fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<()> {
        self.core.check_reals("directional_derivative", unknowns, sensitivity.len())?;
        self.core.check_reals("directional_derivative", knowns, seed.len())?;
        self.core.call(|raw| raw.directional_derivative(Direction { unknowns, knowns, seed }, sensitivity))
    }

    /// Computes the derivative of the sum of `unknowns`, weighted with `seed`, with respect to each of
    /// `knowns` (FMI 3.0). This is the vector-Jacobian product of `seed` and the Jacobian.
    ///
    /// # Errors
    /// Returns the errors of [`directional_derivative`](Self::directional_derivative).
    pub fn adjoint_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<()> {
        self.core.check_reals("adjoint_derivative", unknowns, seed.len())?;
        self.core.check_reals("adjoint_derivative", knowns, sensitivity.len())?;
        self.core.call(|raw| raw.adjoint_derivative(Direction { unknowns, knowns, seed }, sensitivity))
    }

    /// Returns the dependencies of a variable for the current structural parameters, element by element (FMI
    /// 3.0).
    ///
    /// # Errors
    /// Returns an error if there is no such variable. Also returns an error if the FMU does not support
    /// dependencies, returns an error, or reports a kind of dependency that the standard does not define.
    pub fn variable_dependencies(&mut self, name: &str) -> Result<Vec<ElementDependency>> {
        let index = assignments::resolve(self.core.fmu.description(), name)?;
        let reference = self.core.fmu.description().variables[index].value_reference;
        self.core.call(|raw| raw.variable_dependencies(reference))
    }
}

impl<P: Phase, K> Instance<P, K> {
    /// Sets a variable.
    ///
    /// Before the initialization, an array value may have the size that follows from structural parameters to
    /// be set later. Between two steps of a co-simulation with event mode, values are deferred until event
    /// mode, except values of continuous inputs. Event mode is entered before the next step at the latest.
    ///
    /// # Errors
    /// Returns an error if there is no such variable, or it cannot be set in this phase. Also returns an
    /// error if the value has the wrong type or is not finite, or if the FMU returns an error.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) -> Result<()> {
        let fmu = self.core.fmu.clone();
        let index = assignments::resolve(fmu.description(), name)?;
        let variable = &fmu.description().variables[index];
        P::check_settable(variable)?;
        let value = value.into();
        let mut values = Assignments::default();
        let elements = self.core.elements(variable);
        if let (true, Some(n), Value::Array(given)) = (P::is_before_setup(), elements, &value)
            && given.len() != n
        {
            // A structural parameter that is set later may change the array to this size.
            let value = assignments::convert(variable, &value, Some(given.len()))?;
            note(&mut self.core.progress.set_before_setup, index, value);
            return Ok(());
        }
        let value = assignments::convert(variable, &value, elements)?;
        values.push(variable, &value, elements)?;
        if variable.causality != Causality::StructuralParameter {
            if P::is_step_mode() && self.core.waits_for_events(variable) {
                note(&mut self.core.progress.waiting, index, value);
                return Ok(());
            }
            if P::is_continuous_time() {
                self.core.note_indicators();
            }
            self.core.apply(&values)?;
            if P::is_before_setup() {
                note(&mut self.core.progress.set_before_setup, index, value);
            }
            return Ok(());
        }
        let mut structure = self.core.structure.clone();
        structure.set(index, &value);
        structure.check(fmu.description()).map_err(|(_, problem)| FmiError::BadSetting(problem))?;
        if P::is_configuration() {
            self.core.apply(&values)?;
            self.core.restructure(&structure);
            return Ok(());
        }
        self.core.configure(&values, &structure)
    }

    /// Restores a state saved by this instance **in the same phase**.
    ///
    /// # Errors
    /// Returns [`FmiError::ForeignState`] for a state of another instance, or
    /// [`FmiError::StateOfAnotherPhase`]. Also returns an error if the FMU does not support saved states, or
    /// returns an error.
    pub fn restore_state(&mut self, state: &SavedState) -> Result<()> {
        self.check_origin(state)?;
        let now = phase_name::<P>();
        if state.phase != now {
            return Err(FmiError::StateOfAnotherPhase { saved: state.phase, now });
        }
        self.core.call(|raw| raw.restore_state(&state.slot))?;
        self.core.restructure(&state.structure);
        self.core.progress.clone_from(&state.progress);
        Ok(())
    }
}

impl<K> Instance<Instantiated, K> {
    pub(crate) fn from_raw(raw: RawInstance, fmu: Fmu) -> Self {
        Self { core: Box::new(Core::new(raw, fmu)), _phase: PhantomData }
    }

    /// Wraps an instance that the user controls.
    pub(crate) fn by_hand(core: Core, library: Arc<LoadedLibrary>) -> Self {
        let mut core = Core { _library: Some(library), ..core };
        core.raw.set_by_hand();
        Self { core: Box::new(core), _phase: PhantomData }
    }

    /// Sets up the experiment and enters initialization mode.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn enter_initialization(
        mut self,
        start_time: f64,
        stop_time: Option<f64>,
        relative_tolerance: Option<f64>,
    ) -> Result<Instance<Initialization, K>> {
        let experiment = Experiment { tolerance: relative_tolerance, start: start_time, stop: stop_time };
        self.core.call(|raw| raw.setup_experiment(&experiment))?;
        // The call above may overwrite values, so the values set before it are set again.
        let fmu = self.core.fmu.clone();
        let mut values = Assignments::default();
        for (index, value) in std::mem::take(&mut self.core.progress.set_before_setup) {
            let variable = &fmu.description().variables[index];
            values.push(variable, &value, self.core.elements(variable))?;
        }
        self.core.apply(&values)?;
        self.core.check_sizes()?;
        self.step_to(RawInstance::enter_initialization)
    }
}

impl Instance<Initialization> {
    /// Ends the initialization. The instance is then in event mode, and its initial events are due.
    ///
    /// # Errors
    /// Returns an error if the FMU does.
    pub fn exit_initialization(mut self) -> Result<Instance<EventMode>> {
        self.core.begin_clocks(true)?;
        self.step_to(RawInstance::exit_initialization)
    }
}
