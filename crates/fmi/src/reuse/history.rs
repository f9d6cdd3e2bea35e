//! Runs made again in a newly loaded copy of the library, now and then: shows whether a run depends on earlier ones by a state
//! that the model keeps and no variable shows (static variables, files, a solver of its own).
//!
//! In each copy these are the runs with 1, 2, 4, 8, ... others before them, and those after the first, second, fourth, ...
//! change of the plan. The result of such a run is that of the new copy.

use super::lease::CopyLease;
use super::{Digest, Reuse, Sharing};
use crate::description::QuirkKind;
use crate::error::FmiError;
use crate::plan::SimulationPlan;
use crate::simulation::{Runner, Tenancy};
use crate::sys::{CallEnvironment, LoadFrom, RawInstance};
use ode::{ErrorKind, Observer, Report, Sample, Termination};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A copy that a runner goes back to after a run in another one.
#[derive(Debug)]
pub(crate) struct Aside {
    // Given back after the instance.
    instance: Option<RawInstance>,
    lease: CopyLease,
}

/// What a run in a used copy showed, before it is made in a new one.
pub(crate) struct Past {
    digest: Digest,
    /// The run was too long to be made twice.
    is_stopped: bool,
    wants_steps: bool,
    /// The other run is made in another copy, not by a new instance in the same one.
    is_elsewhere: bool,
}

/// Of a run that takes longer only so much is made twice: of one without parameters, and of one with, which is more likely to be
/// made over and over.
const LONGEST: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];

/// Hands on whether a run is to be ended, and no samples. The steps are those of a run with the observer.
struct Polled<'a> {
    poll: &'a mut dyn FnMut() -> ControlFlow<()>,
    wants_steps: bool,
    longest: Duration,
    end: Option<Instant>,
    is_late: bool,
}

impl<'a> Polled<'a> {
    fn new(plan: &SimulationPlan, wants_steps: bool, poll: &'a mut dyn FnMut() -> ControlFlow<()>) -> Self {
        let longest = LONGEST[usize::from(!plan.parameter_names().is_empty())];
        Self { poll, wants_steps, longest, end: None, is_late: false }
    }

    /// A run begins.
    fn begin(&mut self) {
        self.end = Some(Instant::now() + self.longest);
        self.is_late = false;
    }
}

