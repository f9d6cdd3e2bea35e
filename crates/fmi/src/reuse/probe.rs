//! Trial runs: on new instances, and on used ones that were reset, so that they can be compared.

use super::reset::reset;
use super::runner::Runner;
use super::verdict::Reuse;
use crate::error::FmiError;
use crate::simulation::digest::Digest;
use crate::simulation::variable_elements::RunInput;
use crate::sys::{CallEnvironment, RawInstance};
use ode::{ErrorKind, Observer};

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
    /// The trial run of an instance that is new or was reset.
    ///
    /// # Errors
    /// It was cancelled. A simulation that fails is part of the digest.
    fn probe(
        &mut self,
        raw: RawInstance,
        input: RunInput<'_>,
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Probe, FmiError> {
        let _environment = CallEnvironment::enter();
        if self.engine.initialize(raw, input).is_err() {
            return Ok(Probe::Nothing);
        }
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

    /// A trial run on a new instance.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn probe_new(
        &mut self,
        input: RunInput<'_>,
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Probe, FmiError> {
        let raw = match self.fresh.take() {
            Some(raw) => raw,
            None => {
                drop(self.engine.running().retire());
                self.new_instance()?
            }
        };
        self.probe(raw, input, steps, observer)
    }

    /// A trial run on a new instance that can be brought back in this way afterwards.
    ///
    /// # Errors
    /// It was cancelled; there is no new instance to be had.
    pub(crate) fn probe_first(
        &mut self,
        reuse: Reuse,
        input: RunInput<'_>,
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Probe, FmiError> {
        if reuse == Reuse::Restore {
            self.fresh = None;
            drop(self.engine.running().retire());
            self.fresh = Some(self.new_with_origin()?);
        }
        self.probe_new(input, steps, observer)
    }

    /// A trial run on this simulator's instance, brought back to its start; `None` if it cannot be brought back.
    ///
    /// # Errors
    /// It was cancelled.
    pub(crate) fn probe_again(
        &mut self,
        reuse: Reuse,
        input: RunInput<'_>,
        steps: Option<u64>,
        observer: &mut dyn Observer,
    ) -> Result<Option<Probe>, FmiError> {
        let Some(used) = self.engine.running().retire() else { return Ok(Some(Probe::Gone)) };
        let Ok(raw) = reset(used, self.plan.fmu(), reuse) else { return Ok(None) };
        self.probe(raw, input, steps, observer).map(Some)
    }
}
