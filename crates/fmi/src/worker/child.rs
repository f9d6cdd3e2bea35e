//! The worker process itself: it takes its socket, limits itself, and answers until the other end is closed.

use super::folder::{enter, kill_processes_of, remove};
use super::frame::Frame;
use super::limits::WorkerLimits;
use super::notes::{Notes, keep_lines, take_lines};
use super::service::Service;
use super::settings::{ASKED, FOLDER, LEVEL, VERSION};
use crate::error::{Told, ToldKind};
use crate::sys::{Page, close_inherited, tell_calls};
use base::RunContext;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fs::{Mode, OFlags};
use rustix::process::{Resource, Rlimit, setrlimit};
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The next question is waited for without sleeping for so long, where the other side allows it.
const SPIN: Duration = Duration::from_micros(50);

/// Bytes that are read at once.
const BUFFER: usize = 16 << 10;

/// The stack of the thread that runs the FMU: compiled models put large arrays there.
const STACK_SIZE: usize = 64 << 20;

/// Serves until the other end is closed, if this process was started as a worker; then the process ends, and
/// this does not return. Belongs at the begin of `main`, before any other thread is started.
pub fn serve_if_asked(service: impl FnOnce() -> Box<dyn Service> + Send) {
    super::launcher::know_this_program();
    let Some(limits) = std::env::var(ASKED).ok() else { return };
    let service = std::thread::scope(|scope| {
        let serve = || serve(&limits, service());
        let thread = std::thread::Builder::new().stack_size(STACK_SIZE).spawn_scoped(scope, serve);
        thread.map(|thread| thread.join())
    });
    // The process ends before who watches the socket may be done with that.
    if let Some(folder) = std::env::var_os(FOLDER) {
        kill_processes_of(std::process::id(), Path::new(&folder));
        remove(Path::new(&folder));
    }
    match service {
        Ok(Ok(Ok(()))) => std::process::exit(0),
        Ok(Ok(Err(error))) => {
            // Who has started it reads that.
            let _ = writeln!(io::stderr(), "{error}");
        }
        Err(error) => _ = writeln!(io::stderr(), "no thread for the FMU: {error}"),
        // A panic has said so.
        Ok(Err(_)) => {}
    }
    std::process::exit(1);
}

fn serve(limits: &str, mut service: Box<dyn Service>) -> io::Result<()> {
    let limits = WorkerLimits::from_text(limits).ok_or_else(|| {
        io::Error::new(io::ErrorKind::InvalidInput, "limits that this version does not know")
    })?;
    let folder = std::env::var_os(FOLDER).map(PathBuf::from);
    folder.as_deref().map_or(Ok(()), enter)?;
    // 0: the socket; 1: the page; 2: a pipe for what is printed.
    close_inherited()?;
    let socket = UnixStream::from(rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3)?);
    let page = File::from(rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdout(), 3)?);
    let nothing: OwnedFd = rustix::fs::open("/dev/null", OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty())?;
    rustix::stdio::dup2_stdin(&nothing)?;
    rustix::stdio::dup2_stdout(rustix::stdio::stderr())?;
    let page = tell_calls(Page::of(&page)?).map_err(io::Error::other)?;
    let (watched, folder_to_remove) = (socket.try_clone()?, folder.clone());
    std::thread::Builder::new().spawn(move || end_with(&watched, folder_to_remove.as_deref()))?;
    keep_lines(
        std::env::var(LEVEL).ok().and_then(|level| level.parse().ok()).unwrap_or(log::LevelFilter::Warn),
    );
    limit_self(&limits)?;
    if limits.sandbox {
        confine(folder.as_deref())?;
    }

    let own = std::process::id();
    let (mut asked, mut answer, mut buffer) = (Frame::default(), Frame::default(), Vec::new());
    answer.set_head(&VERSION)?;
    let (mut questions, mut answers) = (BufReader::with_capacity(BUFFER, &socket), &socket);
    answer.write(0, &mut answers, &mut buffer)?;
    loop {
        page.wait_for_question(asked.number, SPIN);
        match asked.read(&mut questions, &mut buffer, &mut || Ok(())) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(()),
            outcome => outcome?,
        }
        answer.clear();
        let served = catch_unwind(AssertUnwindSafe(|| {
            service.answer(&asked, &RunContext::new().asking(&|| page.is_cancelled()), &mut answer)
        }));
        let told = match served {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(error.told()),
            Err(panic) => {
                let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
                let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
                let message = format!("panic in the worker process: {text}");
                Some(Told { message, kind: ToldKind::Model, time: None, status: None, log: Vec::new() })
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
        if std::process::id() != own {
            // The FMU has forked, and this is the copy.
            std::process::abort();
        }
        // What the model needs may be gone with the folder.
        answer.is_last |= folder.as_ref().is_some_and(|folder| !folder.is_dir());
        answer.write(asked.number, &mut answers, &mut buffer)?;
        page.note_answer(asked.number);
    }
}

