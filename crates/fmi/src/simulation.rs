//! One worker's simulator: a plan, a live instance, a driver and buffers, run as often as one likes.

use crate::assign::{Assignments, resolve};
use crate::description::Value;
use crate::error::FmiError;
use crate::fmu::{Fmu, Reuse};
use crate::instance::{Instance, Instantiated};
use crate::plan::SimulationPlan;
use crate::sys::{FloatEnvironment, RawInstance, Shared};
use crate::system::System;
use crate::trajectory::{Recorder, Trajectory};
use ode::{Driver, ErrorKind, Ignore, Observer, Report};
use std::sync::Arc;

/// Steps after which a check of reset is sure enough: what reset forgets shows in the first right-hand sides.
pub(crate) const PROBE_STEPS: u64 = 50;

/// Runs one plan over and over, each time from a freshly reset instance: the same parameters give the same bits, whatever
/// was run before. One thread at a time uses it ([`Send`], not `Sync`); when warm, a run allocates nothing.
///
/// Before an FMU's reset function is relied on for the first time, it is put to the test: the first steps on the reset
/// instance must have the same bits as on a new one, or from then on every run gets a new instance
/// (see [`Fmu::reuse`]). Where a [`Pool`](crate::Pool) has found that instances of the library disturb each other, a run
/// waits until no other one is under way, and has a new instance if another one was made meanwhile.
///
/// ```compile_fail
/// fn shared_between_threads<T: Sync>() {}
/// shared_between_threads::<fmi::Simulator>();
/// ```
#[derive(Debug)]
pub struct Simulator {
    plan: Arc<SimulationPlan>,
    shared: Arc<Shared>,
    driver: Driver,
    system: System,
    /// A new or reset instance that has not been used yet.
    fresh: Option<Instance<Instantiated>>,
}

/// What a trial run showed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Probe {
    /// Digest of everything that the FMU answered.
    Digest(u64),
    /// It could not be started: nothing to compare.
    Nothing,
    /// A time limit ended it, which says nothing about the FMU.
    TimedOut,
}

impl Simulator {
    /// Makes a simulator with a live instance (an idle one of the FMU, if there is one).
    ///
    /// # Errors
    /// Options of the method that cannot be used; the FMU cannot be loaded or instantiated.
    pub fn new(plan: Arc<SimulationPlan>) -> Result<Self, FmiError> {
        let driver = Driver::new(plan.options.clone())?;
        let mut system = System::new(Arc::clone(&plan));
        let mut fresh = None;
        let shared = Arc::clone(plan.fmu().library()?.shared());
        match plan.fmu().take_idle(&plan.settings) {
            Some(raw) => system.adopt(raw),
            None => fresh = Some(plan.fmu().instantiate()?),
        }
        Ok(Self { plan, shared, driver, system, fresh })
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Simulates once, with these values for the plan's parameters, and hands the samples to `observer`.
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters; the FMU or the integration fails. The simulator can
    /// be used again after an error: a broken instance is replaced.
    pub fn run(&mut self, parameters: &[f64], observer: &mut dyn Observer) -> Result<Report, FmiError> {
        self.plan.check_parameters(parameters)?;
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn();
        let guard = FloatEnvironment::standard();
        let instance = self.fresh_instance(parameters)?;
        self.system.initialize(instance, parameters)?;
        // Instantiating or initializing may have changed the floating-point mode.
        guard.assert();
        drive(&self.plan, &mut self.driver, &mut self.system, observer)
    }

    /// Simulates once and records all samples.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory(&mut self, parameters: &[f64]) -> Result<Trajectory, FmiError> {
        let mut recorder = Recorder::new(&self.plan);
        let report = self.run(parameters, &mut recorder)?;
        Ok(recorder.finish(&self.plan, report))
    }

    /// Value of a variable where the last run ended (after a step inside of which it was stopped: at the end of the
    /// step before).
    ///
    /// # Errors
    /// There is no such variable, nothing was run yet, the run failed, or the FMU refuses; another instance was used since,
    /// and instances disturb each other.
    pub fn value(&mut self, name: &str) -> Result<Value, FmiError> {
        let description = self.plan.fmu().description();
        let index = resolve(description, name)?;
        let _turn = self.shared.turn_if_dependent();
        let _guard = FloatEnvironment::standard();
        self.system.value(&description.variables[index])
    }

