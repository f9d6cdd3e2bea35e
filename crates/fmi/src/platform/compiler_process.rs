//! How a C compiler is called, and ended with all that it has started.

use std::process::{Child, Command};

/// Names of C compilers to try where `CC` is not set.
pub(crate) const C_COMPILERS: &[&str] = &["cc", "gcc", "clang"];

/// Options that make a C compiler write a shared library. Floating-point arithmetic stays as the standard
/// says: contraction to fused operations would make results depend on the processor. Without assertions, as
/// tools compile the libraries that they deliver: one that does not hold ends the process (seen in the reset
/// function of Dymola's sources).
pub(crate) fn shared_library_options() -> &'static [&'static str] {
    if cfg!(windows) {
        &["-O2", "-DNDEBUG", "-shared", "-ffp-contract=off"]
    } else {
        &["-O2", "-DNDEBUG", "-fPIC", "-shared", "-ffp-contract=off"]
    }
}

/// Lets a command and what it starts be ended together.
pub(crate) fn in_own_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}

/// Ends a child made by such a command; what it has started as well, where systems have groups of processes.
pub(crate) fn kill_group(child: &mut Child) {
    #[cfg(unix)]
    if let Ok(id) = i32::try_from(child.id())
        && let Some(group) = rustix::process::Pid::from_raw(id)
    {
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    // One that has just ended cannot be killed.
    let _ = child.kill();
}

/// Libraries every model is linked with.
pub(crate) fn system_libraries() -> &'static [&'static str] {
    if cfg!(windows) { &[] } else { &["-lm"] }
}
