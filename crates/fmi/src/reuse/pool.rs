//! Lends each worker a simulator, and checks how instances can be reset.

use super::runner::Runner;
use super::simulator::Simulator;
use super::trial::{Trial, Watch};
use super::verdict::Reuse;
use crate::error::FmiError;
use crate::simulation::Sharing;
use crate::simulation::plan::SimulationPlan;
use std::ops::{Deref, DerefMut};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Simulators of one plan, for any number of workers, which share the FMU's library as [`SimulateOptions::sharing`](crate::SimulateOptions) says (see [`Sharing`]).
///
/// Before the first one is lent, the ways of resetting an instance are checked with the plan itself, from start to end (of a
/// simulation that takes seconds: its first steps), in one thread: a run on an instance that was reset, after one with other
/// values, must have the same bits as a run on a new instance. A way that fails the check gives its place to the next (see
/// [`Reuse`]). No two threads are in one loaded copy of the library, in the check or later, unless that was asked for.
#[derive(Debug)]
pub struct Pool {
    plan: Arc<SimulationPlan>,
    /// Parameters of the check.
    reference: Vec<f64>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    idle: Vec<Simulator>,
    checked: Option<Reuse>,
    written: Option<PathBuf>,
}

/// A simulator that is lent; it goes back to its pool on drop. Meanwhile it keeps its copy of the library, and the values of
/// its last run.
#[derive(Debug)]
pub struct Lease<'a> {
    pool: &'a Pool,
    /// `None` only while it is dropped.
    simulator: Option<Simulator>,
}

impl Pool {
    /// A pool of simulators of this plan. Nothing is loaded or run yet. The check is made with
    /// the values that the parameters have in the model.
    pub fn new(plan: Arc<SimulationPlan>) -> Self {
        let reference = plan.parameter_starts().to_vec();
        Self { plan, reference, state: Mutex::default() }
    }

    /// The same, with the check made at other values of the parameters: where the model can be simulated at all.
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters.
    pub fn with_reference(plan: Arc<SimulationPlan>, reference: &[f64]) -> Result<Self, FmiError> {
        plan.values.check_parameters(reference)?;
        Ok(Self { reference: reference.to_vec(), ..Self::new(plan) })
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Checks how instances are reset, if it was not yet. `cancelled` is asked before every step; a check that it ended is made again
    /// by the next call that needs it.
    ///
    /// # Errors
    /// The FMU cannot be instantiated; [`FmiError::Cancelled`].
    pub fn prepare(&self, cancelled: &dyn Fn() -> bool) -> Result<(), FmiError> {
        self.check(&mut self.state(), cancelled).map(|_| ())
    }

    /// How instances are reset.
    ///
    /// # Errors
    /// The FMU has to be checked first and cannot be instantiated.
    pub fn reuse(&self) -> Result<Reuse, FmiError> {
        let checked = self.check(&mut self.state(), &|| false)?;
        let known = self.plan.fmu().reuse_of(self.plan.kind());
        Ok(known.map_or(checked, |known| known.max(checked)))
    }

    /// Whether several simulators can run at the same time.
    ///
    /// # Errors
    /// As [`sharing`](Self::sharing).
    pub fn is_concurrent(&self) -> Result<bool, FmiError> {
        self.sharing().map(|sharing| sharing != Sharing::Serial)
    }

    /// How the simulators share the process: as was asked for, or one at a time where copies of the library would still
    /// share state.
    ///
    /// # Errors
    /// The FMU has to be checked first and cannot be instantiated.
    pub fn sharing(&self) -> Result<Sharing, FmiError> {
        self.check(&mut self.state(), &|| false)?;
        match self.plan.sharing {
            Sharing::Copies => self.plan.fmu().store(self.plan.kind()).map(|store| store.sharing()),
            asked => Ok(asked),
        }
    }

    /// A file below the FMU's `resources` that the runs of the check wrote, made or removed. Every simulation gets a copy of the
    /// library with resources of its own then ([`Reuse::Reload`]).
    ///
    /// # Errors
    /// The FMU has to be checked first and cannot be instantiated.
    pub fn written_resource(&self) -> Result<Option<PathBuf>, FmiError> {
        let mut state = self.state();
        self.check(&mut state, &|| false)?;
        Ok(state.written.clone())
    }

    /// Lends a simulator: an idle one, else a new one. Its runs wait where only one can run at a time; a thread that keeps a
    /// lease and runs with a second one is refused then ([`FmiError::NoCopy`]), for it would wait for itself.
    ///
    /// # Errors
    /// The FMU cannot be loaded or instantiated.
    pub fn lend(&self) -> Result<Lease<'_>, FmiError> {
        self.lend_until(&|| false)
    }

