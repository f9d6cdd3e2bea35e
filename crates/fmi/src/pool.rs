//! Lends each worker a simulator with an instance of its own; finds out how instances can be reused, and whether several
//! can be used at once.

use crate::archive::Snapshot;
use crate::error::FmiError;
use crate::fmu::{Reuse, Sharing};
use crate::plan::SimulationPlan;
use crate::simulation::Simulator;
use crate::sys::{Loan, Shared};
use crate::trial::Trial;
use std::ops::{Deref, DerefMut};
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// Simulators of one plan, for any number of workers.
///
/// Before the first one is lent, the FMU is tested with the plan itself, from start to end (of a simulation that takes
/// seconds: its first steps): a run on an instance that was brought back to its beginning, after one with other values,
/// while a second instance is run in between, and while another thread runs one at the same time, must have the same bits
/// as a run on a new instance. A way of bringing back that fails the test gives its place to the next (see [`Reuse`]). If instances disturb each other (or the FMU allows only one), the
/// same runs are tried with private copies of the library; if these do not help, one simulator is lent at a time, of all
/// pools whose FMUs have this library, and [`lend`](Self::lend) waits (see [`Sharing`]).
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
    written: Option<PathBuf>,
}

/// What the test found.
#[derive(Debug, Clone, Copy)]
struct Tested {
    reuse: Reuse,
    sharing: Sharing,
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
        plan.values.check_parameters(reference)?;
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

    /// Whether several simulators can run at the same time.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn is_concurrent(&self) -> Result<bool, FmiError> {
        self.sharing().map(|sharing| sharing != Sharing::OneAtATime)
    }

    /// How the simulators share the process.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn sharing(&self) -> Result<Sharing, FmiError> {
        let mut state = self.state();
        let tested = self.test(&mut state)?;
        let shared = self.shared()?;
        Ok(match tested.sharing {
            // Found by another pool since.
            Sharing::Together if shared.is_dependent() => of_dependent(shared.copies_work()),
            sharing => sharing,
        })
    }

    /// A file below the FMU's `resources` that the trial runs wrote, made or removed. All instances share the resources,
    /// so simulations run one at a time then.
    ///
    /// # Errors
    /// The FMU has to be tested first and cannot be instantiated.
    pub fn written_resource(&self) -> Result<Option<PathBuf>, FmiError> {
        let mut state = self.state();
        self.test(&mut state)?;
        Ok(state.written.clone())
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
        while tested.sharing == Sharing::OneAtATime && state.lent > 0 {
            state = self.returned.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.lent += 1;
        let idle = state.idle.pop();
        drop(state);
        let (simulator, loan) = self.simulator(idle);
        match simulator {
            Ok(simulator) => Ok(Lease { pool: self, simulator: Some(simulator), loan }),
            Err(error) => {
                self.state().lent -= 1;
                self.returned.notify_one();
                Err(error)
            }
        }
    }

    /// The idle simulator or a new one, and the loan of the library where it is not one of its own and instances disturb
    /// each other.
    fn simulator(&self, idle: Option<Simulator>) -> (Result<Simulator, FmiError>, Option<Loan>) {
        let made = || Simulator::new(Arc::clone(&self.plan));
        let shared = self.shared();
        let borrow = |shared: &Arc<Shared>| shared.is_dependent().then(|| shared.borrow_alone());
        let loan = || shared.as_ref().ok().and_then(borrow);
        if let Some(idle) = idle {
            let loan = if idle.has_copy() { None } else { loan() };
            return (Ok(idle), loan);
        }
        let copies_work = shared.as_ref().is_ok_and(|shared| shared.copies_work() == Some(true));
        if !copies_work {
            // The loan first: the instance made last may be the only one that is right.
            let loan = loan();
            return (made(), loan);
        }
        match self.plan.fmu().private_copy(self.plan.kind) {
            Ok(copy) => (Simulator::with_library(Arc::clone(&self.plan), Some(copy)), None),
            Err(error) => {
                log::warn!("simulations take turns: {error}");
                let loan = loan();
                (Simulator::with_library(Arc::clone(&self.plan), None), loan)
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
        let resources = Snapshot::of(&self.plan.fmu().running_root()?.join("resources"));
        let mut simulator = Simulator::new(Arc::clone(&self.plan))?;
        let examined = self.examine(&mut simulator)?;
        state.written = resources.first_change();
        let Some(mut tested) = examined else {
            // It says nothing about the FMU, so it binds nobody but this pool.
            log::warn!(
                "{}: the model cannot be simulated at {:?}, so reset and concurrency cannot be tested; simulations run \
                 one at a time",
                self.plan.fmu().description().model_name,
                self.reference
            );
            let cautious = Tested { reuse: Reuse::Reinstantiate, sharing: Sharing::OneAtATime };
            if shared.is_dependent() {
                simulator.park();
            }
            state.idle.push(simulator);
            state.tested = Some(cautious);
            return Ok(cautious);
        };
        if let Some(file) = &state.written {
            log::warn!(
                "{}: simulations write into the resources, which all instances share: {}",
                self.plan.fmu().description().model_name,
                file.display()
            );
            // Copies of the library would share them too.
            tested.sharing = Sharing::OneAtATime;
            shared.set_copies_work(false);
            shared.set_dependent();
        }
        self.plan.set_reuse(tested.reuse);
        if tested.reuse == Reuse::Reinstantiate {
            log::warn!(
                "{}: instances cannot be brought back to their beginning; every simulation gets a new one",
                self.plan.fmu().description().model_name
            );
        }
        if tested.sharing == Sharing::OneAtATime {
            log::warn!(
                "{}: several instances at once cannot be relied on; simulations run one at a time",
                self.plan.fmu().description().model_name
            );
        }
        if shared.is_dependent() {
            // For some FMUs the instance made last is the only one that is right: none stays beside the one in use.
            simulator.park();
            shared.free_spares();
        }
        if tested.sharing != Sharing::PrivateCopies {
            state.idle.push(simulator);
        }
        state.tested = Some(tested);
        Ok(tested)
    }

    /// The trial runs; `None`: they say nothing.
    fn examine(&self, simulator: &mut Simulator) -> Result<Option<Tested>, FmiError> {
        let plan = &self.plan;
        let Some(trial) = Trial::new(plan, &self.reference, simulator)? else { return Ok(None) };
        let Some(reuse) = trial.reuse(simulator)? else { return Ok(None) };
        let shared = self.shared()?;
        if !shared.is_dependent() {
            let make = || Simulator::with_library(Arc::clone(plan), None);
            match trial.independent(&make, simulator, reuse)? {
                None => return Ok(None),
                Some(true) => return Ok(Some(Tested { reuse, sharing: Sharing::Together })),
                Some(false) => shared.set_dependent(),
            }
        }
        simulator.park();
        shared.free_spares();
        if shared.copies_work().is_none()
            && let Some(work) = trial.copies_work(reuse)?
        {
            shared.set_copies_work(work);
        }
        Ok(Some(Tested { reuse, sharing: of_dependent(shared.copies_work()) }))
    }
}

/// How simulations share the process where instances of one library disturb each other.
fn of_dependent(copies_work: Option<bool>) -> Sharing {
    if copies_work == Some(true) { Sharing::PrivateCopies } else { Sharing::OneAtATime }
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
