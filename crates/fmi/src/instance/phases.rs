//! The phases of the life of an instance, as types, and what can be done in each of them.

use super::assignments::{self, Assignments};
use super::core::Core;
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
}

/// A phase in which values can be read: all but [`Instantiated`] (FMI 2.0.x, section 3.2.3).
pub trait Readable: Phase {}

impl Readable for Initialization {}
impl Readable for EventMode {}
impl Readable for ContinuousTime {}
impl Readable for StepMode {}
impl Readable for Reconfiguration {}
impl Readable for Terminated {}

/// A mode of model exchange after the initialization.
pub trait Running: Readable {}

impl Running for EventMode {}
impl Running for ContinuousTime {}

mod sealed {
    /// Keeps the list of phases complete.
    pub trait Sealed {}
}

/// Made or reset, not yet initialized: parameters and start values are set here.
#[derive(Debug)]
pub enum Instantiated {}
/// Initialization mode: inputs at the start time are set here.
#[derive(Debug)]
pub enum Initialization {}
/// Event mode: discrete states are updated here.
#[derive(Debug)]
pub enum EventMode {}
/// Continuous-time mode: time, states and continuous inputs are set here.
#[derive(Debug)]
pub enum ContinuousTime {}
/// Between two communication points: inputs are set and steps are made here (co-simulation).
#[derive(Debug)]
pub enum StepMode {}
/// Reconfiguration mode: tunable structural parameters are set here.
#[derive(Debug)]
pub enum Reconfiguration {}
/// Ended: values can be read.
#[derive(Debug)]
pub enum Terminated {}

macro_rules! phase {
    ($phase:ty, |$variable:ident| $check:expr) => {
        impl sealed::Sealed for $phase {}
        impl Phase for $phase {
            fn check_settable($variable: &Variable) -> Result<()> {
                $check
            }
        }
    };
}
impl sealed::Sealed for Instantiated {}
impl Phase for Instantiated {
    fn check_settable(variable: &Variable) -> Result<()> {
        assignments::check_settable_at_start(variable)
    }
    fn is_before_setup() -> bool {
        true
    }
}
phase!(Initialization, |v| assignments::check_settable_in_initialization(v));
phase!(EventMode, |v| assignments::check_settable_when_discrete(
    v,
    "in event mode only inputs and tunable parameters can be set"
));
phase!(ContinuousTime, |v| assignments::check_settable_in_continuous_time(v));
phase!(StepMode, |v| assignments::check_settable_when_discrete(
    v,
    "between steps only inputs and tunable parameters can be set"
));
impl sealed::Sealed for Reconfiguration {}
impl Phase for Reconfiguration {
    fn check_settable(variable: &Variable) -> Result<()> {
        assignments::check_settable_in_reconfiguration(variable)
    }
    fn is_configuration() -> bool {
        true
    }
}
phase!(Terminated, |v| Err(assignments::not_settable(v, "the simulation has ended")));

/// A saved state of an instance, to be brought back by the same instance. When it is dropped, its memory is
/// used for the next saved state; the instance frees it at its end.
#[derive(Debug)]
pub struct SavedState {
    slot: SavedSlot,
    /// Name of the phase it was saved in.
    phase: &'static str,
    /// The structural parameters are part of the state, and with them the sizes of the arrays.
    structure: Structure,
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

    /// Saves the complete state of the instance.
    ///
    /// # Errors
    /// The FMU cannot, or refuses.
    pub fn save_state(&mut self) -> Result<SavedState> {
        let slot = self.core.call(RawInstance::save_state)?;
        Ok(SavedState { slot, phase: phase_name::<P>(), structure: self.core.structure.clone() })
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
    /// Sets a variable.
    ///
    /// # Errors
    /// There is no such variable, the value has the wrong type or is not finite, the variable cannot be set
    /// in this phase, or the FMU refuses.
    pub fn set(&mut self, name: &str, value: impl Into<Value>) -> Result<()> {
        let fmu = self.core.fmu.clone();
        let index = assignments::resolve(fmu.description(), name)?;
        let variable = &fmu.description().variables[index];
        P::check_settable(variable)?;
        let mut values = Assignments::default();
        let elements = self.core.elements(variable);
        let value = assignments::convert(variable, &value.into(), elements)?;
        values.push(variable, &value, elements)?;
        if variable.causality != Causality::StructuralParameter {
            self.core.apply(&values)?;
            return match P::is_before_setup() {
                true => self.core.set_before_setup.push(variable, &value, elements),
                false => Ok(()),
            };
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
        let set = std::mem::take(&mut self.core.set_before_setup);
        self.core.apply(&set)?;
        self.core.check_sizes()?;
        self.step_to(RawInstance::enter_initialization)
    }
}

impl Instance<Initialization> {
    /// Ends the initialization; the instance is in event mode then, and its initial events are due.
    ///
    /// # Errors
    /// The FMU refuses.
    pub fn exit_initialization(self) -> Result<Instance<EventMode>> {
        self.step_to(RawInstance::exit_initialization)
    }
}
