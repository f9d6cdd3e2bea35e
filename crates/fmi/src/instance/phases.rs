//! The phases of the life of an instance, as types, and what can be done in each of them.

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

/// A live instance of an FMU in the phase `P`, for model exchange or co-simulation.
///
/// An instance can be moved to another thread but not shared ([`Send`], not `Sync`). Changing the phase takes
/// the instance and returns it in its new phase; when the FMU answers with an error, the instance is freed
/// (after `fatal` it is abandoned: FMI forbids even freeing it), and the error has the FMU's last log lines.
/// After another call has returned `error`, all further ones are refused with [`FmiError::AfterError`] but
/// [`reset`](Instance::reset) and [`restore_state`](Instance::restore_state).
#[derive(Debug)]
pub struct Instance<P, K = ModelExchange> {
    core: Box<Core>,
    _phase: PhantomData<(P, K)>,
}

/// Kind of an instance whose equations are integrated by the importer.
#[derive(Debug)]
pub enum ModelExchange {}
/// Kind of an instance that integrates itself.
#[derive(Debug)]
pub enum CoSimulation {}

/// A phase in the life of an [`Instance`].
pub trait Phase: sealed::Sealed {
    /// Checks that the standard lets this variable be set in this phase.
    ///
    /// # Errors
    /// [`FmiError::NotSettable`] with the reason.
    fn check_settable(variable: &Variable) -> Result<()>;

    /// True if structural parameters are set without entering another mode.
    #[doc(hidden)]
    fn is_configuration() -> bool {
        false
    }

    /// True if the experiment has yet to be set up.
    #[doc(hidden)]
    fn is_before_setup() -> bool {
        false
    }

    /// True if the model is being integrated.
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

/// A phase in which values can be read: all but [`Instantiated`] (FMI 2.0.x, section 3.2.3).
pub trait Readable: Phase {}

/// A mode of model exchange after the initialization.
pub trait Running: Readable {}

mod sealed {
    /// Keeps the list of phases complete.
    pub trait Sealed {}
}

/// Declares the phases: their further traits, which variables can be set, what else holds of them.
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
    /// Made or reset, not yet initialized: parameters and start values are set here.
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
    /// Ended: values can be read.
    Terminated(Readable) |v| Err(assignments::not_settable(v, "the simulation has ended"));
}

/// A saved state of an instance, to be brought back by the same instance. When it is dropped, its memory is
/// used for the next saved state; the instance frees it at its end.
#[derive(Debug)]
pub struct SavedState {
    slot: SavedSlot,
    /// Name of the phase it was saved in.
    phase: &'static str,
    /// The structural parameters are part of the state, and with them the sizes of the arrays.
    structure: Structure,
    progress: Progress,
}

/// The last part of the type's name.
fn phase_name<P>() -> &'static str {
    let path = std::any::type_name::<P>();
    path.rsplit("::").next().unwrap_or(path)
}

impl<P, K> Instance<P, K> {
    pub(crate) fn core(&mut self) -> &mut Core {
        &mut self.core
    }

    /// The same instance in another phase; the caller has made the call that leads there.
    pub(crate) fn into_phase<Q>(self) -> Instance<Q, K> {
        Instance { core: self.core, _phase: PhantomData }
    }

    /// Gives up the wrapping.
    pub(crate) fn into_raw(self) -> (RawInstance, Fmu) {
        let core = *self.core;
        (core.raw, core.fmu)
    }

    /// Makes a call that leads to another phase.
    pub(crate) fn step_to<Q>(
        mut self,
        call: impl FnOnce(&mut RawInstance) -> Result<(), Fault>,
    ) -> Result<Instance<Q, K>> {
        self.core.call(call)?;
        Ok(self.into_phase())
    }

    /// The FMU it is an instance of.
    pub fn fmu(&self) -> &Fmu {
        &self.core.fmu
    }

    /// The next time event of the model or tick of one of its clocks, as far as it is known since its last
    /// events.
    pub fn next_event(&self) -> Option<f64> {
        self.core.progress.next_event
    }

    /// The last lines the FMU logged, oldest first, and the number of others that were not kept: earlier
    /// ones, and those beyond the rate limit (see [`InstanceOptions`](crate::InstanceOptions)).
    pub fn log(&self) -> (Vec<LogLine>, u64) {
        self.core.log()
    }

    /// Switches the FMU's logging on or off, of all categories.
    ///
    /// # Errors
    /// The FMU refuses, or has no such function.
    pub fn set_logging(&mut self, on: bool) -> Result<()> {
        self.core.set_logging(on, &[])
    }

    /// Switches the FMU's logging on for these categories, by their names in
    /// [`ModelDescription::log_categories`](crate::ModelDescription::log_categories); lines of others are
    /// kept only if their status is not ok. FMI 1.0 knows no categories in advance: the FMU logs all, and any
    /// name will do.
    ///
    /// # Errors
    /// [`FmiError::BadSetting`] for a category that the description does not have; the FMU refuses, or has no
    /// such function.
    pub fn log_categories<S: AsRef<str>>(&mut self, categories: &[S]) -> Result<()> {
        let categories: Vec<String> = categories.iter().map(|name| name.as_ref().to_owned()).collect();
        self.core.set_logging(true, &categories)
    }

