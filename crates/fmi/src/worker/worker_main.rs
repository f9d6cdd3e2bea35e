//! The worker process itself. It limits itself, and answers requests until the other end of its channel is
//! closed.

use super::folder::remove;
use super::frame::{Frame, FrameSize};
use super::handshake::{Arrival, Assigned, Hello, LEVEL, VERSION, WORKER_VARIABLE};
use super::input_function::{Exchange, VALUE, set_caller};
use super::launcher::set_this_program;
use super::notes::{Notes, keep_lines, take_lines};
use super::platform::{Channel, await_order, confine_self, limit_self, wait_until_closed};
use super::service::Service;
use crate::error::{ReportedError, ReportedErrorKind};
use crate::sys::{Page, has_kept_instances, set_avoided_calls, set_confined, set_instance_suffix};
use base::RunContext;
use std::cell::Cell;
use std::io::{self, BufReader, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;

/// Time to spin for the next request, if the caller allows it.
const SPIN: Duration = Duration::from_micros(50);

/// Size of the read buffer in bytes.
const BUFFER: usize = 16 << 10;

/// Stack size of the thread that runs the FMU, because compiled models allocate large arrays on the stack.
const STACK_SIZE: usize = 64 << 20;

/// Serves requests until the other end is closed, if this process was started for that. The process then
/// ends, and this function does not return. Otherwise, it returns immediately. Call it at the beginning of
/// `main`, before any other thread is started.
pub fn serve_if_worker(service: impl FnOnce() -> Box<dyn Service + Send>) {
    set_this_program();
    let Some(version) = std::env::var_os(WORKER_VARIABLE) else { return };
    let served = match version == VERSION {
        true => serve(service()),
        false => Err(io::Error::other(format!("this program supports version {VERSION}, not {version:?}"))),
    };
    if let Err(error) = &served {
        // The parent process reads this message.
        let _ = writeln!(io::stderr(), "{error}");
    }
    std::process::exit(i32::from(served.is_err()));
}

fn serve(mut service: Box<dyn Service + Send>) -> io::Result<()> {
    let level = std::env::var(LEVEL).ok().and_then(|level| level.parse().ok());
    keep_lines(level.unwrap_or(log::LevelFilter::Warn));
    let mut load = |requested: &Frame| {
        let mut answer = Frame::default();
        respond(&mut *service, requested, &RunContext::new(), &mut answer)?;
        // After a failure, a worker tries again, and reports the error.
        Ok(!answer.is_error)
    };
    match await_order(&mut load)? {
        Some(worker) => run(service, &worker),
        None => Ok(()),
    }
}

/// Serves as a worker. The process then ends.
fn run(mut service: Box<dyn Service + Send>, worker: &Assigned<Channel>) -> ! {
    let folder = &worker.folder;
    let served = begin(&mut *service, worker).and_then(|()| {
        std::thread::scope(|scope| {
            let serve = || answer_requests(service, worker);
            let thread = std::thread::Builder::new().stack_size(STACK_SIZE).spawn_scoped(scope, serve);
            thread.map(|thread| thread.join())
        })
    });
    // Removed here also, because the process may end before the thread that watches the channel has
    // removed the folder.
    remove(folder);
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

/// Limits and confines this process, which has one thread. All threads started later are also confined, and
/// handlers of faults run only in confined threads.
fn begin(service: &mut dyn Service, worker: &Assigned<Channel>) -> io::Result<()> {
    let Assigned { start, channel, folder, .. } = worker;
    set_avoided_calls(start.avoided_calls.clone());
    set_instance_suffix(start.place);
    log::set_max_level(start.level);
    // No foreign code has run in this process, so the message cannot be forged.
    let arrival = Arrival { id: std::process::id() };
    Frame::of(&arrival)?.write(0, &mut &*channel, &mut Vec::new())?;
    limit_self(&start.limits)?;
    if start.limits.sandbox {
        // If this fails, the request also fails and reports the error.
        let _ = catch_unwind(AssertUnwindSafe(|| service.provide_files()));
        confine_self(folder)?;
        set_confined();
    }
    Ok(())
}

fn answer_requests(mut service: Box<dyn Service + Send>, worker: &Assigned<Channel>) -> io::Result<()> {
    let Assigned { start, channel, page, folder, has_loaded } = worker;
    let (watched, folder_to_remove) = (channel.try_clone()?, folder.clone());
    std::thread::Builder::new().spawn(move || end_with(&watched, &folder_to_remove))?;
    if start.is_prepared {
        // If this fails, the request also fails and reports the error.
        let _ = catch_unwind(AssertUnwindSafe(|| service.prepare()));
    }

    let process_id = std::process::id();
    let (mut requested, mut answer, mut buffer) = (Frame::default(), Frame::default(), Vec::new());
    let (mut questions, mut answers) = (BufReader::with_capacity(BUFFER, channel), channel);
    let number = Rc::new(Cell::new(0));
    set_caller(exchange(channel.try_clone()?, page, Rc::clone(&number)));
    Frame::of(&Hello { has_loaded: *has_loaded })?.write(0, &mut answers, &mut buffer)?;
    loop {
        page.wait_for_question(requested.number, SPIN);
        match requested.read(&mut questions, &mut buffer, FrameSize::ANY, &mut || Ok(())) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            outcome => outcome?,
        }
        number.set(requested.number);
        answer.clear();
        let is_cancelled = || page.is_cancelled();
        respond(&mut *service, &requested, &RunContext::new().polling(&is_cancelled), &mut answer)?;
        if std::process::id() != process_id {
            // The FMU has forked, and this process is the copy.
            std::process::abort();
        }
        // Files that the model needs may have been removed with the folder.
        answer.is_last |= !folder.is_dir() || has_kept_instances();
        answer.write(requested.number, &mut answers, &mut buffer)?;
        page.note_answer(requested.number);
    }
}

/// Returns a function that sends a frame to the caller during the answer to the current request, and reads
/// the reply.
fn exchange(channel: Channel, page: &'static Page, number: Rc<Cell<u32>>) -> Exchange {
    let mut buffer = Vec::new();
    Box::new(move |frame| {
        frame.write(number.get(), &mut &channel, &mut buffer)?;
        // The caller may be spinning for the answer.
        page.note_answer(number.get());
        frame.read(&mut &channel, &mut buffer, VALUE, &mut || Ok(()))
    })
}

/// Answers a request with the service, and adds the notes. A panic becomes an error.
fn respond(
    service: &mut dyn Service,
    requested: &Frame,
    context: &RunContext<'_>,
    answer: &mut Frame,
) -> io::Result<()> {
    let served = catch_unwind(AssertUnwindSafe(|| service.answer(requested, context, answer)));
    let reported = match served {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(error.reported()),
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
    if let Some(reported) = reported {
        answer.numbers.clear();
        answer.set_head(&reported)?;
        answer.is_error = true;
    }
    let notes = Notes { lines: take_lines(), quirks: service.new_quirks() };
    if !notes.is_empty() {
        ciborium::into_writer(&notes, &mut answer.notes).map_err(io::Error::other)?;
    }
    Ok(())
}

/// Ends the process when the other end is closed, even during a call of the FMU, and removes its folder.
fn end_with(channel: &Channel, folder: &Path) {
    wait_until_closed(channel);
    remove(folder);
    std::process::abort();
}
