//! The check of the ways of resetting: a second run against one on a new instance, after a run with other values, in one thread.

use super::probe::{DIFFERS, PROBE_STEPS, Probe};
use super::runner::Runner;
use super::verdict::Reuse;
use crate::error::FmiError;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::variable_elements::{RunInput, StartValues};
use crate::sys::RawInstance;
use ode::{Observer, Sample};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A simulation that takes longer than this is tested by its first steps only.
const LONG: Duration = Duration::from_secs(2);

/// What a run on a new instance gives, with which all others are compared; see [`Pool`](crate::Pool).
pub(crate) struct Trial<'a> {
    base: RunInput<'a>,
    /// Start values and parameters a little off.
    others: (StartValues, Vec<f64>),
    /// `None`: from start to end.
    steps: Option<u64>,
    truth: Probe,
}

impl Runner {
    /// Checks by the first steps of some runs how instances are brought back to their start, and returns an instance to use; and
    /// whether it was used before.
    pub(crate) fn check_reuse(
        &mut self,
        used: RawInstance,
        parameters: &[f64],
    ) -> Result<(RawInstance, bool), FmiError> {
        // One at a time: the FMU may not allow two.
        drop(used);
        let plan = Arc::clone(&self.plan);
        let never = || false;
        let mut watch = Watch::new(&never);
        let examined = Trial::short(&plan, parameters, self, &mut watch)
            .and_then(|trial| trial.map_or(Ok(None), |trial| trial.reuse(self, &mut watch)));
        self.began = Instant::now();
        if self.is_fatal() {
            // At the other values, perhaps; another check could end so, too.
            self.set_reuse(Reuse::Reinstantiate);
            self.ensure_copy(None)?;
            return Ok((self.new_instance()?, false));
        }
        if let Some(reuse) = examined? {
            self.set_reuse(reuse);
        }
        match (self.engine.running().retire(), self.reuse()) {
            (Some(used), Some(reuse)) if reuse < Reuse::Reinstantiate => self.reset_or_replace(used, reuse),
            (used, _) => {
                drop(used);
                Ok((self.new_instance()?, false))
            }
        }
    }
}

impl<'a> Trial<'a> {
    /// The run on a new instance. `None`: the model cannot be started with `base`, or the run was not over in time, and
    /// there is nothing to compare.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn new(
        plan: &'a SimulationPlan,
        parameters: &'a [f64],
        runner: &mut Runner,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Self>, FmiError> {
        let base = plan.values.input(parameters);
        watch.end = Some(Instant::now() + LONG);
        let truth = watch.over(|watch| runner.probe_new(base, None, watch))?;
        watch.end = None;
        if std::mem::take(&mut watch.is_over) {
            return Self::short(plan, parameters, runner, watch);
        }
        Ok(Self::with_truth(plan, base, None, truth))
    }

    /// The same with the first steps only.
    fn short(
        plan: &'a SimulationPlan,
        parameters: &'a [f64],
        runner: &mut Runner,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Self>, FmiError> {
        let (base, steps) = (plan.values.input(parameters), Some(PROBE_STEPS));
        let truth = watch.over(|watch| runner.probe_new(base, steps, watch))?;
        Ok(Self::with_truth(plan, base, steps, truth))
    }

    fn with_truth(
        plan: &SimulationPlan,
        base: RunInput<'a>,
        steps: Option<u64>,
        truth: Probe,
    ) -> Option<Self> {
        let others = plan.values.perturbed(plan.fmu().description(), base.parameters);
        matches!(truth, Probe::Digest(_)).then_some(Self { base, others, steps, truth })
    }

    /// The first way of bringing an instance back to its beginning that passes; `None`: the runs say nothing, for they fail or a time
    /// limit ends them.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn reuse(
        &self,
        runner: &mut Runner,
        watch: &mut Watch<'_>,
    ) -> Result<Option<Reuse>, FmiError> {
        let known = runner.reuse();
        if known >= Some(Reuse::Reinstantiate) {
            return Ok(known);
        }
        for reuse in [Reuse::Restore, Reuse::Reset] {
            let is_out = reuse == Reuse::Restore && !runner.may_restore();
            if is_out || known.is_some_and(|known| known > reuse) {
                continue;
            }
            match self.passes(reuse, runner, watch)? {
                None => return Ok(None),
                Some(true) => return Ok(Some(reuse)),
                Some(false) => runner.give_up_reuse(reuse, DIFFERS),
            }
        }
        Ok(Some(Reuse::Reinstantiate))
    }

    /// Whether runs on one instance, brought back to its beginning in between, are those of new instances: one with the
    /// base values, one with others, and one with the base values again.
    fn passes(
        &self,
        reuse: Reuse,
        runner: &mut Runner,
        watch: &mut Watch<'_>,
    ) -> Result<Option<bool>, FmiError> {
        let short = Some(PROBE_STEPS);
        let others = RunInput { start: &self.others.0, parameters: &self.others.1 };
        let other_truth = watch.over(|watch| runner.probe_new(others, short, watch))?;
        let first = watch.over(|watch| runner.probe_first(reuse, self.base, self.steps, watch))?;
        // What cannot be started on a new instance any more says nothing of the old ones: an input function may have ended.
        if matches!(first, Probe::TimedOut | Probe::Nothing) || other_truth == Probe::TimedOut {
            return Ok(None);
        }
        if first != self.truth {
            return Ok(Some(false));
        }
        let again = |runner: &mut Runner, watch: &mut Watch<'_>| {
            watch.over(|watch| runner.probe_again(reuse, self.base, self.steps, watch))
        };
        let last = match watch.over(|watch| runner.probe_again(reuse, others, short, watch))? {
            // The run with the base values fails: there is nothing to bring back.
            Some(Probe::TimedOut | Probe::Gone) => return Ok(None),
            Some(probe) if probe != other_truth => return Ok(Some(false)),
            Some(_) => again(runner, watch)?,
            None => None,
        };
        let last = match last {
            // A run that fails leaves no instance to bring back: then at least the same run twice.
            None | Some(Probe::Gone) => {
                watch.over(|watch| runner.probe_first(reuse, self.base, self.steps, watch))?;
                again(runner, watch)?
            }
            last => last,
        };
        let says_nothing = matches!(last, Some(Probe::TimedOut | Probe::Gone));
        Ok((!says_nothing).then_some(last == Some(self.truth)))
    }
}

/// Ends a run that takes too long to be made again and again, and all of them where that is asked for.
pub(super) struct Watch<'a> {
    end: Option<Instant>,
    is_over: bool,
    cancelled: &'a dyn Fn() -> bool,
    is_cancelled: bool,
}

impl<'a> Watch<'a> {
    pub(super) fn new(cancelled: &'a dyn Fn() -> bool) -> Self {
        Self { end: None, is_over: false, cancelled, is_cancelled: false }
    }

    /// What a run gives that this watches; an error where it was cancelled.
    fn over<T>(&mut self, run: impl FnOnce(&mut Self) -> Result<T, FmiError>) -> Result<T, FmiError> {
        let result = run(self);
        if self.is_cancelled { Err(FmiError::Cancelled) } else { result }
    }
}

impl Observer for Watch<'_> {
    fn sample(&mut self, _: &Sample<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.is_cancelled |= (self.cancelled)();
        self.is_over |= self.end.is_some_and(|end| Instant::now() > end);
        if self.is_over || self.is_cancelled { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
