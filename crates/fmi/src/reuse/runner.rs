//! What a simulator has while it has a loaded copy of the library: an instance, the way of resetting it, buffers.

use super::copy_use::{CopyOwner, CopyRequest, Release};
use super::earlier_run::{EarlierRun, PreviousCopy};
use super::lend::CopyLease;
use super::verdict::Reuse;
use crate::description::{Causality, QuirkKind, Value, Variable};
use crate::error::FmiError;
use crate::simulation::Sharing;
use crate::simulation::digest::Digest;
use crate::simulation::engine::Engine;
use crate::simulation::plan::{ReadBackBuffers, Setting, SimulationPlan};
use crate::simulation::running::no_instance;
use crate::sys::{CallEnvironment, InterfaceKind, Library, RawInstance};
use ode::{ErrorKind, Ignore, Number, Observer, Report, Seconds, SimulationError, Stats};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError, Weak};
use std::thread::ThreadId;
use std::time::Instant;

/// One plan and what its runs use, in one thread at a time.
#[derive(Debug)]
pub(crate) struct Runner {
    pub(crate) plan: Arc<SimulationPlan>,
    pub(crate) engine: Engine,
    /// A new or reset instance that has not been used yet.
    pub(crate) fresh: Option<RawInstance>,
    buffers: ReadBackBuffers,
    /// When the start of the present run began: what was made to test the model before does not count.
    pub(crate) began: Instant,
    sharing: Sharing,
    /// Itself, for those who need its copy.
    owner: Weak<SharedRunner>,
    /// The copy was needed for another owner.
    is_released: bool,
    /// Its runs are those with which others are compared: they are not looked into themselves.
    pub(crate) is_trial: bool,
    /// What is set in the present copy besides the settings of the plan.
    pub(crate) prepared: Option<Prepared>,
    /// The copy that it goes back to, after a run in another one.
    pub(crate) previous: Option<PreviousCopy>,
    /// Given back after the instances.
    pub(crate) lease: Option<CopyLease>,
}

/// What is set in runs in a copy with this record.
#[derive(Debug)]
pub(crate) struct Prepared {
    /// Number of variables in the record.
    pub(crate) n_recorded: usize,
    /// Everything that a run sets, sorted.
    pub(crate) settings: Arc<[Setting]>,
}

/// A runner that can be asked to give its copy up.
#[derive(Debug)]
pub(crate) struct SharedRunner {
    runner: Mutex<Runner>,
    /// The copy is kept between runs.
    pinned: AtomicBool,
    /// It lies in a pool: nobody asks for the values of its last run.
    in_pool: AtomicBool,
    /// The thread that uses it, or has pinned it.
    user: Mutex<Option<ThreadId>>,
}

/// Use of a runner by one thread; waiting owners look again when it is over.
pub(crate) struct RunnerGuard<'a> {
    shared: &'a SharedRunner,
    runner: Option<MutexGuard<'a, Runner>>,
}

impl SharedRunner {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Result<Arc<Self>, FmiError> {
        let engine = Engine::new(&plan)?;
        // The flag is one per loaded copy.
        let interface = plan.fmu().check_interface(plan.kind)?;
        let only_one = interface.capabilities.can_be_instantiated_only_once_per_process;
        let sharing = if only_one && plan.sharing == Sharing::Together {
            log::warn!(
                "{}: the FMU allows one instance per loaded library, so simulators have copies of it",
                plan.fmu().description().model_name
            );
            Sharing::Copies
        } else {
            plan.sharing
        };
        Ok(Arc::new_cyclic(|owner| Self {
            runner: Mutex::new(Runner {
                plan,
                engine,
                fresh: None,
                buffers: ReadBackBuffers::default(),
                began: Instant::now(),
                sharing,
                owner: Weak::clone(owner),
                is_released: false,
                is_trial: false,
                prepared: None,
                previous: None,
                lease: None,
            }),
            pinned: AtomicBool::new(false),
            in_pool: AtomicBool::new(false),
            user: Mutex::new(None),
        }))
    }

    /// Keeps the copy between runs, or lets others have it, to whom its values mean nothing.
    pub(crate) fn pin(&self, pinned: bool) {
        self.in_pool.store(!pinned, Ordering::Release);
        *self.user() = pinned.then(|| std::thread::current().id());
        self.pinned.store(pinned, Ordering::Release);
        if !pinned {
            self.notify();
        }
    }