/// Ends the process when the other end is closed, whatever the FMU does at that moment, and removes its
/// folder.
fn end_with(socket: &UnixStream, folder: Option<&Path>) {
    loop {
        let mut ends = [PollFd::new(socket, PollFlags::empty())];
        match poll(&mut ends, None) {
            Err(rustix::io::Errno::INTR) => {}
            Ok(_) if ends[0].revents().is_empty() => {}
            _ => break,
        }
    }
    if let Some(folder) = folder {
        kill_processes_of(std::process::id(), folder);
        remove(folder);
    }
    std::process::abort();
}

fn limit_self(limits: &WorkerLimits) -> io::Result<()> {
    let lower = |resource: Resource, most: u64| {
        let maximum = rustix::process::getrlimit(resource).maximum;
        let most = Some(maximum.map_or(most, |maximum| maximum.min(most)));
        setrlimit(resource, Rlimit { current: most, maximum: most })
    };
    lower(Resource::Core, 0)?;
    if let Some(memory) = limits.memory {
        lower(Resource::Data, memory)?;
    }
    Ok(())
}

/// Lets this thread, and all that it starts, write below this folder only, and make no TCP connections (from
/// Linux 6.7 on).
#[cfg(all(target_os = "linux", feature = "sandbox"))]
fn confine(folder: Option<&Path>) -> io::Result<()> {
    use landlock::{
        ABI, Access, AccessFs, AccessNet, CompatLevel, Compatible, PathBeneath, PathFd, Ruleset, RulesetAttr,
        RulesetCreatedAttr,
    };
    let write = AccessFs::from_write(ABI::V1);
    let confined = || -> Result<(), Box<dyn std::error::Error>> {
        let folder = folder.ok_or("the worker has no folder")?;
        Ruleset::default()
            .set_compatibility(CompatLevel::HardRequirement)
            .handle_access(write)?
            .set_compatibility(CompatLevel::BestEffort)
            .handle_access(AccessFs::from_write(ABI::V3))?
            .handle_access(AccessNet::from_all(ABI::V4))?
            .create()?
            .add_rule(PathBeneath::new(PathFd::new(folder)?, AccessFs::from_all(ABI::V3)))?
            .add_rule(PathBeneath::new(PathFd::new("/dev/null")?, AccessFs::from_file(ABI::V3)))?
            .restrict_self()?;
        Ok(())
    };
    confined()
        .map_err(|error| io::Error::other(format!("a sandbox needs Landlock (Linux 5.13 or newer): {error}")))
}

#[cfg(not(all(target_os = "linux", feature = "sandbox")))]
fn confine(_: Option<&Path>) -> io::Result<()> {
    let why = match cfg!(target_os = "linux") {
        true => "this build has no sandbox (feature `sandbox`)",
        false => "there is a sandbox on Linux only",
    };
    Err(io::Error::new(io::ErrorKind::Unsupported, why))
}
