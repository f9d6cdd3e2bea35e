//! State of a worker process that affects its calls. It contains the calls to be omitted at the end of a run,
//! because they have ended an earlier process. It also contains the suffix of instance names.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Names of the functions that are not called.
static AVOIDED: OnceLock<Vec<String>> = OnceLock::new();

/// True if an instance was not freed.
static HAS_KEPT: AtomicBool = AtomicBool::new(false);

/// Number of this process among the workers of its program.
static PLACE: AtomicU32 = AtomicU32::new(0);

/// Sets the functions that this process does not call at the end of a run.
pub(crate) fn set_avoided_calls(names: Vec<String>) {
    // Set only once, because a worker is started only once.
    let _ = AVOIDED.set(names);
}

/// True if a function must not be called at the end of a run.
pub(super) fn is_avoided(name: &str) -> bool {
    AVOIDED.get().is_some_and(|names| names.iter().any(|avoided| avoided == name))
}

/// Records that an instance was not freed.
pub(super) fn note_kept() {
    HAS_KEPT.store(true, Ordering::Relaxed);
}

/// True if this process has unfreed instances. The process should then be replaced.
pub(crate) fn has_kept_instances() -> bool {
    HAS_KEPT.load(Ordering::Relaxed)
}

/// Sets the number that distinguishes instance names of this process from the names in other workers.
pub(crate) fn set_instance_suffix(place: u32) {
    PLACE.store(place, Ordering::Relaxed);
}

/// Returns the suffix of instance names in this process; empty in the first one.
pub(crate) fn instance_suffix() -> String {
    match PLACE.load(Ordering::Relaxed) {
        0 => String::new(),
        place => format!("_{}", place.saturating_add(1)),
    }
}

/// True if the process may write only to its own folder.
static IS_CONFINED: AtomicBool = AtomicBool::new(false);

/// Hint in errors after the sandbox has denied an operation.
pub(crate) const REFUSED: &str = "the sandbox denied the model an operation: with sandbox=True, the model \
                                  can read files, but can write only to its temporary folder (TMPDIR)";

/// Clears earlier denials before a simulation.
pub(crate) fn forget_refusal() {
    #[cfg(target_os = "linux")]
    if IS_CONFINED.load(Ordering::Relaxed) {
        // SAFETY: the address of the error number of this thread, which is valid while the thread exists.
        unsafe { *libc::__errno_location() = 0 };
    }
}

/// Records that the process may write only to its own folder.
pub(crate) fn set_confined() {
    IS_CONFINED.store(true, Ordering::Relaxed);
}

/// True if the process may write only to its own folder, and permission was denied to the last failed system
/// call of this thread. May be called in a signal handler.
pub(super) fn is_refused() -> bool {
    IS_CONFINED.load(Ordering::Relaxed)
        && std::io::Error::last_os_error().kind() == std::io::ErrorKind::PermissionDenied
}

/// Returns [`REFUSED`] if an operation was denied.
pub(crate) fn refusal() -> Option<&'static str> {
    is_refused().then_some(REFUSED)
}
