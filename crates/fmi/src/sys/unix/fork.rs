//! Copies of this process, and the descriptors and variables that they inherit.

use rustix::process::Pid;
use std::ffi::{CStr, OsStr, OsString};
use std::io;
use std::os::unix::ffi::OsStrExt;

/// Forks this process. The child continues here, with this thread only. Returns the process id of the child;
/// `None` in the child.
pub(crate) fn fork() -> io::Result<Option<Pid>> {
    // SAFETY: the arguments are numbers. The exit status of a child is kept for the waiting process,
    // regardless of the inherited setting.
    unsafe { libc::signal(libc::SIGCHLD, libc::SIG_DFL) };
    // SAFETY: the caller has no other thread that could hold a lock, so the memory of the child is
    // consistent.
    match unsafe { libc::fork() } {
        -1 => Err(io::Error::last_os_error()),
        child => Ok(Pid::from_raw(child)),
    }
}

/// Overwrites the value of an environment variable in place with another value of the same length. Unlike
/// after `setenv`, other processes that read the environment of this process (`/proc/<pid>/environ`) also
/// find the new value.
pub(crate) fn overwrite_variable(name: &CStr, value: &[u8]) -> io::Result<()> {
    // SAFETY: the argument is a C string; the result is null or a C string.
    let place = unsafe { libc::getenv(name.as_ptr()) };
    // SAFETY: as above.
    if place.is_null() || unsafe { CStr::from_ptr(place) }.count_bytes() != value.len() {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("expected the variable {name:?} with {} bytes", value.len()),
        ));
    }
    // SAFETY: the memory of this process contains this number of bytes (System V ABI: strings of the initial
    // environment, or allocated by `setenv`). No other thread reads them, as in `fork`.
    unsafe { std::ptr::copy_nonoverlapping(value.as_ptr(), place.cast(), value.len()) };
    Ok(())
}

/// Replaces the environment variables of this process by `variables`, except those in `kept`. The caller must
/// ensure that no other thread of this process is running.
pub(crate) fn replace_environment(variables: &[(OsString, OsString)], kept: &[&CStr]) {
    use std::env::{remove_var, set_var, vars_os};
    let is_kept = |name: &OsStr| kept.iter().any(|kept| kept.to_bytes() == name.as_bytes());
    // `setenv` rejects other names, although the system allows them.
    let is_name = |name: &OsStr| !name.is_empty() && !name.as_bytes().contains(&b'=');
    for (name, _) in vars_os().filter(|(name, _)| is_name(name) && !is_kept(name)) {
        // SAFETY: the caller guarantees that no other thread reads the environment.
        unsafe { remove_var(name) };
    }
    for (name, value) in variables.iter().filter(|(name, _)| is_name(name) && !is_kept(name)) {
        // SAFETY: as above.
        unsafe { set_var(name, value) };
    }
}

/// Closes all file descriptors of this process except the three standard ones.
#[cfg(any(target_os = "linux", target_os = "android"))]
pub(crate) fn close_inherited() -> io::Result<()> {
    // SAFETY: the caller is a program that has just been started. It has not opened anything yet, so no owner
    // of a descriptor loses it. The first argument is below the second, and no flags are set.
    match unsafe { libc::syscall(libc::SYS_close_range, 3, libc::c_uint::MAX, 0) } {
        0 => Ok(()),
        _ => match io::Error::last_os_error() {
            // A kernel before 5.9: inherited descriptors stay open.
            error if error.raw_os_error() == Some(libc::ENOSYS) => Ok(()),
            error => Err(error),
        },
    }
}

/// Leaves inherited file descriptors open on systems without such a call.
#[cfg(not(any(target_os = "linux", target_os = "android")))]
pub(crate) fn close_inherited() -> io::Result<()> {
    Ok(())
}
