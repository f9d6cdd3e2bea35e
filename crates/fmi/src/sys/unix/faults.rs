//! Records the cause of a fault of the FMU before the fault ends the process.

use crate::sys::shared_page::{NO_MEMORY, REFUSED, note_failed};
use crate::sys::worker_state::is_refused;
use std::io;
use std::mem::MaybeUninit;

/// Signals that end the process if an FMU accesses invalid memory (for example, null pointers) or throws an
/// uncaught exception.
const SIGNALS: [libc::c_int; 3] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGABRT];

/// Installs signal handlers that record whether an allocation failed before a fault, and whether the sandbox
/// denied an operation.
pub(crate) fn tell_faults() -> io::Result<()> {
    for signal in SIGNALS {
        // SAFETY: all zeros are a valid action: the default action, no flags and an empty mask.
        let mut action = unsafe { MaybeUninit::<libc::sigaction>::zeroed().assume_init() };
        action.sa_sigaction = look as extern "C" fn(libc::c_int) as libc::sighandler_t;
        // The handler needs a separate stack, because the stack may be exhausted. The next signal ends the
        // process.
        action.sa_flags = libc::SA_ONSTACK | libc::SA_RESETHAND;
        // SAFETY: the handler has this type and calls only async-signal-safe functions.
        if unsafe { libc::sigaction(signal, &action, std::ptr::null_mut()) } != 0 {
            return Err(io::Error::last_os_error());
        }
    }
    Ok(())
}

/// Records whether the last failed system call ran out of memory or was denied. The process then ends by this
/// signal, even if the signal was sent once and would not recur.
extern "C" fn look(signal: libc::c_int) {
    if io::Error::last_os_error().raw_os_error() == Some(libc::ENOMEM) {
        note_failed(NO_MEMORY);
    } else if is_refused() {
        note_failed(REFUSED);
    }
    // SAFETY: `raise` is async-signal-safe (POSIX). The signal is blocked here. It takes effect with the
    // default action when this function returns.
    unsafe { libc::raise(signal) };
}
