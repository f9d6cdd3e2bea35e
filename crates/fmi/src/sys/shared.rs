//! What all users of one loaded library have in common, whichever way they opened it: the loader gives the same code and the
//! same globals to everybody in the process.

use super::InterfaceKind;
use crate::copies::CopyStore;
use crate::error::FmiError;
use crate::platform::{self, FileIdentity, FilePlace};
use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::ThreadId;

/// The libraries of this process. An entry is never removed, as no library is ever unloaded (see `platform::open`).
static KNOWN: Mutex<Option<Libraries>> = Mutex::new(None);

/// Each with what its file was when it was loaded.
type Libraries = HashMap<FilePlace, (FileIdentity, Arc<Shared>)>;

/// Instances kept for later, that can be freed when the library allows no others beside them.
pub(crate) trait Spares: Send + Sync {
    /// Frees them.
    fn free_all(&self);
}

/// What is known about a library, and who uses it.
#[derive(Default)]
pub(crate) struct Shared {
    /// Instances alive.
    pub(super) live: AtomicUsize,
    /// Counts instances made and freed.
    pub(super) epoch: AtomicU64,
    /// A call returned `Fatal`.
    fatal: AtomicBool,
    /// Instances disturb each other, or only one is allowed.
    dependent: AtomicBool,
    /// Whether private copies of the library help where instances disturb each other; 0: not known.
    copies: AtomicU8,
    copy_store: Mutex<Weak<CopyStore>>,
    /// Two threads were seen to run instances at the same time and get the right results.
    reentrant: AtomicBool,
    /// How instances are brought back to their beginning, for each kind of interface; larger is worse, and a verdict only
    /// gets worse.
    reuse: [AtomicU8; 2],
    /// For each kind of interface: saved states do not bring an instance back to its beginning.
    no_restore: [AtomicBool; 2],
    /// Co-simulations will not be made with the event mode that the description promises.
    no_event_mode: AtomicBool,
    gate: Mutex<Inside>,
    left: Condvar,
    /// Whether somebody holds the loan of a library that can be lent to one only.
    lent: Mutex<bool>,
    returned: Condvar,
    spares: Mutex<Vec<Weak<dyn Spares>>>,
}

/// Who is running.
#[derive(Default)]
struct Inside {
    /// One thread for itself, and how often it went in.
    alone: Option<(ThreadId, usize)>,
    /// Threads that do not mind each other.
    together: Vec<ThreadId>,
}

/// Leave to use the library, until it is dropped.
pub(crate) struct Turn<'a>(Option<&'a Shared>);

/// The one loan of a library that is lent to one only; given back on drop.
#[derive(Debug)]
pub(crate) struct Loan(Arc<Shared>);

impl Shared {
    /// What is shared by all users of the library at `path`, which is about to be loaded.
    ///
    /// # Errors
    /// The file cannot be looked at, or it was written over since it was loaded: the loader would hand out the old code.
    pub(super) fn of(path: &Path) -> Result<Arc<Shared>, FmiError> {
        let metadata = path.metadata().map_err(FmiError::io("open", path))?;
        let identity = platform::file_identity(&metadata);
        let mut known = lock(&KNOWN);
        let entries = known.get_or_insert_default();
        match entries.get(&identity.place(path)) {
            Some((then, shared)) if then.same_content(&identity) => Ok(Arc::clone(shared)),
            Some(_) => Err(FmiError::LoadFailed {
                library: path.to_owned(),
                message: "the file was written over after this process had loaded it; restart the process, or give \
                          the new version a file of its own"
                    .to_owned(),
            }),
            None => {
                let shared = Arc::<Shared>::default();
                entries.insert(identity.place(path), (identity, Arc::clone(&shared)));
                Ok(shared)
            }
        }
    }

    /// Forgets a library that could not be loaded.
    pub(super) fn forget(path: &Path) {
        if let Ok(metadata) = path.metadata() {
            let place = platform::file_identity(&metadata).place(path);
            if let Some(entries) = &mut *lock(&KNOWN) {
                entries.remove(&place);
            }
        }
    }

