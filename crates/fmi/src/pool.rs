//! Lends each worker a simulator with an instance of its own; finds out how instances can be reused, and whether several
//! can be used at once.

use crate::error::FmiError;
use crate::fmu::Reuse;
use crate::plan::SimulationPlan;
use crate::simulation::Simulator;
use crate::sys::{Loan, Shared};
use crate::trial::Trial;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Simulators of one plan, for any number of workers.
///
/// Before the first one is lent, the FMU is tested with the plan itself, from start to end (of a simulation that takes
/// seconds: its first steps): a run on an instance that was brought back to its beginning, after one with other values,
/// while a second instance is run in between, and while another thread runs one at the same time, must have the same bits
/// as a run on a new instance. A way of bringing back that fails the test gives its place to the next (see [`Reuse`]). If instances disturb each other (or the FMU allows only one), one
/// simulator is lent at a time, of all pools whose FMUs have this library, and [`lend`](Self::lend) waits.
#[derive(Debug)]
pub struct Pool {
    plan: Arc<SimulationPlan>,
    /// Parameters of the test.
    reference: Vec<f64>,
    state: Mutex<State>,
    returned: Condvar,
}

#[derive(Debug, Default)]
struct State {
    idle: Vec<Simulator>,
    lent: usize,
    tested: Option<Tested>,
}

/// What the test found.
#[derive(Debug, Clone, Copy)]
struct Tested {
    reuse: Reuse,
    independent: bool,
}

/// A simulator on loan; it goes back to its pool on drop.
#[derive(Debug)]
pub struct Lease<'a> {
    pool: &'a Pool,
    /// `None` only while it is dropped.
    simulator: Option<Simulator>,
    /// Where instances disturb each other. Given back after the instance.
    loan: Option<Loan>,
}

impl Pool {
    /// A pool of simulators of this plan. Nothing is loaded or run yet. The test is made with the values that the
    /// parameters have in the model.
    pub fn new(plan: Arc<SimulationPlan>) -> Self {
        let reference = plan.parameter_starts().to_vec();
        Self { plan, reference, state: Mutex::default(), returned: Condvar::new() }
    }

    /// The same, with the test made at other values of the parameters: where the model can be simulated at all.
    ///
    /// # Errors
    /// A value is not finite, or there are not as many as parameters.
    pub fn with_reference(plan: Arc<SimulationPlan>, reference: &[f64]) -> Result<Self, FmiError> {
        plan.check_parameters(reference)?;
        Ok(Self { reference: reference.to_vec(), ..Self::new(plan) })
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// How instances are brought back to their beginning.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn reuse(&self) -> Result<Reuse, FmiError> {
        let mut state = self.state();
        self.test(&mut state)
            .map(|tested| self.plan.reuse().map_or(tested.reuse, |known| known.max(tested.reuse)))
    }

    /// Whether several instances can be used at the same time.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn is_concurrent(&self) -> Result<bool, FmiError> {
        let mut state = self.state();
        let tested = self.test(&mut state)?;
        Ok(tested.independent && !self.shared()?.is_dependent())
    }

    /// Lends a simulator: an idle one, else a new one. Where only one may be used at a time, waits until it is returned
    /// (to its pool, if that is another one of the same library); a thread that keeps a lease and asks for a second one
    /// then waits for itself.
    ///
    /// # Errors
    /// The FMU cannot be loaded or instantiated.
    pub fn lend(&self) -> Result<Lease<'_>, FmiError> {
        let mut state = self.state();
        let tested = self.test(&mut state)?;
        while !tested.independent && state.lent > 0 {
            state = self.returned.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.lent += 1;
        let idle = state.idle.pop();
        drop(state);
        let shared = self.shared();
        let loan = shared.ok().filter(|shared| shared.is_dependent()).map(|shared| shared.borrow_alone());
        let simulator = match idle {
            Some(simulator) => Ok(simulator),
            None => Simulator::new(Arc::clone(&self.plan)),
        };
        match simulator {
            Ok(simulator) => Ok(Lease { pool: self, simulator: Some(simulator), loan }),
            Err(error) => {
                self.state().lent -= 1;
                self.returned.notify_one();
                Err(error)
            }
        }
    }

    /// What all users of the library share.
    fn shared(&self) -> Result<Arc<Shared>, FmiError> {
        Ok(Arc::clone(self.plan.fmu().library(self.plan.kind)?.shared()))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tests the FMU, once. The lock is held meanwhile: nobody can use a simulator before the test is over.
    fn test(&self, state: &mut State) -> Result<Tested, FmiError> {
        if let Some(tested) = state.tested {
            return Ok(tested);
        }
        let shared = self.shared()?;
        let interface = self.plan.fmu().check_interface(self.plan.kind)?;
        let only_one = interface.capabilities.can_be_instantiated_only_once_per_process;
        if only_one {
            shared.set_dependent();
        }
        let _loan = shared.is_dependent().then(|| shared.borrow_alone());
        let _turn = shared.turn();
        let mut simulator = Simulator::new(Arc::clone(&self.plan))?;
        let Some(tested) = self.examine(&mut simulator)? else {
            // It says nothing about the FMU, so it binds nobody but this pool.
            log::warn!(
                "{}: the model cannot be simulated at {:?}, so reset and concurrency cannot be tested; simulations run \
                 one at a time",
                self.plan.fmu().description().model_name,
                self.reference
            );
            let cautious = Tested { reuse: Reuse::Reinstantiate, independent: false };
            if shared.is_dependent() {
                simulator.park();
            }
            state.idle.push(simulator);
            state.tested = Some(cautious);
            return Ok(cautious);
        };
        self.plan.set_reuse(tested.reuse);
        if tested.reuse == Reuse::Reinstantiate {
            log::warn!(
                "{}: instances cannot be brought back to their beginning; every simulation gets a new one",
                self.plan.fmu().description().model_name
            );
        }
        if !tested.independent {
            log::warn!(
                "{}: several instances at once cannot be relied on; simulations run one at a time",
                self.plan.fmu().description().model_name
            );
            // For some FMUs the instance made last is the only one that is right: none stays beside the one in use.
            shared.set_dependent();
            simulator.park();
            shared.free_spares();
        }
        state.idle.push(simulator);
        state.tested = Some(tested);
        Ok(tested)
    }

    /// The trial runs; `None`: they say nothing.
    fn examine(&self, simulator: &mut Simulator) -> Result<Option<Tested>, FmiError> {
        let plan = &self.plan;
        let Some(trial) = Trial::new(plan, &self.reference, simulator)? else { return Ok(None) };
        let Some(reuse) = trial.reuse(simulator)? else { return Ok(None) };
        if simulator.shared().is_dependent() {
            return Ok(Some(Tested { reuse, independent: false }));
        }
        let make = || Simulator::new(Arc::clone(plan));
        let independent = trial.independent(&make, simulator, reuse)?;
        Ok(independent.map(|independent| Tested { reuse, independent }))
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
        let mut simulator = self.simulator.take();
        if let Some((simulator, _)) = simulator.as_mut().zip(self.loan.as_ref()) {
            // Other pools of this library need the place of its instance.
            simulator.park();
        }
        let mut state = self.pool.state();
        state.lent -= 1;
        state.idle.extend(simulator);
        drop(state);
        self.pool.returned.notify_one();
    }
}