    /// Uses the runner.
    pub(crate) fn enter(&self) -> RunnerGuard<'_> {
        let runner = self.runner.lock().unwrap_or_else(PoisonError::into_inner);
        *self.user() = Some(std::thread::current().id());
        RunnerGuard { shared: self, runner: Some(runner) }
    }

    fn user(&self) -> MutexGuard<'_, Option<ThreadId>> {
        self.user.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waiting or kept: kept if this thread would wait for itself.
    fn waits(&self) -> Release {
        if *self.user() == Some(std::thread::current().id()) { Release::Kept } else { Release::Busy }
    }

    fn notify(&self) {
        let runner = self.runner.lock().unwrap_or_else(PoisonError::into_inner);
        let store = runner.lease.as_ref().map(|lease| Arc::clone(lease.store()));
        drop(runner);
        if let Some(store) = store {
            store.notify();
        }
    }
}

impl CopyOwner for SharedRunner {
    fn release(&self) -> Release {
        let mut runner = match self.runner.try_lock() {
            Ok(runner) => runner,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return self.waits(),
        };
        if self.pinned.load(Ordering::Acquire) {
            return self.waits();
        }
        runner.release_copy();
        runner.is_released = true;
        Release::Done
    }

    fn is_in_pool(&self) -> bool {
        self.in_pool.load(Ordering::Acquire)
    }
}

impl std::ops::Deref for RunnerGuard<'_> {
    type Target = Runner;

    fn deref(&self) -> &Runner {
        match &self.runner {
            Some(runner) => runner,
            None => unreachable!("taken only when it is dropped"),
        }
    }
}

impl std::ops::DerefMut for RunnerGuard<'_> {
    fn deref_mut(&mut self) -> &mut Runner {
        match &mut self.runner {
            Some(runner) => runner,
            None => unreachable!("taken only when it is dropped"),
        }
    }
}

impl Drop for RunnerGuard<'_> {
    fn drop(&mut self) {
        let Some(runner) = self.runner.take() else { return };
        let store = runner.lease.as_ref().map(|lease| Arc::clone(lease.store()));
        if !self.shared.pinned.load(Ordering::Acquire) {
            *self.shared.user() = None;
        }
        drop(runner);
        if let Some(store) = store {
            store.notify();
        }
    }
}

impl Runner {
    /// The functions of the copy.
    pub(crate) fn library(&self) -> Result<&Arc<Library>, FmiError> {
        self.lease.as_ref().map(CopyLease::library).ok_or_else(no_instance)
    }

    /// How instances are reset, as far as is known for what is set in this copy.
    pub(crate) fn reuse(&self) -> Option<Reuse> {
        let lease = self.lease.as_ref()?;
        lease.store().verdict(self.plan.kind).reuse_for(self.settings())
    }

    fn settings(&self) -> &Arc<[Setting]> {
        self.prepared.as_ref().map_or(&self.plan.settings, |prepared| &prepared.settings)
    }

    /// Stores what trial runs have shown; without a step they show nothing good.
    pub(crate) fn set_reuse(&self, reuse: Reuse) {
        if self.plan.end <= self.plan.start && reuse != Reuse::Reinstantiate {
            return;
        }
        let Some(lease) = &self.lease else { return };
        lease.store().verdict(self.plan.kind).set_reuse(reuse, self.settings());
    }

    /// Whether instances may be brought back by a saved state, as far as is known. Not in co-simulation: some models abort
    /// the process when they are initialized after it (seen in Dymola's, whose solver is no part of the state), and reset
    /// is as fast.
    pub(crate) fn may_restore(&self) -> bool {
        let interface = self.plan.fmu().check_interface(self.plan.kind);
        self.plan.kind == InterfaceKind::ModelExchange
            && interface.is_ok_and(|interface| interface.capabilities.can_get_and_set_state)
            && self.lease.as_ref().is_some_and(|lease| !lease.store().verdict(self.plan.kind).no_restore)
    }

    /// Saved states were found not to bring instances back.
    pub(crate) fn refuse_restore(&self) {
        if let Some(lease) = &self.lease {
            lease.store().verdict(self.plan.kind).refuse_restore();
        }
    }

    /// Gets a copy of the library, if there is none or it has answered `Fatal`, and finds out what is to be set in it.
    ///
    /// # Errors
    /// The library cannot be loaded; there is no copy to be had; `observer` or the plan has cancelled the simulation.
    pub(crate) fn ensure_copy(&mut self, observer: Option<&mut dyn Observer>) -> Result<(), FmiError> {
        self.return_to_copy();
        let is_over = |lease: &CopyLease| {
            lease.is_fatal() || (lease.copy().is_used() && self.reuse() == Some(Reuse::Reload))
        };
        if self.lease.as_ref().is_none_or(is_over) {
            self.release_copy();
            self.lease = Some(self.lend(observer)?);
            self.is_released = false;
        }
        self.prepare()
    }

