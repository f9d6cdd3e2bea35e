//! One worker's simulator: a plan, a live instance, a driver and buffers, run as often as one likes.

use crate::assign::{Assignments, resolve};
use crate::communication::Stepping;
use crate::description::Value;
use crate::error::FmiError;
use crate::fmu::{InstanceOptions, Reuse};
use crate::instance;
use crate::plan::SimulationPlan;
use crate::sys::{FloatEnvironment, InterfaceKind, RawInstance, Shared};
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
/// (see [`Fmu::reuse`](crate::Fmu::reuse)). Where a [`Pool`](crate::Pool) has found that instances of the library disturb
/// each other, a run waits until no other one is under way, and has a new instance if another one was made meanwhile.
///
/// ```compile_fail
/// fn shared_between_threads<T: Sync>() {}
/// shared_between_threads::<fmi::Simulator>();
/// ```
#[derive(Debug)]
pub struct Simulator {
    plan: Arc<SimulationPlan>,
    shared: Arc<Shared>,
    engine: Engine,
    /// A new or reset instance that has not been used yet.
    fresh: Option<RawInstance>,
}

/// What makes the steps: the driver, or the FMU itself.
#[derive(Debug)]
enum Engine {
    Integrated { driver: Box<Driver>, system: Box<System> },
    Stepping(Box<Stepping>),
}

/// The same call to whichever engine it is.
macro_rules! each {
    ($engine:expr, $run:ident => $call:expr) => {
        match $engine {
            Engine::Integrated { system: $run, .. } => $call,
            Engine::Stepping($run) => $call,
        }
    };
}

impl Engine {
    fn new(plan: &Arc<SimulationPlan>) -> Result<Self, FmiError> {
        Ok(match plan.kind {
            InterfaceKind::ModelExchange => Engine::Integrated {
                driver: Box::new(Driver::new(plan.options.clone())?),
                system: Box::new(System::new(Arc::clone(plan))),
            },
            InterfaceKind::CoSimulation => Engine::Stepping(Box::new(Stepping::new(Arc::clone(plan)))),
        })
    }

    fn adopt(&mut self, raw: RawInstance) {
        each!(self, run => run.adopt(raw));
    }

    fn retire(&mut self) -> Option<RawInstance> {
        each!(self, run => run.retire())
    }

    fn initialize(&mut self, raw: RawInstance, parameters: &[f64]) -> Result<(), FmiError> {
        each!(self, run => run.initialize(raw, parameters))
    }

