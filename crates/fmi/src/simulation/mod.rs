//! One worker's simulator: a plan, a live instance, a driver and buffers, run as often as one likes.

mod engine;
mod probe;

pub(crate) use probe::{PROBE_STEPS, Probe};

use crate::copies::PrivateCopy;
use crate::description::Value;
use crate::error::FmiError;
use crate::fmu::Reuse;
use crate::places::{Place, element_value};
use crate::plan::SimulationPlan;
use crate::readback::ReadBackBuffers;
use crate::renewal::{new_instance, new_with_origin, renew_or_replace};
use crate::sys::{CallEnvironment, Library, RawInstance, Shared};
use crate::trajectory::{Recorder, Trajectory};
use engine::Engine;
use ode::{Observer, Report, Seconds};
use std::sync::Arc;
use std::time::Instant;

/// Runs one plan over and over, each time from a freshly reset instance: the same parameters give the same bits, whatever
/// was run before. One thread at a time uses it ([`Send`], not `Sync`); when warm, a run allocates nothing.
///
/// Before an instance is used again, the way of bringing it back to its beginning is put to the test: the first steps
/// must have the same bits as on a new instance, also after a run with other values, or from then on the next way is taken
/// (see [`Reuse`]: a saved state, the reset function, a new instance for every run). Parameters and start values are set
/// again for every run, and read back from an instance that was used before. Where a [`Pool`](crate::Pool) has found that instances of the library disturb
/// each other, the simulator has a copy of the library of its own; where that does not help (see
/// [`Sharing`](crate::Sharing)), a run waits until no other one is under way, and has a new instance if another one was
/// made meanwhile.
///
/// ```compile_fail
/// fn shared_between_threads<T: Sync>() {}
/// shared_between_threads::<fmi::Simulator>();
/// ```
#[derive(Debug)]
pub struct Simulator {
    plan: Arc<SimulationPlan>,
    engine: Engine,
    /// A new or reset instance that has not been used yet.
    fresh: Option<RawInstance>,
    buffers: ReadBackBuffers,
    /// When the start of the present run began: what was made to test the model before does not count.
    began: Instant,
    library: Arc<Library>,
    shared: Arc<Shared>,
    /// Where instances of one library disturb each other: the library is one of its own. Given back after the instances.
    copy: Option<PrivateCopy>,
}

impl Simulator {
    /// Makes a simulator with a live instance (an idle one of the FMU, if there is one).
    ///
    /// # Errors
    /// Options of the method that cannot be used; the FMU cannot be loaded or instantiated.
    pub fn new(plan: Arc<SimulationPlan>) -> Result<Self, FmiError> {
        let shared = Arc::clone(plan.fmu().library(plan.kind)?.shared());
        let mut copy = None;
        if shared.is_dependent() && shared.copies_work() == Some(true) {
            match plan.fmu().private_copy(plan.kind) {
                Ok(own) => copy = Some(own),
                Err(error) => log::warn!("simulations take turns: {error}"),
            }
        }
        Self::with_library(plan, copy)
    }

