//! What the simulations of an FMU keep with it while it is open: the loaded copies of its library, what showed in runs.

use super::copy_use::CopyRequest;
use super::instantiate::NO_EVENT_MODE;
use super::source::{Key, Source};
use super::store::CopyStore;
use super::verdict::Reuse;
use crate::archive::Part;
use crate::cancel::Cancel;
use crate::description::{Quirk, QuirkKind};
use crate::error::FmiError;
use crate::fmu::{Fmu, Kind};
use crate::platform;
use crate::simulation::Sharing;
use crate::sys::InterfaceKind;
use std::collections::HashMap;
use std::ops::Deref;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// What is kept with an open FMU.
#[derive(Debug, Default)]
struct FmuRuns {
    /// The loaded copies of the library of each way of running the model; found when first needed.
    stores: [Mutex<Option<StoreUse>>; 2],
    /// Of each way: how long the last simulation of a session took, in ns; 0: there was none.
    last_runs: [AtomicU64; 2],
}

impl Fmu {
    fn runs(&self) -> &FmuRuns {
        self.attached()
    }

    /// How long the last simulation of a [`Session`](crate::Session) of this FMU took, by any of its clones; loading the
    /// library does not count. `None`: there was none.
    pub fn last_run(&self, kind: InterfaceKind) -> Option<Duration> {
        let nanoseconds = self.runs().last_runs[kind as usize].load(Ordering::Relaxed);
        (nanoseconds > 0).then(|| Duration::from_nanos(nanoseconds))
    }

    pub(crate) fn note_run(&self, kind: InterfaceKind, took: Duration) {
        let nanoseconds = u64::try_from(took.as_nanos()).unwrap_or(u64::MAX);
        self.runs().last_runs[kind as usize].store(nanoseconds.max(1), Ordering::Relaxed);
    }

    /// Departures from the standard that showed when the FMU was run; those of its description are in
    /// [`ModelDescription::quirks`](crate::ModelDescription::quirks).
    pub fn quirks_seen(&self) -> Vec<Quirk> {
        let store = self.known_store(InterfaceKind::CoSimulation);
        let refused = store.is_some_and(|store| store.verdict(InterfaceKind::CoSimulation).no_event_mode);
        let quirk = || Quirk { kind: QuirkKind::Promise, message: NO_EVENT_MODE.to_owned(), line: 0 };
        let mut seen = self.noted_quirks();
        seen.extend(refused.then(quirk));
        seen
    }

    /// Notes that simulations write into the resources, which all of them would see: from now on each has a newly loaded copy of
    /// the library, with the resources as they were in the archive (of a folder: as they are now).
    ///
    /// # Errors
    /// The resources cannot be unpacked again.
    pub(crate) fn note_written_resource(
        &self,
        store: &CopyStore,
        kind: InterfaceKind,
        file: &Path,
    ) -> Result<(), FmiError> {
        self.archive().renew_resources()?;
        store.set_private_resources();
        store.verdict(kind).set_history(Reuse::Reload);
        let root = self.running_root()?;
        let name = file.strip_prefix(&root).unwrap_or(file).display();
        let message = format!(
            "simulations write into the resources ({name}): every simulation gets a newly loaded copy of the library, with \
             resources of its own, from now on; results from before may be wrong"
        );
        self.note_quirk(QuirkKind::Promise, message);
        Ok(())
    }

    /// Notes that simulations depend on earlier ones: from now on each is begun by `reuse`.
    pub(crate) fn note_history(&self, kind: InterfaceKind, reuse: Reuse) -> Result<(), FmiError> {
        self.store(kind)?.verdict(kind).set_history(reuse);
        let way = match reuse {
            Reuse::Reload => "a newly loaded copy of the library",
            _ => "a new instance",
        };
        let message = format!(
            "a simulation depends on earlier ones: the model keeps a state that no variable shows, and that resetting does \
             not bring back; every simulation gets {way} from now on, and results from before may be wrong"
        );
        self.note_quirk(QuirkKind::Promise, message);
        Ok(())
    }

    /// Notes that simulations in newly loaded copies differ.
    pub(crate) fn note_not_reproducible(&self, kind: InterfaceKind) -> Result<(), FmiError> {
        self.store(kind)?.verdict(kind).not_reproducible = true;
        let message = "two simulations in newly loaded copies of the library differ: no result can be reproduced (unless what it keeps \
             in the C library or in files is disturbed by other simulations at the same time: then sharing = serial helps)";
        self.note_quirk(QuirkKind::Promise, message);
        Ok(())
    }

    /// How often a simulation was found to depend on earlier ones (see [`quirks_seen`](Self::quirks_seen)): each time, a safer
    /// way of bringing instances back was taken from then on, and results from before may be wrong.
    pub fn n_history_findings(&self, kind: InterfaceKind) -> u64 {
        self.known_store(kind).map_or(0, |store| store.verdict(kind).n_found)
    }

