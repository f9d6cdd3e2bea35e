//! Failed runs made again in a newly loaded copy of the library: shows whether a failure depends on earlier runs.
//!
//! Of failures of one sort (the same function, status and kind of error) these are the first four, and those with the numbers 8, 16,
//! 32, ...: models may fail at many points whatever ran before, and then every time.

use super::history::{Polled, is_from_outside};
use super::runner::Runner;
use super::verdict::FailureKind;
use crate::error::FmiError;
use ode::Observer;
use std::sync::Arc;

impl Runner {
    /// Whether a run that has just failed in a copy that was used before does so because of earlier runs: it is made again in a new
    /// copy, without samples.
    #[cold]
    pub(crate) fn fails_by_history(
        &mut self,
        error: &FmiError,
        parameters: &[f64],
        observer: &mut dyn Observer,
    ) -> bool {
        let Some(store) = self.lease.as_ref().map(|lease| Arc::clone(lease.store())) else { return false };
        let kind = self.plan.kind;
        if is_from_outside(error)
            || !self.may_compare()
            || !store.verdict(kind).failures.note(FailureKind::of(error))
        {
            return false;
        }
        let before = store.verdict(kind).n_found;
        let compared = self.make_again(parameters, observer);
        self.return_to_copy();
        if let Err(error) = compared {
            log::info!(
                "{}: a failed simulation could not be made again: {error}",
                self.plan.fmu().path().display()
            );
        }
        store.verdict(kind).n_found > before
    }

    fn make_again(&mut self, parameters: &[f64], observer: &mut dyn Observer) -> Result<(), FmiError> {
        let took = self.began.elapsed();
        let Some(is_other_copy) = self.use_other_copy()? else { return Ok(()) };
        let (plan, wants_steps) = (Arc::clone(&self.plan), observer.wants_steps());
        let mut poll = || observer.poll();
        let mut polled = Polled::new(&plan, wants_steps, &mut poll).at_least(2 * took);
        match self.digest_of(parameters, &mut polled) {
            Some((fresh, false)) if !polled.is_late => {
                self.find_cause((&fresh, false), is_other_copy, parameters, &mut polled)
            }
            _ => Ok(()),
        }
    }
}
