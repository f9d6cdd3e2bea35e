//! Functions to end a C compiler with all the processes that it has started.

use std::process::{Child, Command};

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