    #[cold]
    fn lend(&self, mut observer: Option<&mut dyn Observer>) -> Result<CopyLease, FmiError> {
        let fmu = self.plan.fmu().clone();
        let cancel = self.plan.options.cancel.clone();
        let store = match fmu.store_unless(self.plan.kind, &cancel.clone().into()) {
            Err(FmiError::Cancelled) => return Err(self.cancelled()),
            store => store?,
        };
        // Somebody may have removed what was unpacked.
        fmu.running_root()?;
        let mut wait = || {
            let stopped = observer.as_mut().is_some_and(|observer| observer.poll().is_break());
            !stopped && !cancel.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed))
        };
        let lease = store.lend(&self.request(), &mut wait)?;
        lease.ok_or_else(|| self.cancelled())
    }

    /// The error of a simulation that was cancelled before it began.
    fn cancelled(&self) -> FmiError {
        FmiError::Simulation(Box::new(SimulationError {
            kind: ErrorKind::Cancelled,
            time: self.plan.start,
            step: 0.0,
            worst_state: None,
            last_event: None,
            not_finite: None,
            undetermined: None,
            refusal: None,
            stats: Stats::default(),
        }))
    }

    /// What is asked of the store.
    pub(crate) fn request(&self) -> CopyRequest {
        let owner: Weak<dyn CopyOwner> = self.owner.clone();
        let (fmu, kind) = (self.plan.fmu().clone(), self.plan.kind);
        CopyRequest { fmu, kind, sharing: self.sharing, owner: Some(owner) }
    }

    /// Gives the copy back, with the instance for whoever needs one next.
    pub(crate) fn release_copy(&mut self) {
        self.return_to_copy();
        let raw = self.fresh.take().or_else(|| self.engine.running().retire());
        let keeps = self.reuse() < Some(Reuse::Reinstantiate);
        self.prepared = None;
        let Some(lease) = self.lease.take() else { return };
        match raw {
            Some(raw) if keeps => lease.copy().put_idle(self.plan.kind, self.plan.fmu().logging(), raw),
            raw => drop(raw),
        }
        if self.is_trial {
            lease.retire();
        }
    }

    /// Goes on with a plan that fits.
    pub(super) fn set_plan(&mut self, plan: &Arc<SimulationPlan>) {
        self.plan = Arc::clone(plan);
        self.engine.running().set_plan(Arc::clone(plan));
    }

    pub(super) fn run(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        self.ensure_copy(Some(&mut *observer))?;
        if self.is_trial {
            return self.run_here(None, parameters, observer);
        }
        let earlier = self.compare_if_due(parameters, observer)?;
        let may_depend_on_earlier = earlier.is_none() && self.is_copy_used();
        match self.run_here(earlier, parameters, observer) {
            Err(error) if may_depend_on_earlier && self.fails_by_history(&error, parameters, observer) => {
                Err(FmiError::FailedByHistory { library: self.plan.fmu().path().to_owned() })
            }
            outcome => outcome,
        }
    }

    /// Whether there was a run in the present copy before.
    fn is_copy_used(&self) -> bool {
        self.lease.as_ref().is_some_and(|lease| lease.library().shared().is_used())
    }

    /// The run itself, in the present copy; compared with what the same run has shown in another one.
    pub(crate) fn run_here(
        &mut self,
        earlier: Option<EarlierRun>,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        let _environment = CallEnvironment::enter();
        if let Err(error) = self.start(parameters) {
            let outcome = Err(error);
            if let Some(earlier) = earlier {
                self.judge(&earlier, &outcome, parameters, observer)?;
            }
            return outcome;
        }
        let starting = self.began.elapsed().as_secs_f64();
        if earlier.is_some() {
            self.engine.running().begin_digest(Digest::with_way());
        }
        let mut outcome = self.engine.run(&self.plan, None, observer);
        let input_functions = self.engine.running().seconds_in_input_functions();
        self.engine.running().pass_log_on();
        if let Some(earlier) = earlier {
            self.judge(&earlier, &outcome, parameters, observer)?;
        }
        let stats = match &mut outcome {
            Ok(report) => &mut report.stats,
            Err(FmiError::Simulation(error)) => &mut error.stats,
            Err(_) => return outcome,
        };
        stats.seconds += Seconds::new(starting);
        // All of the start is the model's doing, and all calls of the run are, but input functions of the user are not.
        let in_calls = starting + stats.seconds_in_model.get();
        stats.seconds_in_model = Seconds::new(in_calls.min(stats.seconds.get() - input_functions).max(0.0));
        outcome
    }

    pub(super) fn value(&mut self, variable: &Variable) -> Result<Value, FmiError> {
        if self.is_released {
            return Err(FmiError::Disturbed { library: self.plan.fmu().path().to_owned() });
        }
        self.engine.value(variable)
    }

    pub(super) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.ensure_copy(None)?;
        let may_depend_on_earlier = self.is_copy_used();
        match self.initialize_here(parameters) {
            Err(error) if may_depend_on_earlier && self.fails_by_history(&error, parameters, &mut Ignore) => {
                self.ensure_copy(None)?;
                self.initialize_here(parameters)
            }
            outcome => outcome,
        }
    }

    fn initialize_here(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        let _environment = CallEnvironment::enter();
        self.start(parameters)?;
        self.engine.run_initial_events()
    }

    /// Initializes a new instance, or one that was reset and has the values it was given.
    pub(crate) fn start(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.began = Instant::now();
        let (instance, is_used) = match self.fresh_instance(parameters) {
            // The last run's instance could not be ended or reset, which is nothing of this run's.
            Err(_) if self.is_fatal() => {
                self.ensure_copy(None)?;
                self.fresh_instance(parameters)?
            }
            outcome => outcome?,
        };
        self.engine.initialize(instance, self.plan.values.input(parameters))?;
        // A model that does not answer cannot be asked.
        if self.has_values(parameters).unwrap_or(!is_used) {
            return Ok(());
        }
        if !is_used {
            return self.check_taken(parameters);
        }
        let reuse = self.reuse();
        self.start_new(parameters)?;
        let from_new = self.has_values(parameters);
        if from_new.is_ok_and(|agrees| agrees) {
            let reason = "an instance that was used before does not take the values it is given";
            self.give_up_reuse(reuse.unwrap_or(Reuse::Reset), reason);
            return Ok(());
        }
        // An instance that did not answer is not to be used.
        self.start_new(parameters)?;
        self.check_taken(parameters)
    }

    /// Refuses a model that does not take the value of a parameter, on a new instance that does not have all values that it was given;
    /// what another variable determines is a quirk.
    fn check_taken(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        let plan = Arc::clone(&self.plan);
        let core = self.engine.running().current.core()?;
        let Ok(Some(lost)) = plan.values.first_lost(core, plan.fmu().description(), parameters) else {
            plan.values.read_back.set_overridden();
            return Ok(());
        };
        let (name, given, found) = (lost.variable.name.clone(), lost.given, lost.found);
        if lost.variable.causality == Causality::Parameter {
            return Err(FmiError::NotTaken { name, given, found });
        }
        let (given, found) = (Number(given), Number(found));
        let message = format!("{name} was given the value {given}, and is {found} after the initialization");
        plan.fmu().note_quirk(QuirkKind::Promise, message);
        plan.values.read_back.set_overridden();
        Ok(())
    }

    fn start_new(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        drop(self.engine.running().retire());
        let raw = self.new_instance()?;
        self.engine.initialize(raw, self.plan.values.input(parameters))
    }

    fn has_values(&mut self, parameters: &[f64]) -> Result<bool, FmiError> {
        let core = self.engine.running().current.core()?;
        self.plan.values.has_values(core, parameters, &mut self.buffers)
    }

    /// A new instance, or one that was reset in a way that is known to be right; and whether it was used before.
    fn fresh_instance(&mut self, parameters: &[f64]) -> Result<(RawInstance, bool), FmiError> {
        if let Some(raw) = self.fresh.take() {
            return Ok((raw, false));
        }
        let used = self.engine.running().retire();
        let logging = self.plan.fmu().logging();
        let idle = self.lease.as_ref().and_then(|lease| lease.copy().take_idle(self.plan.kind, logging));
        let Some(used) = used.or(idle) else { return Ok((self.new_instance()?, false)) };
        match self.reuse() {
            Some(Reuse::Reinstantiate | Reuse::Reload) => {
                drop(used);
                Ok((self.new_instance()?, false))
            }
            Some(reuse) => self.reset_or_replace(used, reuse),
            // Made when nobody thought of using it again.
            None if self.may_restore() && !used.has_origin() => {
                drop(used);
                Ok((self.new_with_origin()?, false))
            }
            None => self.check_reuse(used, parameters),
        }
    }

    /// Whether a call of its copy of the library has returned `Fatal`.
    pub(crate) fn is_fatal(&self) -> bool {
        self.lease.as_ref().is_some_and(CopyLease::is_fatal)
    }
}

impl Drop for Runner {
    fn drop(&mut self) {
        self.release_copy();
    }
}