    /// As [`lend`](Self::lend), with a check as [`prepare`](Self::prepare) makes it.
    ///
    /// # Errors
    /// As [`lend`](Self::lend), and [`FmiError::Cancelled`].
    pub fn lend_until(&self, cancelled: &dyn Fn() -> bool) -> Result<Lease<'_>, FmiError> {
        let mut state = self.state();
        self.check(&mut state, cancelled)?;
        let idle = state.idle.pop();
        drop(state);
        let mut simulator = match idle {
            Some(simulator) => simulator,
            None => Simulator::new(Arc::clone(&self.plan))?,
        };
        simulator.pin(true);
        Ok(Lease { pool: self, simulator: Some(simulator) })
    }

    /// Makes a run in the copy of each simulator that lies in the pool, and in a newly loaded one: whether what ran before was
    /// found to make a difference (see [`Fmu::n_history_findings`](crate::Fmu::n_history_findings)). `cancelled` is asked before
    /// every step.
    ///
    /// # Errors
    /// The wrong number of parameters; a run fails; there is no new instance to be had.
    pub fn depends_on_history(
        &self,
        parameters: &[f64],
        cancelled: &dyn Fn() -> bool,
    ) -> Result<bool, FmiError> {
        self.plan.values.check_parameters(parameters)?;
        let mut idle = std::mem::take(&mut self.state().idle);
        let found = idle.iter_mut().try_fold(false, |found, simulator| {
            Ok(found || (!cancelled() && simulator.runner().verify(parameters, cancelled)?))
        });
        self.state().idle.append(&mut idle);
        found
    }

    /// A simulator in a newly loaded copy of the library, which stays there: its runs are none that others follow, so they can be
    /// compared with those of the pool. `None`: there is no such copy to be had, or every run has one anyway.
    ///
    /// # Errors
    /// The FMU cannot be loaded.
    pub fn simulator_in_new_copy(&self) -> Result<Option<Simulator>, FmiError> {
        let mut simulator = Simulator::new(Arc::clone(&self.plan))?;
        let is_there = simulator.runner().ensure_new_copy()?;
        Ok(is_there.then_some(simulator))
    }

    /// Notes that a run of the pool was seen to differ from the same one in a newly loaded copy of the library: where such are the
    /// same in two of them, every run has a copy of its own from now on.
    ///
    /// # Errors
    /// The FMU cannot be loaded.
    pub fn note_difference(&self, is_reproducible: bool) -> Result<(), FmiError> {
        let (fmu, kind) = (self.plan.fmu(), self.plan.kind());
        match is_reproducible {
            true => fmu.note_history(kind, Reuse::Reload),
            false => fmu.note_not_reproducible(kind),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks the ways of resetting, once. The lock is held meanwhile: nobody can use a simulator before the check is over.
    fn check(&self, state: &mut State, cancelled: &dyn Fn() -> bool) -> Result<Reuse, FmiError> {
        if let Some(checked) = state.checked {
            return Ok(checked);
        }
        let fmu = self.plan.fmu();
        let model = &fmu.description().model_name;
        let mut simulator = Simulator::new(Arc::clone(&self.plan))?;
        let mut runner = simulator.runner();
        runner.ensure_copy(None)?;
        let examined = self.examine(&mut runner, cancelled);
        let store = fmu.store(self.plan.kind())?;
        state.written = store.written_resource();
        let reuse = if runner.is_fatal() {
            // Nothing was shown but that resetting is not the trouble.
            Reuse::Reinstantiate
        } else {
            examined?.unwrap_or_else(|| {
                log::warn!(
                    "{model}: the model cannot be simulated at {:?}, so reset is checked by later simulations, with less",
                    self.reference
                );
                Reuse::Reinstantiate
            })
        };
        if let Some(file) = &state.written {
            fmu.note_written_resource(&store, self.plan.kind(), file)?;
        }
        drop(runner);
        state.idle.push(simulator);
        state.checked = Some(reuse);
        Ok(reuse)
    }

    /// The runs of the check; `None`: they say nothing.
    fn examine(&self, runner: &mut Runner, cancelled: &dyn Fn() -> bool) -> Result<Option<Reuse>, FmiError> {
        let mut watch = Watch::new(cancelled);
        let trial = Trial::new(&self.plan, &self.reference, runner, &mut watch)?;
        let Some(trial) = trial else { return Ok(None) };
        let reuse = trial.reuse(runner, &mut watch)?;
        if let Some(reuse) = reuse {
            runner.set_reuse(reuse);
        }
        Ok(reuse)
    }
}

impl Deref for Lease<'_> {
    type Target = Simulator;

    fn deref(&self) -> &Simulator {
        match &self.simulator {
            Some(simulator) => simulator,
            None => unreachable!("a lease has its simulator until it is dropped"),
        }
    }
}

impl DerefMut for Lease<'_> {
    fn deref_mut(&mut self) -> &mut Simulator {
        match &mut self.simulator {
            Some(simulator) => simulator,
            None => unreachable!("a lease has its simulator until it is dropped"),
        }
    }
}

impl Drop for Lease<'_> {
    fn drop(&mut self) {
        if let Some(mut simulator) = self.simulator.take() {
            simulator.pin(false);
            self.pool.state().idle.push(simulator);
        }
    }
}
