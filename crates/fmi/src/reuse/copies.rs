//! A loaded copy of an FMU's library: a loaded file with static variables of its own, its idle instances, and the record of
//! what was ever set in it. Most copies cannot be unloaded, so they are kept and used again.

use super::source::FolderOwner;
use crate::error::FmiError;
use crate::open_options::LogOptions;
use crate::sys::{InterfaceKind, Library, LoadFrom, RawInstance};
use crate::value::{Value, VariableKind};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Idle instances kept in one copy; more than one only where several owners use it together.
const MAX_IDLE: usize = 4;

/// A loaded copy of a library.
pub(crate) struct LoadedCopy {
    path: PathBuf,
    /// One function table for each way of running the model, over the same static variables.
    tables: [Mutex<Option<Arc<Library>>>; 2],
    idle: Mutex<Vec<((InterfaceKind, LogOptions), RawInstance)>>,
    record: Mutex<Record>,
    history: Mutex<History>,
    retired: AtomicBool,
    /// Last: a library that is unloaded is forgotten by its file.
    folder_owner: Mutex<Option<FolderOwner>>,
}

/// The runs made in a copy so far.
#[derive(Debug, Default)]
struct History {
    n_runs: u64,
    /// Runs of another plan than the run before.
    n_changes: u64,
    last_plan: u64,
}

impl History {
    /// Notes a run; whether the number of earlier runs, or of changes of the plan at such a change, is a power of two.
    fn note(&mut self, plan: u64) -> bool {
        let is_change = self.n_runs > 0 && self.last_plan != plan;
        self.n_changes += u64::from(is_change);
        let is_due = self.n_runs.is_power_of_two() || (is_change && self.n_changes.is_power_of_two());
        self.n_runs += 1;
        self.last_plan = plan;
        is_due
    }
}

impl std::fmt::Debug for LoadedCopy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LoadedCopy({})", self.path.display())
    }
}

impl LoadedCopy {
    /// A copy that was just loaded from `library.path()`.
    pub(super) fn new(library: Library, kind: InterfaceKind, folder_owner: Option<FolderOwner>) -> Self {
        let path = library.path().to_owned();
        let copy = Self {
            path,
            tables: Default::default(),
            idle: Mutex::default(),
            record: Mutex::default(),
            history: Mutex::default(),
            retired: AtomicBool::new(false),
            folder_owner: Mutex::new(folder_owner),
        };
        *lock(&copy.tables[kind as usize]) = Some(Arc::new(library));
        copy
    }

    /// The loaded file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The functions for one way of running the model.
    pub(super) fn library(
        &self,
        kind: InterfaceKind,
        open: impl FnOnce(LoadFrom<'_>) -> Result<Library, FmiError>,
    ) -> Result<Arc<Library>, FmiError> {
        let known = |kind: usize| lock(&self.tables[kind]).clone();
        if let Some(library) = known(kind as usize) {
            return Ok(library);
        }
        // It was made with one of the two.
        let library = Arc::new(match known(1 - kind as usize) {
            Some(other) => open(LoadFrom::Loaded(&other))?,
            None => open(LoadFrom::File(&self.path))?,
        });
        *lock(&self.tables[kind as usize]) = Some(Arc::clone(&library));
        Ok(library)
    }

    /// Whether a call has returned `Fatal`: it is never used again.
    pub(super) fn is_fatal(&self) -> bool {
        self.tables
            .iter()
            .any(|table| lock(table).as_ref().is_some_and(|library| library.shared().is_fatal()))
    }

    /// Whether an instance was ever made in it.
    pub(crate) fn is_used(&self) -> bool {
        self.tables.iter().any(|table| lock(table).as_ref().is_some_and(|library| library.shared().is_used()))
    }

    /// Whether it goes with its present user.
    pub(super) fn is_retired(&self) -> bool {
        self.retired.load(Ordering::Relaxed)
    }

    /// Has the copy unloaded when its present user is done with it. The caller knows that it can be.
    pub(super) fn unload_when_unused(&self) {
        self.retired.store(true, Ordering::Relaxed);
        for table in &self.tables {
            if let Some(library) = &*lock(table) {
                library.unload_when_unused();
            }
        }
    }

    /// Notes a run of a plan, by a number that tells plans apart; whether it is one of those to be made again in a fresh copy.
    pub(crate) fn note_run(&self, plan: u64) -> bool {
        lock(&self.history).note(plan)
    }

    /// What was ever set in it.
    pub(crate) fn record(&self) -> MutexGuard<'_, Record> {
        lock(&self.record)
    }

