//! What a simulator has while it has a loaded copy of the library: an instance, the way of resetting it, buffers.

use super::loans::{CopyRequest, Eviction, Tenant};
use super::past::{Aside, Past};
use super::store::CopyLease;
use super::verdict::Reuse;
use crate::description::{Value, Variable};
use crate::error::FmiError;
use crate::simulation::Sharing;
use crate::simulation::digest::Digest;
use crate::simulation::engine::Engine;
use crate::simulation::plan::{ReadBackBuffers, Setting, SimulationPlan};
use crate::simulation::running::no_instance;
use crate::sys::{CallEnvironment, InterfaceKind, Library, LoadFrom, RawInstance};
use ode::{ErrorKind, Ignore, Observer, Report, Seconds, SimulationError, Stats};
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
    tenant: Weak<Tenancy>,
    /// The copy was needed for another owner.
    evicted: bool,
    /// Its runs are those with which others are compared: they are not looked into themselves.
    pub(crate) is_trial: bool,
    /// What is set in the present copy besides the settings of the plan.
    pub(crate) prepared: Option<Prepared>,
    /// The copy that it goes back to, after a run in another one.
    pub(crate) aside: Option<Aside>,
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
pub(crate) struct Tenancy {
    runner: Mutex<Runner>,
    /// The copy is kept between runs.
    pinned: AtomicBool,
    /// It lies in a pool: nobody asks for the values of its last run.
    dormant: AtomicBool,
    /// The thread that uses it, or has pinned it.
    user: Mutex<Option<ThreadId>>,
}

/// Use of a runner by one thread; waiting owners look again when it is over.
pub(crate) struct Inside<'a> {
    tenancy: &'a Tenancy,
    runner: Option<MutexGuard<'a, Runner>>,
}

impl Tenancy {
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
        Ok(Arc::new_cyclic(|tenant| Self {
            runner: Mutex::new(Runner {
                plan,
                engine,
                fresh: None,
                buffers: ReadBackBuffers::default(),
                began: Instant::now(),
                sharing,
                tenant: Weak::clone(tenant),
                evicted: false,
                is_trial: false,
                prepared: None,
                aside: None,
                lease: None,
            }),
            pinned: AtomicBool::new(false),
            dormant: AtomicBool::new(false),
            user: Mutex::new(None),
        }))
    }

    /// Keeps the copy between runs, or lets others have it, to whom its values mean nothing.
    pub(crate) fn pin(&self, pinned: bool) {
        self.dormant.store(!pinned, Ordering::Release);
        *self.user() = pinned.then(|| std::thread::current().id());
        self.pinned.store(pinned, Ordering::Release);
        if !pinned {
            self.notify();
        }
    }

    /// Uses the runner.
    pub(crate) fn enter(&self) -> Inside<'_> {
        let runner = self.runner.lock().unwrap_or_else(PoisonError::into_inner);
        *self.user() = Some(std::thread::current().id());
        Inside { tenancy: self, runner: Some(runner) }
    }

    fn user(&self) -> MutexGuard<'_, Option<ThreadId>> {
        self.user.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waiting or kept: kept if this thread would wait for itself.
    fn waits(&self) -> Eviction {
        if *self.user() == Some(std::thread::current().id()) { Eviction::Kept } else { Eviction::Busy }
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

impl Tenant for Tenancy {
    fn evict(&self) -> Eviction {
        let mut runner = match self.runner.try_lock() {
            Ok(runner) => runner,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return self.waits(),
        };
        if self.pinned.load(Ordering::Acquire) {
            return self.waits();
        }
        runner.give_up();
        runner.evicted = true;
        Eviction::Done
    }

    fn is_dormant(&self) -> bool {
        self.dormant.load(Ordering::Acquire)
    }
}

impl std::ops::Deref for Inside<'_> {
    type Target = Runner;

    fn deref(&self) -> &Runner {
        match &self.runner {
            Some(runner) => runner,
            None => unreachable!("taken only when it is dropped"),
        }
    }
}

impl std::ops::DerefMut for Inside<'_> {
    fn deref_mut(&mut self) -> &mut Runner {
        match &mut self.runner {
            Some(runner) => runner,
            None => unreachable!("taken only when it is dropped"),
        }
    }
}

