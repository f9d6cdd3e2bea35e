//! Starts a worker process under Wine.

use super::super::order::{Order, Shared};
use super::super::unix::{in_words, memory_of_process};
use super::connection::Connection;
use crate::sys::Page;
use crate::worker::exceptions;
use crate::worker::frame::Frame;
use crate::worker::handshake::Start;
use crate::worker::launcher::Launcher;
use crate::worker::surroundings::Surroundings;
use std::io::{self, PipeWriter};
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};

/// The file with the shared page, which the worker opens by its name below `/proc`.
#[derive(Debug)]
pub(in crate::worker) struct Group {
    _page: std::fs::File,
}

impl Group {
    /// Does nothing: the processes that a worker has started end with it.
    pub(in crate::worker) fn end(&self) {}

    /// True: the worker has sent the key. Its number is one of Wine.
    pub(in crate::worker) fn has_number(&self, _: &Child, _: u32) -> bool {
        true
    }
}

/// Starts a process and sends it the order. Returns the process with its group, its connection and the shared
/// page.
pub(in crate::worker) fn begin(
    launcher: &Launcher,
    start: &Start,
    printed: PipeWriter,
    folder: &Path,
) -> io::Result<(Child, Group, Connection, Page)> {
    let (connection, port, key) = Connection::new()?;
    let (page, file) = Page::new()?;
    let Start { limits, level, is_prepared, surroundings, avoided_calls, place } = start;
    let mut command = launcher.command();
    command.envs(surroundings.variables.iter().map(|(name, value)| (name, value)));
    let variable = |name: &str| {
        let found = surroundings.variables.iter().find(|(found, _)| found == name);
        found.map(|(_, value)| value).filter(|value| !value.is_empty())
    };
    // In other locales, Wine cannot open paths that are not ASCII.
    command.env("LC_ALL", "C.UTF-8");
    if variable("WINEDEBUG").is_none() {
        // Otherwise, Wine prints messages for its developers.
        command.env("WINEDEBUG", "-all");
    }
    let prefix = variable("WINEPREFIX").map(PathBuf::from);
    let prefix = prefix.or_else(|| variable("HOME").map(|home| Path::new(home).join(".wine")));
    if variable("WINEDLLOVERRIDES").is_none() && prefix.is_some_and(|prefix| !prefix.exists()) {
        // The first start of Wine offers to install a browser and .NET.
        command.env("WINEDLLOVERRIDES", "mscoree,mshtml=");
    }
    let is_folder = |path: &&Path| path.is_dir();
    let mut child = command
        .current_dir(surroundings.folder.as_ref().map(Path::new).filter(is_folder).unwrap_or(folder))
        .stdin(Stdio::piped())
        .stdout(printed.try_clone()?)
        .stderr(printed)
        // Ctrl-C in a terminal is sent to all processes of a group.
        .process_group(0)
        .spawn()?;
    let mut order = || {
        let page = PathBuf::from(format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd()));
        // The texts of this system cannot be read on Windows. The process has the surroundings already.
        let start = Start {
            limits: *limits,
            level: *level,
            is_prepared: *is_prepared,
            surroundings: Surroundings::default(),
            avoided_calls: avoided_calls.clone(),
            place: *place,
        };
        let order = Order { shared: Shared::Names { port, key, page }, folder: folder.to_owned(), start };
        let mut to = child.stdin.take().ok_or(io::ErrorKind::BrokenPipe)?;
        Frame::of(&order)?.write(0, &mut to, &mut Vec::new())
    };
    match order() {
        Ok(()) => Ok((child, Group { _page: file }, connection, page)),
        Err(error) => {
            let _ = child.kill();
            let _ = child.wait();
            Err(error)
        }
    }
}

/// Returns the memory of a process in bytes.
pub(in crate::worker) fn memory_of(child: &Child) -> Option<u64> {
    memory_of_process(child.id())
}

/// Describes how a process ended. Wine passes on the lowest eight bits of its exit code; the shared page has
/// the code of an exception.
pub(in crate::worker) fn ended_in_words(status: ExitStatus) -> String {
    match status.code() {
        Some(code) => exceptions::in_words(code.cast_unsigned()),
        None => in_words(status),
    }
}