    /// Makes a simulator with a library of its own, or that of the FMU.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub(crate) fn with_library(
        plan: Arc<SimulationPlan>,
        copy: Option<PrivateCopy>,
    ) -> Result<Self, FmiError> {
        let mut engine = Engine::new(&plan)?;
        let mut fresh = None;
        let library = match &copy {
            Some(copy) => Arc::clone(copy.library()),
            None => plan.fmu().library(plan.kind)?,
        };
        let idle = if copy.is_none() { plan.fmu().take_idle(plan.kind, &plan.settings) } else { None };
        match idle {
            Some(raw) => engine.running().adopt(raw),
            None => fresh = Some(new_instance(&plan, &library)?),
        }
        let shared = Arc::clone(library.shared());
        Ok(Self {
            plan,
            engine,
            fresh,
            buffers: ReadBackBuffers::default(),
            began: Instant::now(),
            library,
            shared,
            copy,
        })
    }

    /// Whether its library is one of its own.
    pub(crate) fn has_copy(&self) -> bool {
        self.copy.is_some()
    }

    /// After `Fatal` a copy is unusable, but nothing is wrong with another one.
    fn leave_broken_copy(&mut self) -> Result<(), FmiError> {
        if self.copy.is_none() || !self.shared.is_fatal() {
            return Ok(());
        }
        drop(self.engine.running().retire());
        self.fresh = None;
        let copy = self.plan.fmu().private_copy(self.plan.kind)?;
        self.library = Arc::clone(copy.library());
        self.shared = Arc::clone(self.library.shared());
        self.copy = Some(copy);
        Ok(())
    }

    fn take_idle(&self) -> Option<RawInstance> {
        if self.has_copy() { None } else { self.plan.fmu().take_idle(self.plan.kind, &self.plan.settings) }
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Simulates once, with these values for the plan's parameters, and hands the samples to `observer`.
    ///
    /// The seconds of the report count from bringing the model back to its beginning; loading and the trial runs before a
    /// first use do not count. Those inside the model are in calls of the FMU (of calls that take less than 1 us only
    /// some are timed) and do not include input functions ([`Inputs::function`](crate::Inputs::function)).
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters; the FMU or the integration fails. The simulator can
    /// be used again after an error: a broken instance is replaced.
    pub fn run(&mut self, parameters: &[f64], observer: &mut dyn Observer) -> Result<Report, FmiError> {
        self.plan.values.check_parameters(parameters)?;
        self.leave_broken_copy()?;
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn();
        let _environment = CallEnvironment::enter();
        self.start(parameters)?;
        let (starting, elsewhere) =
            (self.began.elapsed().as_secs_f64(), self.engine.running().seconds_elsewhere());
        let mut outcome = self.engine.run(&self.plan, None, observer);
        self.engine.running().pass_log_on();
        let stats = match &mut outcome {
            Ok(report) => &mut report.stats,
            Err(FmiError::Simulation(error)) => &mut error.stats,
            Err(_) => return outcome,
        };
        stats.seconds += Seconds::new(starting);
        // All of the start is the model's doing but what its inputs took.
        stats.seconds_in_model += Seconds::new((starting - elsewhere).max(0.0));
        outcome
    }

    /// Simulates once and records all samples.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory(&mut self, parameters: &[f64]) -> Result<Trajectory, FmiError> {
        let mut recorder = Recorder::new(&self.plan);
        let report = self.run(parameters, &mut recorder)?;
        let running = self.engine.running();
        let ticks = running.take_ticks();
        Ok(recorder.finish(&self.plan, &running.buffers.table, ticks, report))
    }

    /// Value of a variable, or of an element of an array (`name[2,1]`), where the last run ended (after a step inside of which it was stopped: at the end of the
    /// step before).
    ///
    /// # Errors
    /// There is no such variable, nothing was run yet, the run failed, or the FMU refuses; another instance was used since,
    /// and instances disturb each other.
    pub fn value(&mut self, name: &str) -> Result<Value, FmiError> {
        let description = self.plan.fmu().description();
        let place = Place::of_name(description, self.plan.structure(), name)?;
        let _turn = self.shared.turn_if_dependent();
        let value = self.engine.value(&description.variables[place.variable])?;
        Ok(element_value(value, place.element))
    }

    /// As [`value`](Self::value), as a number: integers and Booleans too.
    ///
    /// # Errors
    /// As [`value`](Self::value); the variable is a text.
    pub fn get(&mut self, name: &str) -> Result<f64, FmiError> {
        self.value(name)?
            .as_number()
            .ok_or_else(|| FmiError::NotAnOutput { name: name.to_owned(), reason: "it is no single number" })
    }

    /// Brings the FMU to its start without simulating: afterwards [`value`](Self::value) gives initial values.
    pub(crate) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.plan.values.check_parameters(parameters)?;
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn();
        let _environment = CallEnvironment::enter();
        self.start(parameters)?;
        self.engine.settle()
    }

    /// Initializes a new instance, or one that was brought back to its beginning and has the values it was given.
    fn start(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.began = Instant::now();
        let (instance, is_used) = self.fresh_instance(parameters)?;
        self.engine.initialize(instance, &self.plan.values.start, parameters)?;
        if !is_used || self.has_values(parameters).is_ok_and(|agrees| agrees) {
            return Ok(());
        }
        let plan = Arc::clone(&self.plan);
        let model = &plan.fmu().description().model_name;
        let reuse = plan.reuse();
        self.start_new(parameters)?;
        let from_new = self.has_values(parameters);
        if from_new.is_ok_and(|agrees| agrees) {
            log::warn!("{model}: an instance that was used before does not take the values it is given");
            match reuse {
                Some(Reuse::Restore) => plan.refuse_restore(),
                _ => plan.set_reuse(Reuse::Reinstantiate),
            }
            return Ok(());
        }
        log::warn!("{model}: after the initialization the model does not have the values it was given");
        plan.values.read_back.set_overridden();
        // An instance that did not answer is not to be used.
        self.start_new(parameters)
    }

    fn start_new(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        drop(self.engine.running().retire());
        let raw = new_instance(&self.plan, &self.library)?;
        self.engine.initialize(raw, &self.plan.values.start, parameters)
    }

    fn has_values(&mut self, parameters: &[f64]) -> Result<bool, FmiError> {
        let core = self.engine.running().current.core()?;
        self.plan.values.has_values(core, parameters, &mut self.buffers)
    }

    /// A new instance, or one that was brought back to its beginning in a way that is known to do so; and whether it was
    /// used before.
    fn fresh_instance(&mut self, parameters: &[f64]) -> Result<(RawInstance, bool), FmiError> {
        let good = |raw: &RawInstance| !raw.is_stale();
        if let Some(raw) = self.fresh.take().filter(good) {
            return Ok((raw, false));
        }
        let plan = Arc::clone(&self.plan);
        let used = self.engine.running().retire().filter(good);
        let Some(used) = used.or_else(|| self.take_idle().filter(good)) else {
            return Ok((new_instance(&plan, &self.library)?, false));
        };
        match plan.reuse() {
            Some(Reuse::Reinstantiate) => {
                drop(used);
                Ok((new_instance(&plan, &self.library)?, false))
            }
            Some(reuse) => renew_or_replace(used, &plan, &self.library, reuse),
            // Made when nobody thought of using it again.
            None if plan.may_restore() && !used.has_origin() => {
                drop(used);
                Ok((new_with_origin(&plan, &self.library)?, false))
            }
            None => self.check_reuse(used, parameters),
        }
    }

    /// What all users of its library share.
    pub(crate) fn shared(&self) -> &Shared {
        &self.shared
    }

    /// Gives the instance back to the FMU, for whoever needs one next.
    pub(crate) fn park(&mut self) {
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn_if_dependent();
        let used = self.fresh.take().or_else(|| self.engine.running().retire());
        if let Some(raw) = used
            && self.plan.reuse() != Some(Reuse::Reinstantiate)
            && self.copy.is_none()
        {
            self.plan.fmu().put_idle(self.plan.kind, raw, &self.plan.settings);
        }
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.park();
    }
}
