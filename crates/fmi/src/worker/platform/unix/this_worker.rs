//! A worker process sets up itself: output, folder, environment, limits.

use super::orders::{DESCRIPTORS, FOLDER, TEMPORARY};
use crate::sys::Page;
use crate::sys::unix::{overwrite_variable, replace_environment, tell_faults};
use crate::worker::folder::make;
use crate::worker::handshake::{Assigned, Start};
use crate::worker::limits::WorkerLimits;
use crate::worker::surroundings::Surroundings;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::fs::File;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};

/// Turns this process, a fork of the template with one thread, into a worker.
pub(super) fn become_worker(
    start: Start,
    descriptors: Vec<OwnedFd>,
    folder: PathBuf,
    has_loaded: bool,
) -> io::Result<Assigned<UnixStream>> {
    let Ok([socket, page, output]) = <[OwnedFd; DESCRIPTORS]>::try_from(descriptors) else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    // Ctrl-C in a terminal, and the signal that ends a worker, are sent to all processes of a group.
    rustix::process::setpgid(None, None)?;
    rustix::stdio::dup2_stdout(&output)?;
    rustix::stdio::dup2_stderr(output)?;
    make(&folder)?;
    enter(&start.surroundings, &folder)?;
    let page = Page::of(&File::from(page))?.tell_calls().map_err(io::Error::other)?;
    Ok(Assigned { start, channel: socket.into(), page, folder, has_loaded })
}

/// Applies the surroundings to this process, a worker whose folder is `worker_folder`. Temporary files go to
/// `worker_folder`. `worker_folder` becomes the working folder if the original one cannot be entered. No
/// other thread may be running.
fn enter(surroundings: &Surroundings, worker_folder: &Path) -> io::Result<()> {
    if surroundings.folder.as_ref().is_none_or(|folder| std::env::set_current_dir(folder).is_err()) {
        std::env::set_current_dir(worker_folder)?;
    }
    // Overwritten in place, because child processes of the worker are identified by this folder in
    // `/proc/<pid>/environ`.
    for name in [FOLDER, TEMPORARY] {
        overwrite_variable(name, worker_folder.as_os_str().as_bytes())?;
    }
    replace_environment(&surroundings.variables, &[FOLDER, TEMPORARY]);
    Ok(())
}

/// Limits the memory of this process and disables core files. A fault of the FMU records its cause.
pub(in crate::worker) fn limit_self(limits: &WorkerLimits) -> io::Result<()> {
    tell_faults()?;
    let lower = |resource: Resource, most: u64| {
        let maximum = getrlimit(resource).maximum;
        let most = Some(maximum.map_or(most, |maximum| maximum.min(most)));
        setrlimit(resource, Rlimit { current: most, maximum: most })
    };
    lower(Resource::Core, 0)?;
    if let Some(memory) = limits.memory {
        lower(Resource::Data, memory)?;
    }
    Ok(())
}

/// Waits until the other end is closed.
pub(in crate::worker) fn wait_until_closed(channel: &UnixStream) {
    loop {
        let mut ends = [PollFd::new(channel, PollFlags::empty())];
        match poll(&mut ends, None) {
            Err(rustix::io::Errno::INTR) => {}
            Ok(_) if ends[0].revents().is_empty() => {}
            _ => break,
        }
    }
}