    /// Unpacks, compiles and loads what the first simulation needs, so that it is not kept waiting; ends early when
    /// `cancel` asks for it. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// The FMU cannot be run here (see [`FmiError`]); [`FmiError::Cancelled`].
    pub fn prepare(&self, kind: Kind, cancel: &Cancel) -> Result<(), FmiError> {
        let kind = self.choose(kind)?;
        let store = self.store_unless(kind, cancel)?;
        store.lend(&CopyRequest::for_good(self, kind), &mut || false)?;
        Ok(())
    }

    /// How instances are reset, for the interface that is used where nothing else is asked for; `None` before it was tried.
    pub fn reuse(&self) -> Option<Reuse> {
        self.choose(Kind::Auto).ok().and_then(|kind| self.reuse_of(kind))
    }

    /// How instances are reset; `None` before it was tried.
    pub fn reuse_of(&self, kind: InterfaceKind) -> Option<Reuse> {
        self.known_store(kind)?.verdict(kind).reuse
    }

    /// How simulations that run in parallel share the process where nothing is asked for: with copies of the library, or one at
    /// a time where these would share state or cannot be loaded. `None` before the library was first needed.
    pub fn sharing_of(&self, kind: InterfaceKind) -> Option<Sharing> {
        self.known_store(kind).map(|store| store.sharing())
    }

    fn slot(&self, kind: InterfaceKind) -> MutexGuard<'_, Option<StoreUse>> {
        self.runs().stores[kind as usize].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The loaded copies of the library; `None` before they are first needed.
    fn known_store(&self, kind: InterfaceKind) -> Option<Arc<CopyStore>> {
        self.slot(kind).as_deref().map(Arc::clone)
    }

    /// The loaded copies of the library for this platform, which is compiled before that if the FMU brings sources only.
    pub(crate) fn store(&self, kind: InterfaceKind) -> Result<Arc<CopyStore>, FmiError> {
        self.store_unless(kind, &Cancel::default())
    }

    /// As [`store`](Self::store), unless `cancel` asks for an early end.
    pub(crate) fn store_unless(
        &self,
        kind: InterfaceKind,
        cancel: &Cancel,
    ) -> Result<Arc<CopyStore>, FmiError> {
        // The lock is held meanwhile: a second thread waits instead of compiling it again.
        let mut slot = self.slot(kind);
        if let Some(store) = &*slot {
            return Ok(Arc::clone(store));
        }
        let library = self.binary(self.check_interface(kind)?, cancel)?;
        let archive = self.archive();
        if let Some(file) = archive.changed_library() {
            let path = self.path().to_owned();
            let name = file.strip_prefix(archive.unpack()?).unwrap_or(file).display();
            let reason =
                format!("{name} was written over or removed after the folder had been opened; open it again");
            return Err(FmiError::BadArchive { path, reason });
        }
        let (root, loader) = (archive.unpack_part(Part::Running, cancel)?, self.loader());
        let (key, identity) = match (library.strip_prefix(&root), archive.fingerprint()) {
            (Ok(place), Some(content)) => (Key::Content(content, place.to_owned(), loader), None),
            _ => {
                let metadata = library.metadata().map_err(FmiError::io("open", &library))?;
                let identity = platform::file_identity(&metadata);
                (Key::File(identity.place(&library), identity.clone(), loader), Some(identity))
            }
        };
        let source = Source { library, root, identity, folder_owner: Some(Arc::clone(archive) as _) };
        let store = slot.insert(StoreUse::new(key, source));
        Ok(Arc::clone(store))
    }
}

/// The stores of this process, which loaded libraries do not leave either.
static STORES: Mutex<Option<HashMap<Key, Arc<CopyStore>>>> = Mutex::new(None);

/// A use of a store by an open FMU.
#[derive(Debug)]
pub(crate) struct StoreUse(Arc<CopyStore>);

impl StoreUse {
    /// The store of a library; made if there is none.
    pub(crate) fn new(key: Key, source: Source) -> Self {
        let store = {
            let mut stores = STORES.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(
                stores.get_or_insert_default().entry(key).or_insert_with(|| Arc::new(CopyStore::new())),
            )
        };
        let mut state = store.state();
        state.users += 1;
        // The folder of the first of several users stays as long as there is any.
        state.source.get_or_insert(source);
        drop(state);
        Self(store)
    }
}

impl Deref for StoreUse {
    type Target = Arc<CopyStore>;

    fn deref(&self) -> &Arc<CopyStore> {
        &self.0
    }
}

impl Drop for StoreUse {
    fn drop(&mut self) {
        let mut state = self.0.state();
        state.users -= 1;
        if state.users > 0 {
            return;
        }
        let source = state.source.take();
        let idle = state.idle.clone();
        state.refused = None;
        drop(state);
        for copy in &idle {
            copy.free_idle();
            copy.release_folder();
        }
        drop(source);
    }
}
