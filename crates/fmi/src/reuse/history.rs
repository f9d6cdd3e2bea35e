//! Runs made again in a newly loaded copy of the library, now and then: shows whether a run depends on earlier ones by a state
//! that the model keeps and no variable shows (static variables, files, a solver of its own).
//!
//! In each copy these are the runs with 1, 2, 4, 8, ... others before them, those after the first, second, fourth, ... change of
//! the plan, and failed runs (`failed_runs.rs`). The result of such a run is that of the new copy. At its end, a fit looks again at its
//! best point in all copies, and in a new one at a tenth of its costs, 16 at most. So a state that shows in a few runs only (every
//! N-th run, the run after one with certain values) is found with a probability, not for certain: between two looks a result may
//! depend on what ran before.

use super::copy_use::CopyRequest;
use super::earlier_run::{EarlierRun, PreviousCopy};
use super::lend::CopyLease;
use super::runner::{Runner, SharedRunner};
use super::store::CopyStore;
use super::verdict::Reuse;
use crate::error::FmiError;
use crate::simulation::Sharing;
use crate::simulation::digest::Digest;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::no_instance;
use crate::sys::{CallEnvironment, RawInstance};
use ode::{ErrorKind, Observer, Report, Sample, Termination};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Of a run that takes longer only so much is made twice: of one without parameters, and of one with, which is more likely to be
/// made over and over.
const LONGEST: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];

/// Hands on whether a run is to be ended, and no samples. The steps are those of a run with the observer.
pub(super) struct Polled<'a> {
    poll: &'a mut dyn FnMut() -> ControlFlow<()>,
    wants_steps: bool,
    longest: Duration,
    end: Option<Instant>,
    pub(super) is_late: bool,
}

impl<'a> Polled<'a> {
    pub(super) fn new(
        plan: &SimulationPlan,
        wants_steps: bool,
        poll: &'a mut dyn FnMut() -> ControlFlow<()>,
    ) -> Self {
        let longest = LONGEST[usize::from(!plan.parameter_names().is_empty())];
        Self { poll, wants_steps, longest, end: None, is_late: false }
    }