    /// Whether a call has returned `Fatal`: then nothing of the library can be trusted any more.
    pub(crate) fn is_fatal(&self) -> bool {
        self.fatal.load(Ordering::Relaxed)
    }

    pub(super) fn set_fatal(&self) {
        self.fatal.store(true, Ordering::Relaxed);
    }

    /// Whether co-simulations were seen to refuse the event mode that the description promises.
    pub(crate) fn is_event_mode_refused(&self) -> bool {
        self.no_event_mode.load(Ordering::Relaxed)
    }

    pub(crate) fn refuse_event_mode(&self) {
        self.no_event_mode.store(true, Ordering::Relaxed);
    }

    /// Whether instances disturb each other, or only one is allowed.
    pub(crate) fn is_dependent(&self) -> bool {
        self.dependent.load(Ordering::Acquire)
    }

    /// From now on, one instance at a time is made, run and freed.
    pub(crate) fn set_dependent(&self) {
        // Under the lock of the gate, so that nobody goes in with the old answer afterwards.
        let _inside = lock(&self.gate);
        self.dependent.store(true, Ordering::Release);
    }

    /// Whether simulations with private copies of the library were seen not to disturb each other; `None`: not known.
    pub(crate) fn copies_work(&self) -> Option<bool> {
        match self.copies.load(Ordering::Acquire) {
            0 => None,
            verdict => Some(verdict == 1),
        }
    }

    /// Stores what was found about private copies; that they do not help is not taken back.
    pub(crate) fn set_copies_work(&self, work: bool) {
        self.copies.fetch_max(if work { 1 } else { 2 }, Ordering::AcqRel);
    }

    /// The store of copies that all users of the library share: the one there is, or the one that is made now.
    pub(crate) fn copy_store(&self, make: impl FnOnce() -> CopyStore) -> Arc<CopyStore> {
        let mut known = lock(&self.copy_store);
        known.upgrade().unwrap_or_else(|| {
            let store = Arc::new(make());
            *known = Arc::downgrade(&store);
            store
        })
    }

    /// Whether two threads were seen to run instances at the same time without harm.
    pub(crate) fn is_reentrant(&self) -> bool {
        self.reentrant.load(Ordering::Relaxed)
    }

    pub(crate) fn set_reentrant(&self) {
        self.reentrant.store(true, Ordering::Relaxed);
    }

    /// The verdict on bringing instances of one kind back to their beginning; 0: none.
    pub(crate) fn reuse(&self, kind: InterfaceKind) -> u8 {
        self.reuse[kind as usize].load(Ordering::Acquire)
    }

    /// Stores a verdict, unless a worse one is known.
    pub(crate) fn worsen_reuse(&self, kind: InterfaceKind, verdict: u8) {
        self.reuse[kind as usize].fetch_max(verdict, Ordering::AcqRel);
    }

    /// From now on, no instance of this kind is brought back by a saved state. `verdict` is the one that said it could be
    /// done: if it stands, there is none afterwards, and the next way has to be tested.
    pub(crate) fn refuse_restore(&self, kind: InterfaceKind, verdict: u8) {
        self.no_restore[kind as usize].store(true, Ordering::Release);
        let reuse = &self.reuse[kind as usize];
        let _ = reuse.compare_exchange(verdict, 0, Ordering::AcqRel, Ordering::Acquire);
    }

    /// Whether saved states were found not to bring instances of this kind back.
    pub(crate) fn is_restore_refused(&self, kind: InterfaceKind) -> bool {
        self.no_restore[kind as usize].load(Ordering::Acquire)
    }