    /// An instance that was used before, to be reset before use. Those of the other kind are freed: in some libraries the
    /// instance made last is the only one that is right.
    pub(crate) fn take_idle(&self, kind: InterfaceKind, logging: &LogOptions) -> Option<RawInstance> {
        let mut idle = lock(&self.idle);
        let is_wanted = |known: &(InterfaceKind, LogOptions)| known.0 == kind && known.1 == *logging;
        let place = idle.iter().rposition(|(known, _)| is_wanted(known));
        let raw = place.map(|place| idle.remove(place).1);
        let others: Vec<_> = idle.extract_if(.., |(known, _)| !is_wanted(known)).collect();
        drop(idle);
        drop(others);
        raw
    }

    /// Keeps an instance for later; frees another one if there are many.
    pub(crate) fn put_idle(&self, kind: InterfaceKind, logging: &LogOptions, raw: RawInstance) {
        if raw.is_fatal() {
            return;
        }
        let mut idle = lock(&self.idle);
        idle.push(((kind, logging.clone()), raw));
        let surplus = (idle.len() > MAX_IDLE).then(|| idle.remove(0));
        drop(idle);
        drop(surplus);
    }

    /// Frees the idle instances.
    pub(crate) fn free_idle(&self) {
        let idle = std::mem::take(&mut *lock(&self.idle));
        drop(idle);
    }

    /// Lets the folder go. What is loaded stays.
    pub(super) fn release_folder(&self) {
        let folder_owner = lock(&self.folder_owner).take();
        drop(folder_owner);
    }

    /// What keeps the folder on the disk; `None` after [`release_folder`](Self::release_folder).
    pub(super) fn folder_owner(&self) -> MutexGuard<'_, Option<FolderOwner>> {
        lock(&self.folder_owner)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A variable by its type and reference; aliases have the same.
pub(crate) type SetKey = (VariableKind, u32);

/// The variables that were ever set in a copy.
#[derive(Debug, Default)]
pub(crate) struct Record {
    /// Sorted.
    keys: Vec<SetKey>,
}

impl Record {
    /// Notes variables that are about to be set.
    pub(crate) fn note(&mut self, keys: impl IntoIterator<Item = SetKey>) {
        for key in keys {
            if let Err(place) = self.keys.binary_search(&key) {
                self.keys.insert(place, key);
            }
        }
    }

    /// The variables, sorted; their number tells whether there are new ones.
    pub(crate) fn keys(&self) -> &[SetKey] {
        &self.keys
    }

    /// Whether one of these was set.
    pub(crate) fn has_any(&self, keys: &[SetKey]) -> bool {
        keys.iter().any(|key| self.keys.binary_search(key).is_ok())
    }
}

/// What new instances of a library answer for variables that were not set; `None`: nothing is known of it.
pub(crate) type Defaults = HashMap<SetKey, Option<Value>>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_runs_are_made_again() {
        let mut history = History::default();
        let due: Vec<u64> = (1..=1000).filter(|_| history.note(7)).collect();
        assert_eq!(due, [2, 3, 5, 9, 17, 33, 65, 129, 257, 513]);
        let due: Vec<u64> = (0..100).filter(|k| history.note(8 + k)).collect();
        // One of them is run 1025.
        assert_eq!(due, [0, 1, 3, 7, 15, 24, 31, 63]);
    }
}
