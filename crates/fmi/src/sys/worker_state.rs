//! State of a worker process that its calls depend on: the calls that it leaves out at the end of a run,
//! because they have ended an earlier process, and the end of the names of its instances.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Names of the functions that are not called.
static AVOIDED: OnceLock<Vec<String>> = OnceLock::new();

/// An instance was not freed.
static HAS_KEPT: AtomicBool = AtomicBool::new(false);

/// Number of this process among the workers of its program.
static PLACE: AtomicU32 = AtomicU32::new(0);

/// Sets the functions that this process does not call at the end of a run.
#[cfg(unix)]
pub(crate) fn set_avoided_calls(names: Vec<String>) {
    // Set once: a worker has one start.
    let _ = AVOIDED.set(names);
}

/// True if a function is not to be called at the end of a run.
pub(super) fn is_avoided(name: &str) -> bool {
    AVOIDED.get().is_some_and(|names| names.iter().any(|avoided| avoided == name))
}

/// Notes that an instance was not freed.
pub(super) fn note_kept() {
    HAS_KEPT.store(true, Ordering::Relaxed);
}

/// True if this process has instances that were not freed: it should be replaced.
#[cfg(unix)]
pub(crate) fn has_kept_instances() -> bool {
    HAS_KEPT.load(Ordering::Relaxed)
}

/// Sets the number by which the names of instances of this process differ from those of other workers.
#[cfg(unix)]
pub(crate) fn set_instance_suffix(place: u32) {
    PLACE.store(place, Ordering::Relaxed);
}

/// End of the names of instances of this process; empty in the first one.
pub(crate) fn instance_suffix() -> String {
    match PLACE.load(Ordering::Relaxed) {
        0 => String::new(),
        place => format!("_{}", place.saturating_add(1)),
    }
}

/// The process may write into its own folder only.
static IS_CONFINED: AtomicBool = AtomicBool::new(false);

/// Hint of errors after something that the sandbox has refused.
pub(crate) const REFUSED: &str = "the model was denied permission: with sandbox=True it can read files, and can write only below its folder for \
                                  temporary files (TMPDIR)";

/// Forgets what was refused before a simulation.
pub(crate) fn forget_refusal() {
    #[cfg(target_os = "linux")]
    if IS_CONFINED.load(Ordering::Relaxed) {
        // SAFETY: the number of the last error of this thread, which is there as long as the thread is.
        unsafe { *libc::__errno_location() = 0 };
    }
}

/// Notes that the process may write into its own folder only.
#[cfg(unix)]
pub(crate) fn set_confined() {
    IS_CONFINED.store(true, Ordering::Relaxed);
}

/// True if the process may write into its own folder only, and the last call of the system that has failed in
/// this thread was refused. A signal handler may ask.
pub(super) fn is_refused() -> bool {
    IS_CONFINED.load(Ordering::Relaxed)
        && std::io::Error::last_os_error().kind() == std::io::ErrorKind::PermissionDenied
}

/// [`REFUSED`], if something was.
pub(crate) fn refusal() -> Option<&'static str> {
    is_refused().then_some(REFUSED)
}