    /// The run itself; `steps`: at most so many.
    fn run(
        &mut self,
        plan: &SimulationPlan,
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        let limited = |limits: ode::Limits| ode::Limits { max_steps: steps.or(limits.max_steps), ..limits };
        match self {
            Engine::Integrated { driver, system } => {
                let mut probe;
                let driver = if steps.is_none() {
                    driver
                } else {
                    let options =
                        ode::Options { limits: limited(plan.options.limits), ..plan.options.clone() };
                    probe = Driver::new(options)?;
                    &mut probe
                };
                driver
                    .run(&mut **system, plan.start, plan.end, &plan.times, observer)
                    .map_err(FmiError::Simulation)
            }
            Engine::Stepping(stepping) => stepping.run(&limited(plan.options.limits), observer),
        }
    }
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
        let mut engine = Engine::new(&plan)?;
        let mut fresh = None;
        let shared = Arc::clone(plan.fmu().library(plan.kind)?.shared());
        match plan.fmu().take_idle(plan.kind, &plan.settings) {
            Some(raw) => engine.adopt(raw),
            None => fresh = Some(new_instance(&plan)?),
        }
        Ok(Self { plan, shared, engine, fresh })
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
        self.engine.initialize(instance, parameters)?;
        // Instantiating or initializing may have changed the floating-point mode.
        guard.assert();
        self.engine.run(&self.plan, None, observer)
    }

    /// Simulates once and records all samples.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn trajectory(&mut self, parameters: &[f64]) -> Result<Trajectory, FmiError> {
        let mut recorder = Recorder::new(&self.plan);
        let report = self.run(parameters, &mut recorder)?;
        let ticks = each!(&mut self.engine, run => run.take_ticks());
        let buffers = each!(&self.engine, run => run.buffers());
        Ok(recorder.finish(&self.plan, &buffers.table, ticks, report))
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
        each!(&mut self.engine, run => run.value(&description.variables[index]))
    }

    /// As [`value`](Self::value), as a number: integers and Booleans too.
    ///
    /// # Errors
    /// As [`value`](Self::value); the variable is a text.
    pub fn get(&mut self, name: &str) -> Result<f64, FmiError> {
        match self.value(name)? {
            Value::Real(x) => Ok(x),
            Value::Integer(i) => Ok(i as f64),
            Value::Boolean(b) => Ok(f64::from(u8::from(b))),
            _ => Err(FmiError::NotAnOutput { name: name.to_owned(), reason: "it is no single number" }),
        }
    }

    /// Brings the FMU to its start without simulating: afterwards [`value`](Self::value) gives initial values.
    pub(crate) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.plan.check_parameters(parameters)?;
        let shared = Arc::clone(&self.shared);
        let _turn = shared.turn();
        let _guard = FloatEnvironment::standard();
        let instance = self.fresh_instance(parameters)?;
        self.engine.initialize(instance, parameters)?;
        match &mut self.engine {
            Engine::Integrated { system, .. } => system.settle(),
            Engine::Stepping(_) => Ok(()),
        }
    }

    /// A new instance, or one that was reset by a function that is known to do so.
    fn fresh_instance(&mut self, parameters: &[f64]) -> Result<RawInstance, FmiError> {
        let good = |raw: &RawInstance| !raw.is_stale();
        if let Some(raw) = self.fresh.take().filter(good) {
            return Ok(raw);
        }
        let plan = Arc::clone(&self.plan);
        let used = self.engine.retire().filter(good);
        let Some(used) = used.or_else(|| plan.fmu().take_idle(plan.kind, &plan.settings).filter(good)) else {
            return new_instance(&plan);
        };
        match plan.reuse() {
            Some(Reuse::Reset) => reset_or_replace(used, &plan),
            Some(Reuse::Reinstantiate) => {
                drop(used);
                new_instance(&self.plan)
            }
            None => self.check_reset(used, parameters),
        }
    }

    /// Compares the first steps of the reset instance with those of a new one, and returns an instance to use.
    fn check_reset(&mut self, used: RawInstance, parameters: &[f64]) -> Result<RawInstance, FmiError> {
        let plan = Arc::clone(&self.plan);
        self.engine.adopt(used);
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
        drop(self.engine.retire());
        let from_new = self.probe_new(parameters, steps, &mut Ignore)?;
        match (after_reset, from_new) {
            (Some(Probe::TimedOut), _) | (_, Probe::TimedOut) => {}
            (None | Some(Probe::Nothing), Probe::Nothing) => {}
            (after, new) if after == Some(new) => plan.set_reuse(Reuse::Reset),
            _ => plan.set_reuse(Reuse::Reinstantiate),
        }
        match (self.engine.retire(), plan.reuse()) {
            (Some(used), Some(Reuse::Reset)) => reset_or_replace(used, &plan),
            (used, _) => {
                drop(used);
                new_instance(&plan)
            }
        }
    }

    /// Brings an instance that is new or was reset to the start of a trial run; whether that went well.
    fn begin_probe(&mut self, raw: RawInstance, start_values: &Assignments, parameters: &[f64]) -> bool {
        let _guard = FloatEnvironment::standard();
        each!(&mut self.engine, run => run.initialize_with(raw, start_values, parameters)).is_ok()
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
        each!(&mut self.engine, run => run.begin_digest());
        let outcome = self.engine.run(&self.plan, steps, observer);
        let digest = each!(&mut self.engine, run => run.end_digest()).map_or(Probe::Nothing, Probe::Digest);
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
        let raw = match self.fresh.take() {
            Some(raw) => raw,
            None => {
                drop(self.engine.retire());
                new_instance(&self.plan)?
            }
        };
        Ok(self.begin_probe(raw, start_values, parameters))
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
        let Some(used) = self.engine.retire() else { return Ok(None) };
        let Ok(raw) = instance::reset(used, self.plan.fmu()) else { return Ok(None) };
        match self.begin_probe(raw, start_values, parameters) {
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
        let used = self.fresh.take().or_else(|| self.engine.retire());
        if let Some(raw) = used
            && self.plan.reuse() != Some(Reuse::Reinstantiate)
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

fn new_instance(plan: &SimulationPlan) -> Result<RawInstance, FmiError> {
    plan.fmu().instantiate_raw(plan.kind, &InstanceOptions::default())
}

/// Resets an instance, or makes a new one where that fails.
fn reset_or_replace(used: RawInstance, plan: &SimulationPlan) -> Result<RawInstance, FmiError> {
    match instance::reset(used, plan.fmu()) {
        Ok(raw) => Ok(raw),
        Err(_) => {
            plan.set_reuse(Reuse::Reinstantiate);
            new_instance(plan)
        }
    }
}