impl Observer for Polled<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn wants_steps(&self) -> bool {
        self.wants_steps
    }

    fn poll(&mut self) -> ControlFlow<()> {
        (self.poll)()?;
        self.is_late = self.end.is_some_and(|end| Instant::now() > end);
        if self.is_late { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl Runner {
    /// Makes the coming run in the present copy, where it is time for that, and then takes a new copy for it; `None`: the run is
    /// made as any other.
    ///
    /// # Errors
    /// There is no new instance to be had.
    pub(crate) fn look_back(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Option<Past>, FmiError> {
        let is_due = self.lease.as_ref().is_some_and(|lease| lease.copy().note_run(self.plan.signature));
        if !is_due || !self.has_past() {
            return Ok(None);
        }
        self.look_back_now(parameters, observer)
    }

    /// Whether the present copy was used, and it is known how runs in it begin, and not known that they differ anyway.
    fn has_past(&self) -> bool {
        self.lease.as_ref().is_some_and(|lease| {
            lease.copy().is_used()
                && lease.store().verdicts.reuse(self.plan.kind) != Some(Reuse::Reload)
                && !lease.store().verdicts.is_not_reproducible(self.plan.kind)
        })
    }

    #[cold]
    fn look_back_now(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Option<Past>, FmiError> {
        let wants_steps = observer.wants_steps();
        let mut poll = || observer.poll();
        let mut polled = Polled::new(&self.plan, wants_steps, &mut poll);
        let Some(digest) = self.digest_of(parameters, &mut polled) else { return Ok(None) };
        let is_stopped = polled.is_late;
        let (plan, fmu) = (Arc::clone(&self.plan), self.plan.fmu().clone());
        let store = fmu.store(plan.kind)?;
        if let Some(file) = store.written_resource() {
            fmu.note_written_resource(&store, plan.kind, &file)?;
            self.settle_in(Some(observer))?;
            return Ok(None);
        }
        let is_elsewhere = self.step_aside();
        if !is_elsewhere {
            if self.reuse() == Some(Reuse::Reinstantiate) {
                return Ok(None);
            }
            drop(self.engine.running().retire());
            self.fresh = Some(self.new_instance()?);
        } else {
            self.prepare()?;
        }
        Ok(Some(Past { digest, is_stopped, wants_steps, is_elsewhere }))
    }

    /// Goes to a new copy for one run; `false`: there is none to be had.
    fn step_aside(&mut self) -> bool {
        let Some(other) = self.new_copy() else { return false };
        let instance = self.engine.running().retire();
        let lease = self.lease.replace(other);
        self.prepared = None;
        self.aside = lease.map(|lease| Aside { instance, lease });
        true
    }

    /// A newly loaded copy of the library, if it can be had without waiting.
    pub(super) fn new_copy(&self) -> Option<CopyLease> {
        let store = self.lease.as_ref()?.store();
        let fmu = self.plan.fmu();
        let open = |from: LoadFrom<'_>| fmu.load(from, self.plan.kind);
        let request = super::CopyRequest { sharing: Sharing::Copies, ..self.request(&open) };
        store.lend_if_free(&request, |copy| !copy.is_used())
    }

    /// Goes back to the copy that was left for one run, if there is one.
    pub(crate) fn come_back(&mut self) {
        let Some(aside) = self.aside.take() else { return };
        self.fresh = None;
        drop(self.engine.running().retire());
        let Aside { instance, lease } = aside;
        if let Some(other) = self.lease.replace(lease) {
            other.retire();
        }
        // What is set besides the plan's settings is that of the other copy.
        self.prepared = None;
        if let Some(instance) = instance {
            self.engine.running().adopt(instance);
        }
    }

    /// What a run answers, from start to end or until it is late; `None`: it was ended from outside, which says nothing.
    fn digest_of(&mut self, parameters: &[f64], observer: &mut Polled<'_>) -> Option<Digest> {
        let _environment = CallEnvironment::enter();
        // A run that cannot be started has answered nothing.
        if self.start(parameters).is_err() {
            return (!self.is_fatal()).then(Digest::with_way);
        }
        self.engine.running().begin_digest(Digest::with_way());
        observer.begin();
        let outcome = self.engine.run(&self.plan, None, observer);
        let digest = self.engine.running().end_digest();
        let is_ended = (observer.is_late || !is_stopped(&outcome)) && !is_ended_from_outside(&outcome);
        digest.filter(|_| is_ended && !self.is_fatal())
    }

    /// Compares the run made in a new copy with that in a used one, and draws the conclusions.
    ///
    /// # Errors
    /// There is no further copy or instance to be had.
    pub(crate) fn judge(
        &mut self,
        past: &Past,
        outcome: &Result<Report, FmiError>,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<(), FmiError> {
        let fresh = self.engine.running().end_digest().unwrap_or_else(Digest::with_way);
        if self.is_fatal()
            || is_ended_from_outside(outcome)
            || past.digest.agrees(&fresh, (past.is_stopped, is_stopped(outcome)))
        {
            return Ok(());
        }
        let mut poll = || observer.poll();
        let mut polled = Polled::new(&self.plan, past.wants_steps, &mut poll);
        self.find_cause((past, &fresh, is_stopped(outcome)), parameters, &mut polled)
    }

    #[cold]
    fn find_cause(
        &mut self,
        (past, fresh, stopped): (&Past, &Digest, bool),
        parameters: &[f64],
        observer: &mut Polled<'_>,
    ) -> Result<(), FmiError> {
        let (plan, fmu) = (Arc::clone(&self.plan), self.plan.fmu().clone());
        let store = fmu.store(plan.kind)?;
        let conclude = |reuse: Reuse| {
            store.verdicts.set_history(plan.kind, reuse);
            let way = match reuse {
                Reuse::Reload => "a newly loaded copy of the library",
                _ => "a new instance",
            };
            let message = format!(
                "a simulation depends on earlier ones: the model keeps a state that no variable shows, and that resetting \
                 does not bring back; every simulation gets {way} from now on, and results from before may be wrong"
            );
            fmu.note_quirk(QuirkKind::Promise, message);
        };
        if !past.is_elsewhere {
            conclude(Reuse::Reinstantiate);
            return Ok(());
        }
        if let Some(lease) = self.new_copy() {
            let (again, lease) = digest_in(&plan, lease, parameters, observer)?;
            lease.retire();
            let Some(again) = again else { return Ok(()) };
            if !again.agrees(fresh, (observer.is_late, stopped)) {
                store.verdicts.set_not_reproducible(plan.kind);
                fmu.note_quirk(
                    QuirkKind::Promise,
                    "two simulations in newly loaded copies of the library differ: no result can be reproduced"
                        .to_owned(),
                );
                return Ok(());
            }
        }
        let Some(Aside { instance, lease, .. }) = self.aside.take() else { return Ok(()) };
        drop(instance);
        // By a new instance in the copy that was used.
        let (renewed, lease) = digest_in(&plan, lease, parameters, observer)?;
        drop(lease);
        let is_enough = self.reuse() != Some(Reuse::Reinstantiate)
            && renewed.is_some_and(|renewed| renewed.agrees(fresh, (observer.is_late, stopped)));
        conclude(if is_enough { Reuse::Reinstantiate } else { Reuse::Reload });
        Ok(())
    }

    /// Makes a run in the present copy and in a new one; whether the model was found to depend on earlier runs.
    ///
    /// # Errors
    /// There is no new instance to be had; the run in the new copy fails.
    pub(crate) fn verify(
        &mut self,
        parameters: &[f64],
        cancelled: &dyn Fn() -> bool,
    ) -> Result<bool, FmiError> {
        self.settle_in(None)?;
        if !self.has_past() {
            return Ok(false);
        }
        let Some(store) = self.lease.as_ref().map(|lease| Arc::clone(lease.store())) else {
            return Ok(false);
        };
        let before = store.verdicts.n_found(self.plan.kind);
        let mut poll = || if cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let plan = Arc::clone(&self.plan);
        let mut observer = Polled::new(&plan, false, &mut poll);
        if let Some(past) = self.look_back_now(parameters, &mut observer)? {
            observer.begin();
            self.run_here(Some(past), parameters, &mut observer)?;
        }
        Ok(store.verdicts.n_found(self.plan.kind) > before)
    }
}

/// What a run of a plan answers on a new instance in this copy.
fn digest_in(
    plan: &Arc<SimulationPlan>,
    lease: CopyLease,
    parameters: &[f64],
    observer: &mut Polled<'_>,
) -> Result<(Option<Digest>, CopyLease), FmiError> {
    let tenancy = Tenancy::new(Arc::clone(plan))?;
    let mut runner = tenancy.enter();
    lease.copy().free_idle();
    runner.lease = Some(lease);
    runner.prepare()?;
    let digest = runner.digest_of(parameters, observer);
    runner.fresh = None;
    drop(runner.engine.running().retire());
    runner.lease.take().map(|lease| (digest, lease)).ok_or_else(crate::running::no_instance)
}

/// Whether the observer stopped a run.
fn is_stopped(outcome: &Result<Report, FmiError>) -> bool {
    outcome.as_ref().is_ok_and(|report| report.termination == Termination::StoppedByObserver)
}

/// Whether a run was cancelled, or ended by a limit of wall-clock time.
fn is_ended_from_outside(outcome: &Result<Report, FmiError>) -> bool {
    let is_outside = |kind: &ErrorKind| matches!(kind, ErrorKind::Cancelled | ErrorKind::TimedOut(_));
    matches!(outcome, Err(FmiError::Simulation(error)) if is_outside(&error.kind))
}
