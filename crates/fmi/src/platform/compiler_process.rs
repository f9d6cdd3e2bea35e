//! Options for a C compiler, and functions to end it with all the processes that it has started.

use std::process::{Child, Command};

/// Names of C compilers to try if `CC` is not set.
pub(crate) const C_COMPILERS: &[&str] = &["cc", "gcc", "clang"];

/// Returns options for compiling a shared library. Floating-point arithmetic follows the standard:
/// contraction to fused operations would make results depend on the processor. Assertions are disabled, as in
/// libraries that tools deliver. A failed assertion would end the process (seen in the reset function of
/// Dymola's sources).
pub(crate) fn shared_library_options() -> &'static [&'static str] {
    if cfg!(windows) {
        &["-O2", "-DNDEBUG", "-shared", "-ffp-contract=off"]
    } else {
        &["-O2", "-DNDEBUG", "-fPIC", "-shared", "-ffp-contract=off"]
    }
}

/// Puts a command and its child processes into a separate group, so that they can be ended together.
pub(crate) fn in_process_group(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(not(unix))]
    let _ = command;
}

/// Kills a child started by such a command. On systems with process groups, its child processes are also
/// killed.
pub(crate) fn kill_group(child: &mut Child) {
    #[cfg(unix)]
    if let Ok(id) = i32::try_from(child.id())
        && let Some(group) = rustix::process::Pid::from_raw(id)
    {
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    // An error is ignored, because the child may have just ended.
    let _ = child.kill();
}

/// Returns the libraries that every model is linked with.
pub(crate) fn system_libraries() -> &'static [&'static str] {
    if cfg!(windows) { &[] } else { &["-lm"] }
}
