//! Copies of this process, and what they inherit.

use rustix::process::Pid;
use std::ffi::{CStr, OsStr, OsString};
use std::io;
use std::os::unix::ffi::OsStrExt;

/// Copies this process: its child goes on from here with this thread alone. The child's number; `None` in the
/// child.
pub(crate) fn fork() -> io::Result<Option<Pid>> {
    // SAFETY: numbers only. The end of a child is kept for who waits for it, whatever this process has inherited.
    unsafe { libc::signal(libc::SIGCHLD, libc::SIG_DFL) };
    // SAFETY: the caller has no other thread that could hold a lock, so all of the child's memory is whole.
    match unsafe { libc::fork() } {
        -1 => Err(io::Error::last_os_error()),
        child => Ok(Pid::from_raw(child)),
    }
}

/// Writes another value of the same length over that of an environment variable, where it stands: who reads
/// the environment of this process from outside (`/proc/<pid>/environ`) finds it as well, other than after
/// `setenv`.
pub(crate) fn overwrite_variable(name: &CStr, value: &[u8]) -> io::Result<()> {
    // SAFETY: a C string; the answer is null or a C string.
    let place = unsafe { libc::getenv(name.as_ptr()) };
    // SAFETY: as above.
    if place.is_null() || unsafe { CStr::from_ptr(place) }.count_bytes() != value.len() {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("no {name:?} of {} bytes", value.len()),
        ));
    }
    // SAFETY: so many bytes are there, in memory of this process (System V ABI: strings of the initial
    // environment, or allocated by `setenv`); no other thread reads them, as in `fork`.
    unsafe { std::ptr::copy_nonoverlapping(value.as_ptr(), place.cast(), value.len()) };
    Ok(())
}

/// Gives this process these environment variables, besides those of `kept`, and no others. Only called where
/// this process has no other thread that is at work.
pub(crate) fn replace_environment(variables: &[(OsString, OsString)], kept: &[&CStr]) {
    use std::env::{remove_var, set_var, vars_os};
    let is_kept = |name: &OsStr| kept.iter().any(|kept| kept.to_bytes() == name.as_bytes());
    // What else the system lets a name be, `setenv` refuses.
    let is_name = |name: &OsStr| !name.is_empty() && !name.as_bytes().contains(&b'=');
    for (name, _) in vars_os().filter(|(name, _)| is_name(name) && !is_kept(name)) {
        // SAFETY: no other thread reads the environment, as the caller has promised.
        unsafe { remove_var(name) };
    }
    for (name, value) in variables.iter().filter(|(name, _)| is_name(name) && !is_kept(name)) {
        // SAFETY: as above.
        unsafe { set_var(name, value) };
    }
}

/// Closes all descriptors of this process but the three standard ones.
#[cfg(any(target_os = "linux", target_os = "android"))]
pub(crate) fn close_inherited() -> io::Result<()> {
    // SAFETY: the caller is a program that has just been started and has opened nothing yet, so no owner of a descriptor loses it; the
    // first argument is below the second, the flags are none.
    match unsafe { libc::syscall(libc::SYS_close_range, 3, libc::c_uint::MAX, 0) } {
        0 => Ok(()),
        _ => match io::Error::last_os_error() {
            // A kernel before 5.9: what was inherited stays open.
            error if error.raw_os_error() == Some(libc::ENOSYS) => Ok(()),
            error => Err(error),
        },
    }
}

/// Inherited file descriptors stay open where there is no such call.
#[cfg(all(unix, not(any(target_os = "linux", target_os = "android"))))]
pub(crate) fn close_inherited() -> io::Result<()> {
    Ok(())
}