impl Drop for Inside<'_> {
    fn drop(&mut self) {
        let Some(runner) = self.runner.take() else { return };
        let store = runner.lease.as_ref().map(|lease| Arc::clone(lease.store()));
        if !self.tenancy.pinned.load(Ordering::Acquire) {
            *self.tenancy.user() = None;
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
        lease.store().verdicts.reuse_for(self.plan.kind, self.settings())
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
        lease.store().verdicts.set_reuse(self.plan.kind, reuse, self.settings());
    }

    /// Whether instances may be brought back by a saved state, as far as is known. Not in co-simulation: some models abort
    /// the process when they are initialized after it (seen in Dymola's, whose solver is no part of the state), and reset
    /// is as fast.
    pub(crate) fn may_restore(&self) -> bool {
        let interface = self.plan.fmu().check_interface(self.plan.kind);
        self.plan.kind == InterfaceKind::ModelExchange
            && interface.is_ok_and(|interface| interface.capabilities.can_get_and_set_state)
            && self.lease.as_ref().is_some_and(|lease| lease.store().verdicts.may_restore(self.plan.kind))
    }

    /// Saved states were found not to bring instances back.
    pub(crate) fn refuse_restore(&self) {
        if let Some(lease) = &self.lease {
            lease.store().verdicts.refuse_restore(self.plan.kind);
        }
    }

    /// Gets a copy of the library, if there is none or it has answered `Fatal`, and finds out what is to be set in it.
    ///
    /// # Errors
    /// The library cannot be loaded; there is no copy to be had; `observer` or the plan has cancelled the simulation.
    pub(crate) fn settle_in(&mut self, observer: Option<&mut dyn Observer>) -> Result<(), FmiError> {
        self.come_back();
        let is_over = |lease: &CopyLease| {
            lease.is_fatal() || (lease.copy().is_used() && self.reuse() == Some(Reuse::Reload))
        };
        if self.lease.as_ref().is_none_or(is_over) {
            self.give_up();
            self.lease = Some(self.lend(observer)?);
            self.evicted = false;
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
        let open = |from: LoadFrom<'_>| fmu.load(from, self.plan.kind);
        let lease = store.lend(&self.request(&open), &mut wait)?;
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
    pub(crate) fn request<'a>(
        &self,
        open: &'a dyn Fn(LoadFrom<'_>) -> Result<Library, FmiError>,
    ) -> CopyRequest<'a> {
        let tenant: Weak<dyn Tenant> = self.tenant.clone();
        CopyRequest { kind: self.plan.kind, sharing: self.sharing, tenant: Some(tenant), open }
    }

    /// Gives the copy back, with the instance for whoever needs one next.
    pub(crate) fn give_up(&mut self) {
        self.come_back();
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

    pub(super) fn run(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        self.settle_in(Some(&mut *observer))?;
        if self.is_trial {
            return self.run_here(None, parameters, observer);
        }
        let past = self.look_back(parameters, observer)?;
        let may_blame_past = past.is_none() && self.is_copy_used();
        match self.run_here(past, parameters, observer) {
            Err(error) if may_blame_past && self.fails_by_history(&error, parameters, observer) => {
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
        past: Option<Past>,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Report, FmiError> {
        let _environment = CallEnvironment::enter();
        if let Err(error) = self.start(parameters) {
            let outcome = Err(error);
            if let Some(past) = past {
                self.judge(&past, &outcome, parameters, observer)?;
            }
            return outcome;
        }
        let starting = self.began.elapsed().as_secs_f64();
        if past.is_some() {
            self.engine.running().begin_digest(Digest::with_way());
        }
        let mut outcome = self.engine.run(&self.plan, None, observer);
        let input_functions = self.engine.running().seconds_in_input_functions();
        self.engine.running().pass_log_on();
        if let Some(past) = past {
            self.judge(&past, &outcome, parameters, observer)?;
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
        if self.evicted {
            return Err(FmiError::Disturbed { library: self.plan.fmu().path().to_owned() });
        }
        self.engine.value(variable)
    }

    pub(super) fn initialize_only(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.settle_in(None)?;
        let may_blame_past = self.is_copy_used();
        match self.initialize_here(parameters) {
            Err(error) if may_blame_past && self.fails_by_history(&error, parameters, &mut Ignore) => {
                self.settle_in(None)?;
                self.initialize_here(parameters)
            }
            outcome => outcome,
        }
    }

    fn initialize_here(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        let _environment = CallEnvironment::enter();
        self.start(parameters)?;
        self.engine.settle()
    }

    /// Initializes a new instance, or one that was reset and has the values it was given.
    pub(crate) fn start(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        self.began = Instant::now();
        let (instance, is_used) = match self.fresh_instance(parameters) {
            // The last run's instance could not be ended or reset, which is nothing of this run's.
            Err(_) if self.is_fatal() => {
                self.settle_in(None)?;
                self.fresh_instance(parameters)?
            }
            outcome => outcome?,
        };
        self.engine.initialize(instance, &self.plan.values.start, parameters)?;
        if !is_used || self.has_values(parameters).is_ok_and(|agrees| agrees) {
            return Ok(());
        }
        let plan = Arc::clone(&self.plan);
        let model = &plan.fmu().description().model_name;
        let reuse = self.reuse();
        self.start_new(parameters)?;
        let from_new = self.has_values(parameters);
        if from_new.is_ok_and(|agrees| agrees) {
            let reason = "an instance that was used before does not take the values it is given";
            self.give_up_reuse(reuse.unwrap_or(Reuse::Reset), reason);
            return Ok(());
        }
        log::warn!("{model}: after the initialization the model does not have the values it was given");
        plan.values.read_back.set_overridden();
        // An instance that did not answer is not to be used.
        self.start_new(parameters)
    }

    fn start_new(&mut self, parameters: &[f64]) -> Result<(), FmiError> {
        drop(self.engine.running().retire());
        let raw = self.new_instance()?;
        self.engine.initialize(raw, &self.plan.values.start, parameters)
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
            Some(reuse) => self.renew_or_replace(used, reuse),
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
        self.give_up();
    }
}
