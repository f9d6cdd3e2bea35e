//! A look at the reason of a fault of the FMU, before it ends the process.

use super::shared_page::{NO_MEMORY, REFUSED, note_failed};
use super::worker_state::is_refused;
use std::io;
use std::mem::MaybeUninit;
use std::sync::OnceLock;

/// Signals by which an FMU ends that uses memory it was not given: null pointers, and exceptions that nobody
/// catches.
const SIGNALS: [libc::c_int; 3] = [libc::SIGSEGV, libc::SIGBUS, libc::SIGABRT];

/// What was done at these signals before.
static BEFORE: OnceLock<[libc::sigaction; SIGNALS.len()]> = OnceLock::new();

/// Has faults of this process tell whether an allocation had failed, or the sandbox had refused something.
pub(crate) fn tell_faults() -> io::Result<()> {
    let mut before = [MaybeUninit::<libc::sigaction>::zeroed(); SIGNALS.len()];
    for (signal, before) in SIGNALS.iter().zip(&mut before) {
        // SAFETY: a signal that exists, and room for the answer.
        if unsafe { libc::sigaction(*signal, std::ptr::null(), before.as_mut_ptr()) } != 0 {
            return Err(io::Error::last_os_error());
        }
    }
    // SAFETY: written above; all zeros are a valid action, too.
    if BEFORE.set(before.map(|action| unsafe { action.assume_init() })).is_err() {
        return Ok(());
    }
    for signal in SIGNALS {
        // SAFETY: all zeros are a valid action: the default, with no flags and an empty mask.
        let mut action = unsafe { MaybeUninit::<libc::sigaction>::zeroed().assume_init() };
        action.sa_sigaction = look as extern "C" fn(libc::c_int) as libc::sighandler_t;
        // A stack may be used up.
        action.sa_flags = libc::SA_ONSTACK;
        // SAFETY: the action calls a function of this type, which calls only what a signal handler may.
        if unsafe { libc::sigaction(signal, &action, std::ptr::null_mut()) } != 0 {
            return Err(io::Error::last_os_error());
        }
    }
    Ok(())
}

/// Notes whether the last call of the system has failed for want of memory, or was refused; then what was
/// done before at this signal is done: who has met the fault meets it again.
extern "C" fn look(signal: libc::c_int) {
    if io::Error::last_os_error().raw_os_error() == Some(libc::ENOMEM) {
        note_failed(NO_MEMORY);
    } else if is_refused() {
        note_failed(REFUSED);
    }
    let place = SIGNALS.iter().position(|known| *known == signal);
    if let Some((before, place)) = BEFORE.get().zip(place) {
        // SAFETY: an action that this process had; `sigaction` may be called in a signal handler (POSIX).
        unsafe { libc::sigaction(signal, &before[place], std::ptr::null_mut()) };
    }
}
