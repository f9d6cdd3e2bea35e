//! The worker process itself. It limits itself, and answers requests until the other end of its socket is
//! closed.

use super::folder::{make, remove};
use super::fork_server::{Arrival, DESCRIPTORS, Hello, Start};
use super::frame::{Frame, FrameSize};
use super::input_function::{Exchange, VALUE, set_caller};
use super::limits::limit_self;
use super::notes::{Notes, take_lines};
use super::sandbox::confine;
use super::service::Service;
use crate::error::{ReportedError, ReportedErrorKind};
use crate::sys::{
    Page, has_kept_instances, set_avoided_calls, set_confined, set_instance_suffix, tell_calls, tell_faults,
};
use base::RunContext;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags};
use std::cell::Cell;
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

/// Time to spin for the next request, if the caller allows it.
const SPIN: Duration = Duration::from_micros(50);

/// Size of the read buffer in bytes.
const BUFFER: usize = 16 << 10;

/// Stack size of the thread that runs the FMU, because compiled models allocate large arrays on the stack.
const STACK_SIZE: usize = 64 << 20;

/// A worker to be served in a fork of its template.
pub(super) struct Worker {
    pub(super) folder: PathBuf,
    pub(super) start: Start,
    pub(super) descriptors: Vec<OwnedFd>,
    /// True if the template has loaded the problem.
    pub(super) has_loaded: bool,
}

/// Serves as a worker, in a fork of the template. The process then ends.
pub(super) fn run(mut service: Box<dyn Service + Send>, worker: Worker) -> ! {
    let folder = worker.folder.clone();
    let served = begin(&mut *service, worker).and_then(|connection| {
        std::thread::scope(|scope| {
            let serve = || serve(service, &connection);
            let thread = std::thread::Builder::new().stack_size(STACK_SIZE).spawn_scoped(scope, serve);
            thread.map(|thread| thread.join())
        })
    });
    // Removed here also, because the process may end before the thread that watches the socket has removed
    // the folder.
    remove(&folder);
    let error = match served {
        Ok(Ok(Ok(()))) => std::process::exit(0),
        Ok(Ok(Err(error))) | Err(error) => error.to_string(),
        // The panic has already printed its message.
        Ok(Err(_)) => String::new(),
    };
    // The parent process reads this message.
    let _ = writeln!(io::stderr(), "{error}");
    std::process::exit(1);
}

/// A worker that is ready for requests.
struct Connection {
    socket: UnixStream,
    page: &'static Page,
    folder: PathBuf,
    start: Start,
    has_loaded: bool,
}

/// Limits and confines this process, which has one thread. All threads started later are also confined, and
/// signal handlers run only in confined threads.
fn begin(service: &mut dyn Service, worker: Worker) -> io::Result<Connection> {
    let Worker { folder, start, descriptors, has_loaded } = worker;
    let Ok([socket, page, output]) = <[OwnedFd; DESCRIPTORS]>::try_from(descriptors) else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    // Ctrl-C in a terminal, and the signal that ends a worker, are sent to all processes of a group.
    rustix::process::setpgid(None, None)?;
    rustix::stdio::dup2_stdout(&output)?;
    rustix::stdio::dup2_stderr(output)?;
    make(&folder)?;
    start.surroundings.enter(&folder)?;
    set_avoided_calls(start.avoided_calls.clone());
    set_instance_suffix(start.place);
    log::set_max_level(start.level);
    let (socket, page) = (UnixStream::from(socket), File::from(page));
    // No foreign code has run in this process, so the message cannot be forged.
    let arrival = Arrival { pid: std::process::id().cast_signed() };
    Frame::of(&arrival)?.write(0, &mut &socket, &mut Vec::new())?;
    let page = tell_calls(Page::of(&page)?).map_err(io::Error::other)?;
    tell_faults()?;
    limit_self(&start.limits)?;
    if start.limits.sandbox {
        // If this fails, the request also fails and reports the error.
        let _ = catch_unwind(AssertUnwindSafe(|| service.provide_files()));
        confine(&folder)?;
        set_confined();
    }
    Ok(Connection { socket, page, folder, start, has_loaded })
}

