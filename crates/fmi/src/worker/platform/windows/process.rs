//! Starts a worker process in its own job object.

use super::super::order::{Order, Shared};
use super::channel::Connection;
use crate::sys::Page;
use crate::sys::windows::{Job, give_handle, give_socket};
use crate::worker::frame::Frame;
use crate::worker::handshake::Start;
use crate::worker::launcher::Launcher;
use std::io::{self, PipeWriter};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::os::windows::process::CommandExt;
use std::path::Path;
use std::process::{Child, Stdio};
use windows_sys::Win32::System::Threading::{CREATE_NEW_PROCESS_GROUP, CREATE_NO_WINDOW};

/// The processes that a worker has started, and the worker itself.
#[derive(Debug)]
pub(in crate::worker) struct Group(Job);

impl Group {
    pub(in crate::worker) fn end(&self) {
        self.0.end();
    }

    pub(in crate::worker) fn has_number(&self, child: &Child, id: u32) -> bool {
        child.id() == id
    }
}

/// Returns two connected sockets of this process.
fn pair() -> io::Result<(TcpStream, TcpStream)> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let ours = TcpStream::connect(listener.local_addr()?)?;
    loop {
        let (theirs, from) = listener.accept()?;
        // Another process may have connected first.
        if from == ours.local_addr()? {
            // Each message is written at once.
            ours.set_nodelay(true)?;
            theirs.set_nodelay(true)?;
            return Ok((ours, theirs));
        }
    }
}

/// Starts a process and sends it the order. Until then, it waits and starts no process. Returns the process
/// with its group, its connection and the shared page.
pub(in crate::worker) fn begin(
    launcher: &Launcher,
    start: &Start,
    printed: PipeWriter,
    folder: &Path,
) -> io::Result<(Child, Group, Connection, Page)> {
    let (connection, theirs): (Connection, _) = pair()?;
    let (page, handle) = Page::new()?;
    let job = Job::new(start.limits.memory)?;
    let surroundings = &start.surroundings;
    let is_folder = |path: &&Path| path.is_dir();
    let working_folder = surroundings.folder.as_ref().map(Path::new).filter(is_folder).unwrap_or(folder);
    let mut child = launcher
        .command()
        .envs(surroundings.variables.iter().map(|(name, value)| (name, value)))
        .env("TEMP", folder)
        .env("TMP", folder)
        .current_dir(working_folder)
        .stdin(Stdio::piped())
        .stdout(printed.try_clone()?)
        .stderr(printed)
        // Ctrl-C in a terminal is sent to all processes of a group.
        .creation_flags(CREATE_NEW_PROCESS_GROUP | CREATE_NO_WINDOW)
        .spawn()?;
    let mut order = || {
        job.add(&child)?;
        let socket = give_socket(&theirs, &child)?;
        let shared = Shared::Handles { socket, page: give_handle(&handle, &child)? };
        let mut to = child.stdin.take().ok_or(io::ErrorKind::BrokenPipe)?;
        let order = Order { shared, folder: folder.to_owned(), start };
        Frame::of(&order)?.write(0, &mut to, &mut Vec::new())
    };
    match order() {
        Ok(()) => Ok((child, Group(job), connection, page)),
        Err(error) => {
            let _ = child.kill();
            let _ = child.wait();
            Err(error)
        }
    }
}