    /// Saves the complete state of the instance, with what a later run of it depends on besides: the time
    /// event and the ticks to come, values that were set and are not in effect yet.
    ///
    /// # Errors
    /// The FMU cannot, or refuses.
    pub fn save_state(&mut self) -> Result<SavedState> {
        let slot = self.core.call(RawInstance::save_state)?;
        let (structure, progress) = (self.core.structure.clone(), self.core.progress.clone());
        Ok(SavedState { slot, phase: phase_name::<P>(), structure, progress })
    }

    fn check_own(&self, state: &SavedState) -> Result<()> {
        if self.core.raw.owns(&state.slot) { Ok(()) } else { Err(FmiError::ForeignState) }
    }

    /// Brings the instance back to its beginning. Whether the FMU really does so is another matter: see
    /// [`Simulator`](crate::Simulator), which checks it.
    ///
    /// # Errors
    /// The FMU cannot, or refuses; the instance is freed then.
    pub fn reset(self) -> Result<Instance<Instantiated, K>> {
        let mut fresh: Instance<Instantiated, K> = self.step_to(RawInstance::reset)?;
        // Structural parameters have their start values again.
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
    /// There is no such variable, or the FMU refuses.
    pub fn get(&mut self, name: &str) -> Result<Value> {
        let fmu = self.core.fmu.clone();
        let index = assignments::resolve(fmu.description(), name)?;
        if let Some((_, value)) = self.core.progress.waiting.iter().find(|(known, _)| *known == index) {
            return Ok(value.clone());
        }
        self.core.value(&fmu.description().variables[index])
    }

    /// Reads real variables by value reference, in one call.
    ///
    /// # Errors
    /// The slices differ in length, a reference is not that of a variable of type Real, or the FMU refuses.
    pub fn get_reals(&mut self, references: &[u32], values: &mut [f64]) -> Result<()> {
        self.core.check_reals("get_reals", references, values.len())?;
        self.core
            .raw
            .get_real(references, values)
            .map_err(|fault| self.core.error_about(fault, references, |kind| kind == VariableKind::Real))
    }

    /// The derivative of `unknowns` in the direction `seed` of the space of `knowns` (value references of
    /// reals; an array has as many elements in `seed` or `sensitivity` as it has values).
    ///
    /// # Errors
    /// The slices differ in length, a reference is not that of a variable of type Real; the FMU cannot, or
    /// refuses.
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

    /// The derivative of the sum of `unknowns`, weighted with `seed`, with respect to each of `knowns` (FMI
    /// 3.0: the product of `seed` with the Jacobian, from the left).
    ///
    /// # Errors
    /// As [`directional_derivative`](Self::directional_derivative).
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

    /// Dependencies of a variable with the present structural parameters, element by element (FMI 3.0).
    ///
    /// # Errors
    /// There is no such variable; the FMU cannot, refuses, or names a kind of dependency that the standard
    /// does not know.
    pub fn variable_dependencies(&mut self, name: &str) -> Result<Vec<ElementDependency>> {
        let index = assignments::resolve(self.core.fmu.description(), name)?;
        let reference = self.core.fmu.description().variables[index].value_reference;
        self.core.call(|raw| raw.variable_dependencies(reference))
    }
}

impl<P: Phase, K> Instance<P, K> {
    /// Sets a variable. Before the initialization an array may be given as many elements as it will have when
    /// all structural parameters are set. Between two steps of a co-simulation with an event mode all but
    /// continuous inputs wait for that mode, which is entered before the next step at the latest.
    ///
    /// # Errors
    /// There is no such variable, the value has the wrong type or is not finite, the variable cannot be set
    /// in this phase, or the FMU refuses.
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
            // A structural parameter that is set later may give it this size.
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

    /// Brings back a state saved by this instance **in the same phase**.
    ///
    /// # Errors
    /// [`FmiError::ForeignState`] for a state of another instance, [`FmiError::StateOfAnotherPhase`]; the FMU
    /// cannot, or refuses.
    pub fn restore_state(&mut self, state: &SavedState) -> Result<()> {
        self.check_own(state)?;
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

    /// An instance made by hand.
    pub(crate) fn by_hand(core: Core, library: Arc<LoadedLibrary>) -> Self {
        let mut core = Core { _library: Some(library), ..core };
        core.raw.set_by_hand();
        Self { core: Box::new(core), _phase: PhantomData }
    }

    /// Sets the experiment up and enters initialization mode.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn enter_initialization(
        mut self,
        start_time: f64,
        stop_time: Option<f64>,
        relative_tolerance: Option<f64>,
    ) -> Result<Instance<Initialization, K>> {
        let experiment = Experiment { tolerance: relative_tolerance, start: start_time, stop: stop_time };
        self.core.call(|raw| raw.setup_experiment(&experiment))?;
        // What the call above has made anew gets the values that were set before it.
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
    /// Ends the initialization; the instance is in event mode then, and its initial events are due.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn exit_initialization(mut self) -> Result<Instance<EventMode>> {
        self.core.begin_clocks(true)?;
        self.step_to(RawInstance::exit_initialization)
    }
}