fn serve(mut service: Box<dyn Service + Send>, connection: &Connection) -> io::Result<()> {
    let Connection { socket, page, folder, start, has_loaded } = connection;
    let (watched, folder_to_remove) = (socket.try_clone()?, folder.clone());
    std::thread::Builder::new().spawn(move || end_with(&watched, &folder_to_remove))?;
    if start.is_prepared {
        // If this fails, the request also fails and reports the error.
        let _ = catch_unwind(AssertUnwindSafe(|| service.prepare()));
    }

    let own = std::process::id();
    let (mut asked, mut answer, mut buffer) = (Frame::default(), Frame::default(), Vec::new());
    let (mut questions, mut answers) = (BufReader::with_capacity(BUFFER, socket), socket);
    let number = Rc::new(Cell::new(0));
    set_caller(exchange(socket.try_clone()?, page, Rc::clone(&number)));
    Frame::of(&Hello { has_loaded: *has_loaded })?.write(0, &mut answers, &mut buffer)?;
    loop {
        page.wait_for_question(asked.number, SPIN);
        match asked.read(&mut questions, &mut buffer, FrameSize::ANY, &mut || Ok(())) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            outcome => outcome?,
        }
        number.set(asked.number);
        answer.clear();
        let is_cancelled = || page.is_cancelled();
        respond(&mut *service, &asked, &RunContext::new().asking(&is_cancelled), &mut answer)?;
        if std::process::id() != own {
            // The FMU has forked, and this process is the copy.
            std::process::abort();
        }
        // Files that the model needs may have been removed with the folder.
        answer.is_last |= !folder.is_dir() || has_kept_instances();
        answer.write(asked.number, &mut answers, &mut buffer)?;
        page.note_answer(asked.number);
    }
}

/// Returns a function that sends a frame to the caller during the answer to the current request, and reads
/// the reply.
fn exchange(socket: UnixStream, page: &'static Page, number: Rc<Cell<u32>>) -> Exchange {
    let mut buffer = Vec::new();
    Box::new(move |frame| {
        frame.write(number.get(), &mut &socket, &mut buffer)?;
        // The caller may be spinning for the answer.
        page.note_answer(number.get());
        frame.read(&mut &socket, &mut buffer, VALUE, &mut || Ok(()))
    })
}

/// Answers a request with the service, and adds the notes. A panic becomes an error.
pub(super) fn respond(
    service: &mut dyn Service,
    asked: &Frame,
    context: &RunContext<'_>,
    answer: &mut Frame,
) -> io::Result<()> {
    let served = catch_unwind(AssertUnwindSafe(|| service.answer(asked, context, answer)));
    let told = match served {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.told()),
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
            let message = format!("panic in the worker process: {text}");
            Some(ReportedError {
                message,
                kind: ReportedErrorKind::Model,
                time: None,
                status: None,
                log: Vec::new(),
            })
        }
    };
    if let Some(told) = told {
        answer.numbers.clear();
        answer.set_head(&told)?;
        answer.is_error = true;
    }
    let notes = Notes { lines: take_lines(), quirks: service.new_quirks() };
    if !notes.is_empty() {
        ciborium::into_writer(&notes, &mut answer.notes).map_err(io::Error::other)?;
    }
    Ok(())
}

/// Ends the process when the other end is closed, even during a call of the FMU, and removes its folder.
fn end_with(socket: &UnixStream, folder: &Path) {
    loop {
        let mut ends = [PollFd::new(socket, PollFlags::empty())];
        match poll(&mut ends, None) {
            Err(rustix::io::Errno::INTR) => {}
            Ok(_) if ends[0].revents().is_empty() => {}
            _ => break,
        }
    }
    remove(folder);
    std::process::abort();
}

/// Replaces the standard input by `/dev/null`.
pub(super) fn close_stdin() -> io::Result<()> {
    let nothing: OwnedFd = rustix::fs::open("/dev/null", OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty())?;
    rustix::stdio::dup2_stdin(&nothing)?;
    Ok(())
}