    /// Waits for a turn to run: at once, unless instances disturb each other. A thread that has a turn already is not
    /// kept waiting.
    pub(crate) fn turn(&self) -> Turn<'_> {
        let me = std::thread::current().id();
        let mut inside = lock(&self.gate);
        loop {
            if let Some((_, depth)) = inside.alone.as_mut().filter(|(holder, _)| *holder == me) {
                *depth += 1;
                return Turn(Some(self));
            }
            let dependent = self.is_dependent();
            if inside.together.contains(&me) || (!dependent && inside.alone.is_none()) {
                inside.together.push(me);
                return Turn(Some(self));
            }
            if dependent && inside.alone.is_none() && inside.together.is_empty() {
                inside.alone = Some((me, 1));
                return Turn(Some(self));
            }
            inside = self.left.wait(inside).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// A turn for a thread whose results the holder of a turn waits for: at once, in any case.
    pub(crate) fn turn_beside(&self) -> Turn<'_> {
        lock(&self.gate).together.push(std::thread::current().id());
        Turn(Some(self))
    }

    /// As [`turn`](Self::turn), for what needs none while instances do not disturb each other.
    pub(crate) fn turn_if_dependent(&self) -> Turn<'_> {
        if self.is_dependent() { self.turn() } else { Turn(None) }
    }

    /// Waits for the one loan.
    pub(crate) fn borrow_alone(self: &Arc<Self>) -> Loan {
        let mut lent = lock(&self.lent);
        while *lent {
            lent = self.returned.wait(lent).unwrap_or_else(PoisonError::into_inner);
        }
        *lent = true;
        Loan(Arc::clone(self))
    }

    /// Notes a store of instances that may be freed at any time.
    pub(crate) fn add_spares(&self, spares: Weak<dyn Spares>) {
        let mut known = lock(&self.spares);
        known.retain(|spares| spares.strong_count() > 0);
        known.push(spares);
    }

    /// Frees the instances that nobody uses at present, of all users.
    pub(crate) fn free_spares(&self) {
        let spares: Vec<_> = lock(&self.spares).iter().filter_map(Weak::upgrade).collect();
        for spares in spares {
            spares.free_all();
        }
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        let Some(shared) = self.0 else { return };
        let me = std::thread::current().id();
        let mut inside = lock(&shared.gate);
        match &mut inside.alone {
            Some((holder, depth)) if *holder == me => {
                *depth -= 1;
                if *depth == 0 {
                    inside.alone = None;
                }
            }
            _ => {
                if let Some(place) = inside.together.iter().position(|thread| *thread == me) {
                    inside.together.swap_remove(place);
                }
            }
        }
        drop(inside);
        if shared.is_dependent() {
            shared.left.notify_all();
        }
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        *lock(&self.0.lent) = false;
        self.0.returned.notify_one();
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Shared")
            .field("live", &self.live)
            .field("fatal", &self.fatal)
            .field("dependent", &self.dependent)
            .field("reuse", &self.reuse)
            .finish_non_exhaustive()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    #[test]
    fn turns_exclude_each_other_only_where_they_must() {
        let shared = Arc::<Shared>::default();
        let first = shared.turn();
        // Together, and again on the same thread.
        std::thread::scope(|scope| drop(scope.spawn(|| drop(shared.turn())).join()));
        drop(shared.turn());
        shared.set_dependent();
        // Who is inside is not kept waiting, who is not waits until all have left.
        drop(shared.turn());
        let (sender, receiver) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let turn = shared.turn();
                sender.send(()).unwrap();
                drop(shared.turn());
                drop(turn);
            });
            assert!(receiver.recv_timeout(Duration::from_millis(50)).is_err());
            drop(first);
            receiver.recv_timeout(Duration::from_secs(20)).unwrap();
        });
        drop(shared.turn());
    }

    #[test]
    fn verdicts_only_get_worse() {
        let shared = Shared::default();
        shared.worsen_reuse(InterfaceKind::CoSimulation, 2);
        shared.worsen_reuse(InterfaceKind::CoSimulation, 1);
        assert_eq!(shared.reuse(InterfaceKind::CoSimulation), 2);
        assert_eq!(shared.reuse(InterfaceKind::ModelExchange), 0);
    }
}
