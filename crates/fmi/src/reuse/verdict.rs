//! What is known about bringing the instances of a library back to their start: one verdict for each kind of interface,
//! for all copies and all who open the FMU.

use crate::error::{FmiError, Status};
use crate::simulation::plan::Setting;
use ode::ErrorKind;
use std::mem::{Discriminant, discriminant};
use std::sync::Arc;

/// The verdict on one kind of instances of a library.
#[derive(Debug, Default)]
pub(crate) struct Verdict {
    /// How instances are brought back; `None` before it was tried. Only gets worse.
    pub(crate) reuse: Option<Reuse>,
    /// Saved states do not bring an instance back.
    pub(crate) no_restore: bool,
    /// How often a simulation was found to depend on earlier ones.
    pub(crate) n_found: u64,
    /// Simulations in newly loaded copies differ, too: there is nothing to find out.
    pub(crate) not_reproducible: bool,
    /// Co-simulation: instances are not made with the event mode that the description promises.
    pub(crate) no_event_mode: bool,
    /// Those in copies that were used before.
    pub(super) failures: Failures,
    /// Ways that passed their trials, each with everything that was set in the runs of the trial: that hides what such a
    /// way leaves behind, so the verdict is one for runs that set all of it.
    proven: Vec<(Reuse, Arc<[Setting]>)>,
}

/// Whether all of `set` is among `settings`; both are sorted.
fn are_covered(set: &[Setting], settings: &[Setting]) -> bool {
    set.iter().all(|one| settings.binary_search(one).is_ok())
}

impl Verdict {
    /// How instances are brought back for runs that set `settings`; `None` before it was tried with all or some of these.
    pub(crate) fn reuse_for(&self, settings: &[Setting]) -> Option<Reuse> {
        let reuse = self.reuse?;
        let is_proven = || self.proven.iter().any(|(way, set)| *way == reuse && are_covered(set, settings));
        (reuse >= Reuse::Reinstantiate || is_proven()).then_some(reuse)
    }

    /// Stores what trial runs that set `settings` have shown.
    pub(crate) fn set_reuse(&mut self, reuse: Reuse, settings: &Arc<[Setting]>) {
        if reuse == Reuse::Restore && self.no_restore {
            return;
        }
        self.reuse = self.reuse.max(Some(reuse));
        if reuse < Reuse::Reinstantiate {
            // What was shown while more was set is shown by this, too.
            self.proven.retain(|(way, set)| *way != reuse || !are_covered(settings, set));
            self.proven.push((reuse, Arc::clone(settings)));
        }
    }

    /// Saved states were found not to bring instances back: where they were thought to, the next way has to be tried.
    pub(crate) fn refuse_restore(&mut self) {
        self.no_restore = true;
        self.reuse = self.reuse.filter(|reuse| *reuse != Reuse::Restore);
    }

    /// A simulation was found to depend on earlier ones: from now on instances are brought back by `reuse`.
    pub(crate) fn set_history(&mut self, reuse: Reuse) {
        self.reuse = self.reuse.max(Some(reuse));
        self.n_found += 1;
    }
}

/// Failures of a sort that are all looked into.
const ALWAYS: u64 = 4;

/// What tells one sort of failures from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FailureKind {
    error: Discriminant<FmiError>,
    of_simulation: Option<Discriminant<ErrorKind>>,
    call: Option<(&'static str, Status)>,
}

impl FailureKind {
    pub(super) fn of(error: &FmiError) -> Self {
        let of_simulation = match error {
            FmiError::Simulation(error) => Some(discriminant(&error.kind)),
            _ => None,
        };
        let call = error.call_failure().map(|failure| (failure.call, failure.status));
        Self { error: discriminant(error), of_simulation, call }
    }
}

/// The failures of a library's runs, by their sorts.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    counts: Vec<(FailureKind, u64)>,
}

impl Failures {
    /// Notes a failure; whether it is one of those to be looked into.
    pub(super) fn note(&mut self, sort: FailureKind) -> bool {
        let place = self.counts.iter().position(|(known, _)| *known == sort).unwrap_or_else(|| {
            self.counts.push((sort, 0));
            self.counts.len() - 1
        });
        let (_, count) = &mut self.counts[place];
        *count += 1;
        *count <= ALWAYS || count.is_power_of_two()
    }
}

/// How the instances of an FMU are brought back to their start between simulations: the first of these ways that was
/// seen to be right. Right means that runs have the same bits as on a new instance, also after a run with other values;
/// which way is faster is never asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Reuse {
    /// By restoring the state saved when the instance was new (model exchange, FMUs that can save states): it was seen to restore
    /// everything, bit for bit. All values are set again afterwards, and read back.
    Restore,
    /// By the FMU's reset function: it was seen to restore everything, bit for bit.
    Reset,
    /// By a new instance for every simulation: nothing else is offered, or it fails, or it leaves traces.
    Reinstantiate,
    /// By a newly loaded copy of the library, with resources of its own, for every simulation: the model keeps a state outside of its
    /// instances.
    Reload,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn verdicts_only_get_worse() {
        let (mut verdict, nothing) = (Verdict::default(), Arc::from([]));
        verdict.set_reuse(Reuse::Reset, &nothing);
        verdict.set_reuse(Reuse::Restore, &nothing);
        assert_eq!(verdict.reuse, Some(Reuse::Reset));
        verdict.set_reuse(Reuse::Reinstantiate, &nothing);
        assert_eq!(verdict.reuse_for(&[]), Some(Reuse::Reinstantiate));
    }
}