    /// The same for a run that may take longer.
    pub(super) fn at_least(mut self, longest: Duration) -> Self {
        self.longest = self.longest.max(longest);
        self
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
    pub(crate) fn compare_if_due(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Option<EarlierRun>, FmiError> {
        let is_due = self.lease.as_ref().is_some_and(|lease| lease.copy().note_run(self.plan.signature));
        if !is_due || !self.may_compare() {
            return Ok(None);
        }
        self.compare_now(parameters, observer)
    }

    /// Whether the present copy was used, and it is known how runs in it begin, and not known that they differ anyway.
    pub(super) fn may_compare(&self) -> bool {
        self.lease.as_ref().is_some_and(|lease| {
            lease.copy().is_used()
                && !lease.store().verdict(self.plan.kind).not_reproducible
                && lease.store().verdict(self.plan.kind).reuse != Some(Reuse::Reload)
        })
    }

    #[cold]
    fn compare_now(
        &mut self,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<Option<EarlierRun>, FmiError> {
        let wants_steps = observer.wants_steps();
        let mut poll = || observer.poll();
        let mut polled = Polled::new(&self.plan, wants_steps, &mut poll);
        let Some((digest, _)) = self.digest_of(parameters, &mut polled) else { return Ok(None) };
        let is_stopped = polled.is_late;
        let (plan, fmu) = (Arc::clone(&self.plan), self.plan.fmu().clone());
        let store = fmu.store(plan.kind)?;
        if let Some(file) = store.written_resource() {
            fmu.note_written_resource(&store, plan.kind, &file)?;
            self.ensure_copy(Some(observer))?;
            return Ok(None);
        }
        let is_other_copy = self.use_other_copy()?;
        Ok(is_other_copy.map(|is_other_copy| EarlierRun { digest, is_stopped, wants_steps, is_other_copy }))
    }

    /// Goes to a new copy for one run (`true`), or takes a new instance in this one where there is none to be had and that makes a
    /// difference; `None`: neither.
    pub(super) fn use_other_copy(&mut self) -> Result<Option<bool>, FmiError> {
        if self.leave_copy() {
            self.prepare()?;
            return Ok(Some(true));
        }
        if self.reuse() == Some(Reuse::Reinstantiate) || self.is_fatal() {
            return Ok(None);
        }
        drop(self.engine.running().retire());
        self.fresh = Some(self.new_instance()?);
        Ok(Some(false))
    }

    /// Goes to a new copy for one run; `false`: there is none to be had.
    fn leave_copy(&mut self) -> bool {
        let Some(other) = self.new_copy() else { return false };
        let instance = self.engine.running().retire();
        let lease = self.lease.replace(other);
        self.prepared = None;
        self.previous = lease.map(|lease| PreviousCopy { instance, lease });
        true
    }

    /// A newly loaded copy of the library, if it can be had without waiting.
    pub(super) fn new_copy(&self) -> Option<CopyLease> {
        self.new_copy_of(self.lease.as_ref()?.store())
    }

    fn new_copy_of(&self, store: &Arc<CopyStore>) -> Option<CopyLease> {
        let request = CopyRequest { sharing: Sharing::Copies, ..self.request() };
        store.lend_if_free(&request, |copy| !copy.is_used())
    }

    /// Goes to a newly loaded copy of the library for all runs to come, with which others are to be compared; `false`: there is none
    /// to be had, or nothing to be found.
    ///
    /// # Errors
    /// The library cannot be found any more.
    pub(crate) fn ensure_new_copy(&mut self) -> Result<bool, FmiError> {
        let kind = self.plan.kind;
        let store = self.plan.fmu().store(kind)?;
        let is_known =
            store.verdict(kind).reuse == Some(Reuse::Reload) || store.verdict(kind).not_reproducible;
        if is_known || self.lease.is_some() {
            return Ok(false);
        }
        self.is_trial = true;
        self.lease = self.new_copy_of(&store);
        self.prepare()?;
        Ok(self.lease.is_some())
    }

    /// Goes back to the copy that was left for one run, if there is one.
    pub(crate) fn return_to_copy(&mut self) {
        let Some(aside) = self.previous.take() else { return };
        self.fresh = None;
        drop(self.engine.running().retire());
        let PreviousCopy { instance, lease } = aside;
        if let Some(other) = self.lease.replace(lease) {
            other.retire();
        }
        // What is set besides the plan's settings is that of the other copy.
        self.prepared = None;
        if let Some(instance) = instance {
            self.engine.running().adopt(instance);
        }
    }

    /// What a run answers, from start to end or until it is late, and whether it fails; `None`: it was ended from outside, which says
    /// nothing.
    pub(super) fn digest_of(
        &mut self,
        parameters: &[f64],
        observer: &mut Polled<'_>,
    ) -> Option<(Digest, bool)> {
        let _environment = CallEnvironment::enter();
        let outcome = self.start(parameters).and_then(|()| {
            self.engine.running().begin_digest(Digest::with_way());
            observer.begin();
            self.engine.run(&self.plan, None, observer)
        });
        let digest = self.end_digest(&outcome);
        let is_ended = (observer.is_late || !is_stopped(&outcome)) && !is_ended_from_outside(&outcome);
        is_ended.then_some((digest, outcome.is_err()))
    }

    /// The digest of a run that is over, with how it has ended.
    fn end_digest(&mut self, outcome: &Result<Report, FmiError>) -> Digest {
        // A run that cannot be started has answered nothing.
        let mut digest = self.engine.running().end_digest().unwrap_or_else(Digest::with_way);
        if outcome.is_err() {
            digest.note(&[f64::from(u8::from(self.is_fatal()))]);
        }
        digest
    }

    /// Compares the run made in a new copy with that in a used one, and draws the conclusions.
    ///
    /// # Errors
    /// There is no further copy or instance to be had.
    pub(crate) fn judge(
        &mut self,
        earlier: &EarlierRun,
        outcome: &Result<Report, FmiError>,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> Result<(), FmiError> {
        let fresh = self.end_digest(outcome);
        if is_ended_from_outside(outcome)
            || earlier.digest.agrees(&fresh, (earlier.is_stopped, is_stopped(outcome)))
        {
            return Ok(());
        }
        let mut poll = || observer.poll();
        let mut polled = Polled::new(&self.plan, earlier.wants_steps, &mut poll);
        self.find_cause((&fresh, is_stopped(outcome)), earlier.is_other_copy, parameters, &mut polled)
    }

    /// A run differs from the same one in a new copy, or by a new instance: finds out what helps.
    #[cold]
    pub(super) fn find_cause(
        &mut self,
        (fresh, stopped): (&Digest, bool),
        is_other_copy: bool,
        parameters: &[f64],
        observer: &mut Polled<'_>,
    ) -> Result<(), FmiError> {
        let (plan, fmu) = (Arc::clone(&self.plan), self.plan.fmu().clone());
        if !is_other_copy {
            return fmu.note_history(plan.kind, Reuse::Reinstantiate);
        }
        if let Some(lease) = self.new_copy() {
            let (again, lease) = digest_in(&plan, lease, None, parameters, observer)?;
            lease.retire();
            let Some((again, _)) = again else { return Ok(()) };
            if !again.agrees(fresh, (observer.is_late, stopped)) {
                return fmu.note_not_reproducible(plan.kind);
            }
        }
        let Some(PreviousCopy { instance, lease }) = self.previous.take() else { return Ok(()) };
        // A new instance is enough where the state is that of the old one: with that the run differs once more, with a new one in the
        // same copy it does not.
        let reuse = match instance {
            Some(used) if self.reuse() != Some(Reuse::Reinstantiate) => {
                let mut agrees = |lease, used| {
                    let (digest, lease) = digest_in(&plan, lease, used, parameters, observer)?;
                    let stopped = (observer.is_late, stopped);
                    Ok::<_, FmiError>((digest.map(|(digest, _)| digest.agrees(fresh, stopped)), lease))
                };
                let (again, lease) = agrees(lease, Some(used))?;
                let (renewed, _) = agrees(lease, None)?;
                let is_of_instance = again == Some(false) && renewed == Some(true);
                if is_of_instance { Reuse::Reinstantiate } else { Reuse::Reload }
            }
            _ => Reuse::Reload,
        };
        fmu.note_history(plan.kind, reuse)
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
        self.ensure_copy(None)?;
        if !self.may_compare() {
            return Ok(false);
        }
        let Some(store) = self.lease.as_ref().map(|lease| Arc::clone(lease.store())) else {
            return Ok(false);
        };
        let before = store.verdict(self.plan.kind).n_found;
        let mut poll = || if cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let plan = Arc::clone(&self.plan);
        let mut observer = Polled::new(&plan, false, &mut poll);
        if let Some(earlier) = self.compare_now(parameters, &mut observer)? {
            observer.begin();
            self.run_here(Some(earlier), parameters, &mut observer)?;
        }
        Ok(store.verdict(self.plan.kind).n_found > before)
    }
}

/// What a run of a plan answers in this copy, on a new instance or on one that is brought back to its start.
fn digest_in(
    plan: &Arc<SimulationPlan>,
    lease: CopyLease,
    used: Option<RawInstance>,
    parameters: &[f64],
    observer: &mut Polled<'_>,
) -> Result<(Option<(Digest, bool)>, CopyLease), FmiError> {
    let shared = SharedRunner::new(Arc::clone(plan))?;
    let mut runner = shared.enter();
    lease.copy().free_idle();
    runner.lease = Some(lease);
    runner.prepare()?;
    if let Some(used) = used {
        runner.engine.running().adopt(used);
    }
    let digest = runner.digest_of(parameters, observer);
    runner.fresh = None;
    drop(runner.engine.running().retire());
    runner.lease.take().map(|lease| (digest, lease)).ok_or_else(no_instance)
}

/// Whether the observer stopped a run.
fn is_stopped(outcome: &Result<Report, FmiError>) -> bool {
    outcome.as_ref().is_ok_and(|report| report.termination == Termination::StoppedByObserver)
}

/// Whether a run says nothing about the model.
fn is_ended_from_outside(outcome: &Result<Report, FmiError>) -> bool {
    outcome.as_ref().is_err_and(is_from_outside)
}

/// Whether an error is none of the model's: the run was cancelled, or ended by a limit of wall-clock time or of work, by an input
/// function of the user, or for want of memory, of files or of a copy of the library.
pub(super) fn is_from_outside(error: &FmiError) -> bool {
    match error {
        FmiError::Simulation(error) => match &error.kind {
            ErrorKind::Cancelled | ErrorKind::TimedOut(_) | ErrorKind::TooMuchWork(_) => true,
            ErrorKind::Model(inner) => inner.downcast_ref().is_some_and(is_from_outside),
            _ => false,
        },
        FmiError::NotFinite { .. }
        | FmiError::Cancelled
        | FmiError::Memory { .. }
        | FmiError::Io { .. }
        | FmiError::LoadFailed { .. }
        | FmiError::NoCopy { .. } => true,
        _ => false,
    }
}
