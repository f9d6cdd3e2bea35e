//! What is known about bringing the instances of a library back to their start: one verdict for each kind of interface,
//! for all copies and all who open the FMU.

use crate::error::{FmiError, Status};
use crate::simulation::plan::Setting;
use crate::sys::InterfaceKind;
use ode::ErrorKind;
use std::mem::{Discriminant, discriminant};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The verdicts on a library.
#[derive(Debug, Default)]
pub(crate) struct Verdicts {
    kinds: [Mutex<Verdict>; 2],
    /// Co-simulations will not be made with the event mode that the description promises.
    no_event_mode: AtomicBool,
}

/// The verdict on one kind of instances.
#[derive(Debug, Default)]
struct Verdict {
    /// Only gets worse.
    reuse: Option<Reuse>,
    /// Saved states do not bring an instance back.
    no_restore: bool,
    /// How often a simulation was found to depend on earlier ones.
    n_found: u64,
    /// Simulations in newly loaded copies differ, too.
    not_reproducible: bool,
    /// Those in copies that were used before.
    failures: Failures,
    /// Ways that passed their trials, each with everything that was set in the runs of the trial: that hides what such a
    /// way leaves behind, so the verdict is one for runs that set all of it.
    proven: Vec<(Reuse, Arc<[Setting]>)>,
}

/// Whether all of `set` is among `settings`; both are sorted.
fn are_covered(set: &[Setting], settings: &[Setting]) -> bool {
    set.iter().all(|one| settings.binary_search(one).is_ok())
}

impl Verdicts {
    fn of(&self, kind: InterfaceKind) -> MutexGuard<'_, Verdict> {
        self.kinds[kind as usize].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How instances are brought back; `None` before it was tried.
    pub(crate) fn reuse(&self, kind: InterfaceKind) -> Option<Reuse> {
        self.of(kind).reuse
    }

    /// The same for runs that set `settings`; `None` before it was tried with all or some of these.
    pub(crate) fn reuse_for(&self, kind: InterfaceKind, settings: &[Setting]) -> Option<Reuse> {
        let verdict = self.of(kind);
        let reuse = verdict.reuse?;
        let is_proven =
            || verdict.proven.iter().any(|(way, set)| *way == reuse && are_covered(set, settings));
        (reuse >= Reuse::Reinstantiate || is_proven()).then_some(reuse)
    }

    /// Stores what trial runs that set `settings` have shown.
    pub(crate) fn set_reuse(&self, kind: InterfaceKind, reuse: Reuse, settings: &Arc<[Setting]>) {
        let mut verdict = self.of(kind);
        if reuse == Reuse::Restore && verdict.no_restore {
            return;
        }
        verdict.reuse = verdict.reuse.max(Some(reuse));
        if reuse < Reuse::Reinstantiate {
            // What was shown while more was set is shown by this, too.
            verdict.proven.retain(|(way, set)| *way != reuse || !are_covered(settings, set));
            verdict.proven.push((reuse, Arc::clone(settings)));
        }
    }

    /// Whether saved states may bring instances back, as far as is known.
    pub(crate) fn may_restore(&self, kind: InterfaceKind) -> bool {
        !self.of(kind).no_restore
    }

    /// Saved states were found not to bring instances back: where they were thought to, the next way has to be tried.
    pub(crate) fn refuse_restore(&self, kind: InterfaceKind) {
        let mut verdict = self.of(kind);
        verdict.no_restore = true;
        verdict.reuse = verdict.reuse.filter(|reuse| *reuse != Reuse::Restore);
    }

    /// A simulation was found to depend on earlier ones: from now on instances are brought back by `reuse`.
    pub(crate) fn set_history(&self, kind: InterfaceKind, reuse: Reuse) {
        let mut verdict = self.of(kind);
        verdict.reuse = verdict.reuse.max(Some(reuse));
        verdict.n_found += 1;
    }

    /// How often a simulation was found to depend on earlier ones.
    pub(crate) fn n_found(&self, kind: InterfaceKind) -> u64 {
        self.of(kind).n_found
    }

    /// Notes a simulation that has failed in a copy that was used before; whether it is to be made again in a new one.
    pub(super) fn note_failure(&self, kind: InterfaceKind, sort: Sort) -> bool {
        self.of(kind).failures.note(sort)
    }

    /// Whether simulations differ in newly loaded copies, too; then there is nothing to find out.
    pub(crate) fn is_not_reproducible(&self, kind: InterfaceKind) -> bool {
        self.of(kind).not_reproducible
    }

    pub(crate) fn set_not_reproducible(&self, kind: InterfaceKind) {
        self.of(kind).not_reproducible = true;
    }

    /// Whether co-simulations were seen to refuse the event mode that the description promises.
    pub(crate) fn is_event_mode_refused(&self) -> bool {
        self.no_event_mode.load(Ordering::Relaxed)
    }

    pub(crate) fn refuse_event_mode(&self) {
        self.no_event_mode.store(true, Ordering::Relaxed);
    }
}

/// Failures of a sort that are all looked into.
const ALWAYS: u64 = 4;

/// What tells one sort of failures from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sort {
    error: Discriminant<FmiError>,
    of_simulation: Option<Discriminant<ErrorKind>>,
    call: Option<(&'static str, Status)>,
}

impl Sort {
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
    counts: Vec<(Sort, u64)>,
}

impl Failures {
    /// Notes a failure; whether it is one of those to be looked into.
    pub(super) fn note(&mut self, sort: Sort) -> bool {
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
        let (verdicts, nothing) = (Verdicts::default(), Arc::from([]));
        let kind = InterfaceKind::CoSimulation;
        verdicts.set_reuse(kind, Reuse::Reset, &nothing);
        verdicts.set_reuse(kind, Reuse::Restore, &nothing);
        assert_eq!(verdicts.reuse(kind), Some(Reuse::Reset));
        assert_eq!(verdicts.reuse(InterfaceKind::ModelExchange), None);
        verdicts.set_reuse(kind, Reuse::Reinstantiate, &nothing);
        assert_eq!(verdicts.reuse_for(kind, &[]), Some(Reuse::Reinstantiate));
    }
}
