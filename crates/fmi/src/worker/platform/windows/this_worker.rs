//! A worker process receives its order and sets up itself.

use super::super::order::{Order, Shared};
use super::channel::Channel;
use crate::sys::Page;
use crate::sys::windows::{Job, end_on_errors, forget_variable, set_variable, take_handle, take_socket};
use crate::worker::frame::{Frame, FrameSize};
use crate::worker::handshake::{Assigned, LEVEL, Start, WORKER_VARIABLE};
use crate::worker::limits::WorkerLimits;
use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::net::Ipv4Addr;
use std::time::Duration;

/// Time between two checks of a channel with unread bytes.
const LOOK: Duration = Duration::from_millis(10);

/// Reads the order. The working folder, the environment and the output were set when the process was started.
pub(in crate::worker) fn await_order(
    _: &mut dyn FnMut(&Frame) -> io::Result<bool>,
) -> io::Result<Option<Assigned<Channel>>> {
    let mut received = Frame::default();
    let stdin = io::stdin();
    match received.read(&mut stdin.lock(), &mut Vec::new(), FrameSize::ANY, &mut || Ok(())) {
        // The worker is not needed any more.
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        outcome => outcome?,
    }
    let Order { shared, folder, start }: Order<Start> = received.head()?;
    // A program that the FMU starts must not serve.
    forget_variable(WORKER_VARIABLE);
    forget_variable(LEVEL);
    let (page, channel) = match shared {
        Shared::Handles { socket, page } => (Page::of(&take_handle(page))?, take_socket(&socket)?),
        Shared::Names { port, key, page } => {
            // A process under Wine has the variables of its caller, except these.
            set_variable("TEMP", &folder);
            set_variable("TMP", &folder);
            end_children_with_this_process()?;
            let mut channel = Channel::connect((Ipv4Addr::LOCALHOST, port))?;
            channel.set_nodelay(true)?;
            channel.write_all(&key)?;
            (Page::of_file(&File::options().read(true).write(true).open(page)?)?, channel)
        }
    };
    let page = page.tell_calls().map_err(io::Error::other)?;
    Ok(Some(Assigned { start, channel, page, folder, has_loaded: false }))
}

/// Makes the processes that this process starts end with it. The caller cannot end them under Wine.
fn end_children_with_this_process() -> io::Result<()> {
    let job = Job::new(None)?;
    job.add_this_process()?;
    // The system closes the group at the end of this process.
    std::mem::forget(job);
    Ok(())
}

/// Makes faults of the FMU end this process. The memory is limited by the group of the process.
pub(in crate::worker) fn limit_self(_: &WorkerLimits) -> io::Result<()> {
    end_on_errors();
    Ok(())
}

/// Waits until the other end is closed.
pub(in crate::worker) fn wait_until_closed(channel: &Channel) {
    loop {
        match channel.peek(&mut [0]) {
            Ok(0) => break,
            Ok(_) => std::thread::sleep(LOOK),
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => {}
            Err(_) => break,
        }
    }
}
