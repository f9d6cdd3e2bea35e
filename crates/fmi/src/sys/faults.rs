//! A look at the reason of a fault of the FMU, before it ends the process.

use super::shared_page::{NO_MEMORY, REFUSED, note_failed};
use super::worker_state::is_refused;
use std::io;
use std::mem::MaybeUninit;

/// Signals by which an FMU ends that uses memory it was not given: null pointers, and exceptions that nobody
/// catches.
const SIGNALS: [libc::c_int; 3] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGABRT];

/// Has faults of this process tell whether an allocation had failed, or the sandbox had refused something.
pub(crate) fn tell_faults() -> io::Result<()> {
    for signal in SIGNALS {
        // SAFETY: all zeros are a valid action: the default, with no flags and an empty mask.
        let mut action = unsafe { MaybeUninit::<libc::sigaction>::zeroed().assume_init() };
        action.sa_sigaction = look as extern "C" fn(libc::c_int) as libc::sighandler_t;
        // A stack may be used up; and the next one ends the process.
        action.sa_flags = libc::SA_ONSTACK | libc::SA_RESETHAND;
        // SAFETY: the action calls a function of this type, which calls only what a signal handler may.
        if unsafe { libc::sigaction(signal, &action, std::ptr::null_mut()) } != 0 {
            return Err(io::Error::last_os_error());
        }
    }
    Ok(())
}

/// Notes whether the last call of the system has failed for want of memory, or was refused; then the process
/// ends by this signal, also where it was sent and would not come again.
extern "C" fn look(signal: libc::c_int) {
    if io::Error::last_os_error().raw_os_error() == Some(libc::ENOMEM) {
        note_failed(NO_MEMORY);
    } else if is_refused() {
        note_failed(REFUSED);
    }
    // SAFETY: may be called in a signal handler (POSIX). The signal is blocked here: it acts when this returns, in the
    // default way.
    unsafe { libc::raise(signal) };
}