    /// As [`value`](Self::value), as a number: integers and Booleans too.
    ///
    /// # Errors
    /// As [`value`](Self::value); the variable is a text.
    pub fn get(&mut self, name: &str) -> Result<f64, FmiError> {
        match self.value(name)? {
            Value::Real(x) => Ok(x),
            Value::Integer(i) => Ok(f64::from(i)),
            Value::Boolean(b) => Ok(f64::from(u8::from(b))),
            Value::String(_) => Err(FmiError::NotAnOutput {
                name: name.to_owned(),
                reason: "it is text, and results are numbers",
            }),
        }
    }

    /// Brings the FMU to its start without simulating: afterwards [`value`](Self::value) gives initial values.
    pub(crate) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.plan.check_parameters(parameters)?;
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn();
        let _guard = FloatEnvironment::standard();
        let instance = self.fresh_instance(parameters)?;
        self.system.initialize(instance, parameters)?;
        self.system.settle()
    }

    /// A new instance, or one that was reset by a function that is known to do so.
    fn fresh_instance(&mut self, parameters: &[f64]) -> Result<Instance<Instantiated>, FmiError> {
        if let Some(instance) = self.fresh.take().filter(|instance| !instance.is_stale()) {
            return Ok(instance);
        }
        let fmu = self.plan.fmu().clone();
        let good = |raw: &RawInstance| !raw.is_stale();
        let used = self.system.retire().filter(good);
        let Some(used) = used.or_else(|| fmu.take_idle(&self.plan.settings).filter(good)) else {
            return fmu.instantiate();
        };
        match fmu.reuse() {
            Some(Reuse::Reset) => reset_or_replace(used, &fmu),
            Some(Reuse::Reinstantiate) => {
                drop(used);
                fmu.instantiate()
            }
            None => self.check_reset(used, &fmu, parameters),
        }
    }

    /// Compares the first steps of the reset instance with those of a new one, and returns an instance to use.
    fn check_reset(
        &mut self,
        used: RawInstance,
        fmu: &Fmu,
        parameters: &[f64],
    ) -> Result<Instance<Instantiated>, FmiError> {
        self.system.adopt(used);
        let steps = Some(PROBE_STEPS);
        let after_reset = match self.probe_after_others(parameters, steps)? {
            // A run that fails leaves no instance to reset: then at least the same run twice.
            None => {
                self.probe_new(parameters, steps, &mut Ignore)?;
                self.probe_reset(parameters, steps)?
            }
            probe => probe,
        };
        // One at a time: the FMU may not allow two.
        drop(self.system.retire());
        let from_new = self.probe_new(parameters, steps, &mut Ignore)?;
        match (after_reset, from_new) {
            (Some(Probe::TimedOut), _) | (_, Probe::TimedOut) => {}
            (None | Some(Probe::Nothing), Probe::Nothing) => {}
            (after, new) if after == Some(new) => fmu.set_reuse(Reuse::Reset),
            _ => fmu.set_reuse(Reuse::Reinstantiate),
        }
        match (self.system.retire(), fmu.reuse()) {
            (Some(used), Some(Reuse::Reset)) => reset_or_replace(used, fmu),
            (used, _) => {
                drop(used);
                fmu.instantiate()
            }
        }
    }

    /// Brings an instance that is new or was reset to the start of a trial run; whether that went well.
    fn begin_probe(
        &mut self,
        instance: Instance<Instantiated>,
        start_values: &Assignments,
        parameters: &[f64],
    ) -> bool {
        let _guard = FloatEnvironment::standard();
        self.system.initialize_with(instance, start_values, parameters).is_ok()
    }

    /// Makes the trial run, and returns the digest of what the FMU answered.
    ///
    /// # Errors
    /// It was cancelled. A simulation that fails is part of the digest.
    pub(crate) fn finish_probe(
        &mut self,
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Probe, FmiError> {
        let _guard = FloatEnvironment::standard();
        let mut options = self.plan.options.clone();
        options.limits.max_steps = steps.or(options.limits.max_steps);
        let mut driver = Driver::new(options)?;
        self.system.begin_digest();
        let outcome = drive(&self.plan, &mut driver, &mut self.system, observer);
        let digest = self.system.end_digest().map_or(Probe::Nothing, Probe::Digest);
        match outcome {
            Err(FmiError::Simulation(error)) => match error.kind {
                ErrorKind::Cancelled => Err(FmiError::Simulation(error)),
                ErrorKind::TimedOut(_) => Ok(Probe::TimedOut),
                _ => Ok(digest),
            },
            _ => Ok(digest),
        }
    }

    /// Brings a new instance to the start of a trial run; whether that went well.
    ///
    /// # Errors
    /// There is no new instance to be had.
    pub(crate) fn begin_new(
        &mut self,
        start_values: &Assignments,
        parameters: &[f64],
    ) -> Result<bool, FmiError> {
        let instance = match self.fresh.take() {
            Some(instance) => instance,
            None => {
                drop(self.system.retire());
                self.plan.fmu().instantiate()?
            }
        };
        Ok(self.begin_probe(instance, start_values, parameters))
    }

    /// A trial run on a new instance.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn probe_new(
        &mut self,
        parameters: &[f64],
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Probe, FmiError> {
        let plan = Arc::clone(&self.plan);
        match self.begin_new(&plan.start_values, parameters)? {
            true => self.finish_probe(steps, observer),
            false => Ok(Probe::Nothing),
        }
    }

    /// A trial run on this simulator's instance after a reset; `None` if there is none to reset, or reset fails.
    ///
    /// # Errors
    /// It was cancelled.
    pub(crate) fn probe_reset(
        &mut self,
        parameters: &[f64],
        steps: Option<u64>,
    ) -> Result<Option<Probe>, FmiError> {
        let plan = Arc::clone(&self.plan);
        self.probe_reset_with(&plan.start_values, parameters, steps, &mut Ignore)
    }

    /// The same with other start values.
    pub(crate) fn probe_reset_with(
        &mut self,
        start_values: &Assignments,
        parameters: &[f64],
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Option<Probe>, FmiError> {
        let Some(used) = self.system.retire() else { return Ok(None) };
        let Ok(instance) = Instance::from_used(used, self.plan.fmu().clone()) else { return Ok(None) };
        match self.begin_probe(instance, start_values, parameters) {
            true => self.finish_probe(steps, observer).map(Some),
            false => Ok(Some(Probe::Nothing)),
        }
    }

    /// A trial run on this simulator's instance after a run with other values and a reset, which shows whether reset
    /// leaves any of them behind; `None` if there is nothing left to reset, or reset fails.
    pub(crate) fn probe_after_others(
        &mut self,
        parameters: &[f64],
        steps: Option<u64>,
    ) -> Result<Option<Probe>, FmiError> {
        let (start_values, others) = self.plan.other_values(parameters);
        match self.probe_reset_with(&start_values, &others, Some(PROBE_STEPS), &mut Ignore)? {
            Some(_) => self.probe_reset(parameters, steps),
            None => Ok(None),
        }
    }

    /// Gives the instance back to the FMU, for whoever needs one next.
    pub(crate) fn park(&mut self) {
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn_if_dependent();
        let used = self.fresh.take().map(|instance| instance.into_raw().0).or_else(|| self.system.retire());
        if let Some(raw) = used
            && self.plan.fmu().reuse() != Some(Reuse::Reinstantiate)
        {
            self.plan.fmu().put_idle(raw, &self.plan.settings);
        }
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.park();
    }
}

/// Resets an instance, or makes a new one where that fails.
fn reset_or_replace(used: RawInstance, fmu: &Fmu) -> Result<Instance<Instantiated>, FmiError> {
    match Instance::from_used(used, fmu.clone()) {
        Ok(instance) => Ok(instance),
        Err(_) => {
            fmu.set_reuse(Reuse::Reinstantiate);
            fmu.instantiate()
        }
    }
}

/// The run itself.
fn drive(
    plan: &SimulationPlan,
    driver: &mut Driver,
    system: &mut System,
    observer: &mut dyn Observer,
) -> Result<Report, FmiError> {
    driver.run(system, plan.start, plan.end, &plan.times, observer).map_err(FmiError::Simulation)
}
