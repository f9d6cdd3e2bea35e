//! Trial runs: on new instances, and on used ones that were reset, so that they can be compared.

use super::renewal::renew;
use super::runner::Runner;
use super::verdict::Reuse;
use crate::error::FmiError;
use crate::simulation::digest::Digest;
use crate::simulation::parameters::StartValues;
use crate::sys::{CallEnvironment, RawInstance};
use ode::{ErrorKind, Ignore, Observer};
use std::sync::Arc;
use std::time::Instant;

/// Steps after which a check of reset is sure enough: what reset forgets shows in the first right-hand sides.
pub(crate) const PROBE_STEPS: u64 = 50;

/// Why a way of bringing instances back is not taken.
pub(super) const DIFFERS: &str = "a simulation after it differs from one on a new instance";

/// What a trial run showed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Probe {
    /// Digest of everything that the FMU answered.
    Digest(u64),
    /// It could not be started: nothing to compare.
    Nothing,
    /// A time limit ended it, which says nothing about the FMU.
    TimedOut,
    /// It was not made: the run before has failed and left no instance to bring back.
    Gone,
}

impl Runner {
    /// Compares the first steps of the instance after a reset with those of a new one, and returns an instance to use; and
    /// whether it was used before.
    pub(crate) fn check_reuse(
        &mut self,
        used: RawInstance,
        parameters: &[f64],
    ) -> Result<(RawInstance, bool), FmiError> {
        let outcome = self.compare(used, parameters);
        if self.is_fatal() {
            // At the other values, perhaps; another check could end so, too.
            self.set_reuse(Reuse::Reinstantiate);
            self.settle_in(None)?;
            return Ok((self.new_instance()?, false));
        }
        outcome
    }

    fn compare(&mut self, used: RawInstance, parameters: &[f64]) -> Result<(RawInstance, bool), FmiError> {
        let plan = Arc::clone(&self.plan);
        let reuse = if used.has_origin() { Reuse::Restore } else { Reuse::Reset };
        self.engine.running().adopt(used);
        let steps = Some(PROBE_STEPS);
        let after = match self.probe_after_others(reuse, parameters, steps)? {
            // A run that fails leaves no instance to bring back: then at least the same run twice.
            Some(Probe::Gone) => {
                self.probe_first(reuse, parameters, steps)?;
                self.probe_again(reuse, &plan.values.start, parameters, steps, &mut Ignore)?
            }
            probe => probe,
        };
        // One at a time: the FMU may not allow two.
        drop(self.engine.running().retire());
        let from_new = self.probe_first(reuse, parameters, steps)?;
        self.began = Instant::now();
        match (after, from_new) {
            (Some(Probe::TimedOut), _) | (_, Probe::TimedOut) => {}
            // Runs fail at these values, on new instances too: those with others will show it.
            (Some(Probe::Gone), _) => {}
            (None | Some(Probe::Nothing), Probe::Nothing) => {}
            (after, new) if after == Some(new) => self.set_reuse(reuse),
            _ => self.give_up_reuse(reuse, DIFFERS),
        }
        match (self.engine.running().retire(), self.reuse()) {
            (Some(used), Some(known)) if known == reuse => self.renew_or_replace(used, reuse),
            (used, _) => {
                drop(used);
                Ok((self.new_instance()?, false))
            }
        }
    }

    /// Brings an instance that is new or was reset to the start of a trial run; whether that went well.
    fn begin_probe(&mut self, raw: RawInstance, start_values: &StartValues, parameters: &[f64]) -> bool {
        let _environment = CallEnvironment::enter();
        self.engine.initialize(raw, start_values, parameters).is_ok()
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
        let _environment = CallEnvironment::enter();
        self.engine.running().begin_digest(Digest::default());
        let outcome = self.engine.run(&self.plan, steps, observer);
        let digest =
            self.engine.running().end_digest().map_or(Probe::Nothing, |digest| Probe::Digest(digest.value()));
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
        start_values: &StartValues,
        parameters: &[f64],
    ) -> Result<bool, FmiError> {
        let raw = match self.fresh.take() {
            Some(raw) => raw,
            None => {
                drop(self.engine.running().retire());
                self.new_instance()?
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
        start_values: &StartValues,
        parameters: &[f64],
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Probe, FmiError> {
        match self.begin_new(start_values, parameters)? {
            true => self.finish_probe(steps, observer),
            false => Ok(Probe::Nothing),
        }
    }

    /// Makes a new instance for the next trial run, if that has to be one that can be brought back in a certain way.
    ///
    /// # Errors
    /// There is no new instance to be had.
    pub(crate) fn renewable(&mut self, reuse: Reuse) -> Result<(), FmiError> {
        if reuse == Reuse::Restore {
            self.fresh = None;
            drop(self.engine.running().retire());
            self.fresh = Some(self.new_with_origin()?);
        }
        Ok(())
    }

    /// A trial run on a new instance that can be brought back in this way afterwards.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn probe_first(
        &mut self,
        reuse: Reuse,
        parameters: &[f64],
        steps: Option<u64>,
    ) -> Result<Probe, FmiError> {
        self.renewable(reuse)?;
        let plan = Arc::clone(&self.plan);
        self.probe_new(&plan.values.start, parameters, steps, &mut Ignore)
    }

    /// A trial run on this simulator's instance, brought back to its beginning; `None` if it cannot be brought back.
    ///
    /// # Errors
    /// It was cancelled.
    pub(crate) fn probe_again(
        &mut self,
        reuse: Reuse,
        start_values: &StartValues,
        parameters: &[f64],
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Option<Probe>, FmiError> {
        let Some(used) = self.engine.running().retire() else { return Ok(Some(Probe::Gone)) };
        let Ok(raw) = renew(used, self.plan.fmu(), reuse) else { return Ok(None) };
        match self.begin_probe(raw, start_values, parameters) {
            true => self.finish_probe(steps, observer).map(Some),
            false => Ok(Some(Probe::Nothing)),
        }
    }

    /// The same after a run with other values in between, which shows whether any of them are left behind; `None` if it cannot
    /// be brought back.
    ///
    /// # Errors
    /// It was cancelled.
    pub(crate) fn probe_after_others(
        &mut self,
        reuse: Reuse,
        parameters: &[f64],
        steps: Option<u64>,
    ) -> Result<Option<Probe>, FmiError> {
        let plan = Arc::clone(&self.plan);
        let (start_values, others) = plan.values.others(plan.fmu().description(), parameters);
        match self.probe_again(reuse, &start_values, &others, Some(PROBE_STEPS), &mut Ignore)? {
            Some(_) => self.probe_again(reuse, &plan.values.start, parameters, steps, &mut Ignore),
            None => Ok(None),
        }
    }
}
