//! A set of worker processes, with one worker for each calling thread. Workers are started when needed, and
//! replaced when they end or grow.

use super::ahead;
use super::frame::{Frame, FrameSize};
use super::handshake::{Start, no_worker};
use super::isolation::{Question, Repeat, RequestedProcess};
use super::launcher::Launcher;
use super::limits::{AnswerLimits, WorkerLimits};
use super::load::{Load, LoadId};
use super::platform::{HAS_WORKERS, Starter};
use super::surroundings::Surroundings;
use super::windows_program::WindowsProgram;
use super::worker_process::{NoAnswer, Places, Process};
use crate::description::{Quirk, QuirkKind};
use crate::error::{EndKind, FmiError, ReportedError, ReportedErrorKind};
use base::RunContext;
use std::cell::Cell;
use std::collections::HashSet;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time after which an idle worker is ended.
const IDLE: Duration = Duration::from_secs(5);

/// Maximum start time of a worker.
const START: Duration = Duration::from_secs(60);

/// Maximum start time of a confined worker, which first compiles the sources of its model.
const START_CONFINED: Duration = Duration::from_secs(600);

/// Maximum time to wait for a worker started in advance.
const PREPARED: Duration = Duration::from_secs(10);

/// Maximum number of requests that a worker may ask to repeat. It needs two trials to determine whether a
/// co-simulation should receive its stop time. See [`Fmu::take_repetition`](crate::Fmu::take_repetition).
const MOST_REPEATED: u32 = 2;

/// The memory of a worker is checked after this number of calls, and after every call longer than
/// `LONG_CALL`.
const LOOK_EVERY: u64 = 32;
const LONG_CALL: Duration = Duration::from_millis(20);

/// A set of worker processes of one program, with limits. Each worker serves one thread at a time.
#[derive(Debug)]
pub struct Workers {
    launcher: Launcher,
    limits: WorkerLimits,
    idle: Mutex<Idle>,
    /// Warnings that workers have logged.
    reported: Mutex<HashSet<String>>,
    places: Places,
}

#[derive(Debug, Default)]
struct Idle {
    /// Idle processes, each with the time since which it has been idle. The most recently used process is
    /// last.
    processes: Vec<(Process, Instant)>,
    /// Process that is being started.
    begun: Option<Process>,
    /// Starter of the processes, with the load that it has received.
    starter: Option<(Arc<Starter>, LoadId)>,
    /// True if a thread watches for processes that are idle for too long.
    is_watched: bool,
    /// Process id of the owner. A forked child does not own any workers.
    owner: u32,
    /// Working folder and environment variables of the caller.
    surroundings: Surroundings,
    /// Number of times that the surroundings have changed.
    n_changes: u64,
    /// Number of calls, and longer uses, in progress.
    n_held: usize,
    /// Calls at the end of a run that have ended a worker. New workers omit them.
    avoided_calls: Vec<String>,
    /// Quirks that this process has found and not reported yet.
    quirks: Vec<Quirk>,
}

impl Idle {
    /// Returns the loads of idle processes that may serve this load.
    fn lent_to(&self, load: &Load) -> impl Iterator<Item = LoadId> {
        let loaded = self.processes.iter().filter_map(|(process, _)| process.loaded);
        loaded.filter(|loaded| loaded.owner == load.id.owner)
    }

    /// Removes and returns the processes that have been idle for too long, except one process of each kept
    /// load.
    fn take_old(&mut self) -> Vec<Process> {
        let mut kept = Vec::new();
        let mut is_old = |(process, since): &(Process, Instant)| {
            let is_kept = process.loaded.is_some_and(|loaded| {
                let is_first = loaded.is_kept && !kept.contains(&loaded.number);
                kept.push(loaded.number);
                is_first
            });
            !is_kept && since.elapsed() > IDLE
        };
        let is_old: Vec<bool> = self.processes.iter().rev().map(&mut is_old).collect();
        let mut is_old = is_old.into_iter().rev();
        self.processes.extract_if(.., |_| is_old.next() == Some(true)).map(|(process, _)| process).collect()
    }

    /// Removes and returns the processes that must no longer be used. They end when they are dropped.
    fn take_processes(&mut self) -> (Vec<(Process, Instant)>, Option<Process>) {
        (std::mem::take(&mut self.processes), self.begun.take())
    }
}

/// While this value exists, workers have the working folder and the environment variables that the caller had
/// when it was created.
#[derive(Debug)]
pub struct Held(Arc<Workers>);

impl Drop for Held {
    fn drop(&mut self) {
        let mut idle = self.0.idle();
        idle.n_held = idle.n_held.saturating_sub(1);
    }
}

/// A worker process of a single user. It ends when this value is dropped.
#[derive(Debug)]
pub struct PinnedProcess {
    process: Process,
    /// Keeps the set alive, because dropping the set ends all its processes.
    workers: Arc<Workers>,
}

impl PinnedProcess {
    /// Sends a request, reads the answer with `accept`, and returns the result with the quirks found in
    /// the model. No request is repeated after a failure.
    ///
    /// # Errors
    /// Returns [`FmiError::ReportedError`] if the worker reports an error, and [`FmiError::WorkerEnded`] if
    /// the worker has ended. Returns [`FmiError::Cancelled`] after cancellation.
    pub fn call<T>(
        &mut self,
        question: &Question<'_>,
        answer: &mut Frame,
        accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
    ) -> Result<(T, Vec<Quirk>), FmiError> {
        let accepted = ask(&mut self.process, question, answer, accept, &self.workers.reported)?;
        Ok((accepted, std::mem::take(&mut self.process.quirks)))
    }

    /// Returns the limits.
    pub fn limits(&self) -> &WorkerLimits {
        self.workers.limits()
    }

    /// True if this process started the worker. False in a child forked from the starting process.
    pub fn is_child(&self) -> bool {
        self.process.is_child()
    }

    /// True if the worker has ended.
    pub fn has_ended(&self) -> bool {
        self.process.has_ended()
    }
}

impl Launcher {
    /// True if this program can start worker processes.
    pub fn is_set() -> bool {
        HAS_WORKERS && Self::current().is_some()
    }
}

impl Workers {
    /// Creates a set without starting any process. Returns `None` if this program cannot start workers (see
    /// [`Launcher`]).
    pub fn new(limits: WorkerLimits) -> Option<Arc<Self>> {
        Launcher::current().filter(|_| HAS_WORKERS).map(|launcher| Self::of(launcher, limits))
    }

    /// Creates a set whose workers run a program for Windows, without starting any process.
    ///
    /// # Errors
    /// Returns [`FmiError::NoWindowsProgram`] if the program or Wine is missing, and
    /// [`FmiError::NoSandbox`] if the limits request a sandbox.
    pub fn of_program(program: WindowsProgram, limits: WorkerLimits) -> Result<Arc<Self>, FmiError> {
        if limits.sandbox {
            let reason = "models of Windows cannot be confined".to_owned();
            return Err(FmiError::NoSandbox { reason });
        }
        Ok(Self::of(program.launcher()?, limits))
    }

    fn of(launcher: Launcher, limits: WorkerLimits) -> Arc<Self> {
        let (idle, reported) = (Mutex::default(), Mutex::default());
        Arc::new(Self { launcher, limits, idle, reported, places: Places::default() })
    }

    /// Returns the limits.
    pub fn limits(&self) -> &WorkerLimits {
        &self.limits
    }

    /// Begins a sequence of calls. During the sequence, workers have the current working folder and
    /// environment variables of this process. If another sequence is in progress, they keep those from its
    /// start. A single call is also such a sequence.
    pub fn hold(self: &Arc<Self>) -> Held {
        let mut idle = self.idle();
        idle.n_held += 1;
        let mut outdated = None;
        if idle.n_held == 1 {
            let present = Surroundings::present();
            if idle.surroundings != present {
                idle.surroundings = present;
                idle.n_changes += 1;
                // All processes are idle, because no call is in progress.
                outdated = Some(idle.take_processes());
            }
        }
        drop(idle);
        drop(outdated);
        Held(Arc::clone(self))
    }
    /// Returns the number of times that the caller's working folder or environment variables have changed
    /// between calls. Answers before and after a change must not be compared.
    pub fn n_changes(&self) -> u64 {
        self.idle().n_changes
    }

    /// Starts the starter with this load and a first worker in the background, because this takes longer than
    /// a short evaluation.
    pub fn prepare(self: &Arc<Self>, load: &Load) {
        self.prepare_one_of(1, load, false);
    }

    /// Starts a second worker in the background and loads its model, because the worker will be needed soon.
    pub fn prepare_second(self: &Arc<Self>, load: &Load) {
        self.prepare_one_of(2, load, true);
    }

    fn prepare_one_of(self: &Arc<Self>, n: usize, load: &Load, is_prepared: bool) {
        let _held = self.hold();
        let are_there = |idle: &Idle| idle.begun.is_some() || idle.lent_to(load).count() >= n;
        if !are_there(&self.idle()) {
            // An error is ignored here, because the next call that needs a worker returns it.
            let begun = self.begin(load, is_prepared).ok();
            self.idle().begun = begun;
        }
    }

    fn begin(&self, load: &Load, is_prepared: bool) -> Result<Process, FmiError> {
        let (starter, loaded) = self.starter(load)?;
        let place = self.places.take();
        let idle = self.idle();
        let start = Start {
            limits: self.limits,
            level: log::max_level(),
            is_prepared,
            surroundings: idle.surroundings.clone(),
            avoided_calls: idle.avoided_calls.clone(),
            place: place.number,
        };
        drop(idle);
        Process::begin(&starter, loaded, start, place)
    }

    /// Returns the starter of workers. Uses a starter prepared in advance, or starts a new one.
    fn starter(&self, load: &Load) -> Result<(Arc<Starter>, LoadId), FmiError> {
        let mut idle = self.idle();
        if let Some(starter) = idle.starter.as_ref().filter(|(starter, _)| !starter.is_broken()) {
            return Ok(starter.clone());
        }
        let starter = ahead::take(&self.launcher).map_or_else(|| Starter::start(&self.launcher), Ok)?;
        load.frame().and_then(|frame| starter.load(&frame)).map_err(no_worker)?;
        Ok(idle.starter.insert((Arc::new(starter), load.id)).clone())
    }

    /// Returns a process that has not received a request. If an FMU has ended the starter, a new one is
    /// started.
    fn new_process(&self, load: &Load, context: &RunContext<'_>) -> Result<Process, FmiError> {
        let arrived = |mut process: Process, longest| process.arrive(context, longest).map(|()| process);
        let begun = self.idle().begun.take();
        // A process that does not arrive may have loaded a model that ends it. The next process then reports
        // the error.
        if let Some(Ok(process)) = begun.map(|process| arrived(process, PREPARED)) {
            return Ok(process);
        }
        let longest = if self.limits.sandbox { START_CONFINED } else { START };
        let start = || self.begin(load, false).and_then(|process| arrived(process, longest));
        let is_broken = || self.idle().starter.as_ref().is_none_or(|(starter, _)| starter.is_broken());
        let started = match start() {
            Err(FmiError::NoWorker { .. }) if is_broken() => start(),
            outcome => outcome,
        };
        started.map_err(|error| match error {
            FmiError::NoWorker { reason } if self.limits.sandbox => FmiError::NoSandbox { reason },
            error => error,
        })
    }

    /// Starts a separate worker process for one user, with `load` loaded. No other user can use it, and it
    /// keeps its state between calls. It has the current working folder and environment variables.
    /// # Errors
    /// Returns the errors of [`call`](Self::call).
    pub fn pinned(
        self: &Arc<Self>,
        load: &Load,
        context: &RunContext<'_>,
    ) -> Result<PinnedProcess, FmiError> {
        let _held = self.hold();
        let mut process = self.new_process(load, context)?;
        if process.loaded != Some(load.id) {
            ask_to_load(&mut process, load, &mut Frame::default(), context, &self.reported)?;
        }
        Ok(PinnedProcess { process, workers: Arc::clone(self) })
    }

    /// Sends a request to a worker with `load` loaded, and reads the answer with `accept`. Returns the result
    /// with the quirks found in the model. A worker whose answer is not accepted is ended.
    ///
    /// If a worker ends for a reason other than a time limit, the request is repeated once in a fresh worker,
    /// unless `whom` requests a fresh one. It is also repeated if a used worker reports an error of its
    /// process. If a worker dies at the end of a run, the rows are complete. The request is then always
    /// repeated in a fresh worker that omits that call.
    /// # Errors
    /// Returns [`FmiError::ReportedError`] if the worker reports an error. Returns [`FmiError::WorkerEnded`]
    /// if the worker ended twice, or once because of the time limit. Returns [`FmiError::NoWorker`] or
    /// [`FmiError::NoSandbox`] if no worker can be started, and [`FmiError::Cancelled`] after cancellation.
    pub fn call<T>(
        self: &Arc<Self>,
        load: &Load,
        question: &Question<'_>,
        answer: &mut Frame,
        accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
        whom: RequestedProcess,
        mut repeat: Option<&mut Repeat<'_>>,
    ) -> Result<(T, Vec<Quirk>), FmiError> {
        let _held = self.hold();
        let is_fresh = matches!(whom, RequestedProcess::Fresh | RequestedProcess::FreshOnce);
        let is_of_end = Cell::new(false);
        let mut call = |process: Option<Process>| {
            is_of_end.set(false);
            let mut process = match process {
                Some(process) => process,
                None => self.new_process(load, question.context)?,
            };
            let (accepted, mut can_go_on) = self.call_in(&mut process, load, question, answer, accept);
            is_of_end.set(self.avoid_call_at_end_of_run(&process, &accepted));
            if let Some(repeat) = repeat.as_deref_mut()
                && can_go_on
                && answer.is_of_used_process
            {
                let Repeat { question, answer, outcome } = repeat;
                let (reported, goes_on) = self.call_in(&mut process, load, question, answer, &mut |_| Ok(()));
                (*outcome, can_go_on) = (Some(reported.map(drop)), goes_on);
            }
            // Otherwise, the process is dropped here, which ends it.
            if can_go_on && whom != RequestedProcess::FreshOnce {
                self.give_back(process);
            }
            accepted
        };
        let mut process = self.idle_process(load, whom);
        let mut n_left = u32::from(!is_fresh);
        loop {
            let was_used = process.is_some();
            let error = match call(process.take()) {
                Err(error) => error,
                Ok((accepted, mut quirks)) => {
                    quirks.append(&mut self.idle().quirks);
                    return Ok((accepted, quirks));
                }
            };
            let is_tried_again = match &error {
                FmiError::WorkerEnded(end) => end.kind != EndKind::Hung,
                // A used process may have lost files that it needs.
                FmiError::ReportedError(reported) => was_used && reported.is_of_process(),
                _ => false,
            };
            if !is_of_end.get() {
                if n_left == 0 || !is_tried_again {
                    return Err(error);
                }
                n_left -= 1;
            }
            log::info!("{error}; trying again in a new process");
        }
    }

    /// Records a call at the end of a run that has ended a process, so that new processes omit it. Returns
    /// true if this process did not omit the call; the request can then be repeated.
    fn avoid_call_at_end_of_run<T>(&self, process: &Process, answer: &Result<T, FmiError>) -> bool {
        let Err(FmiError::WorkerEnded(end)) = answer else { return false };
        let Some(function) = end.call_at_end_of_run() else { return false };
        let is_listed = |calls: &[String]| calls.iter().any(|call| call == function);
        if is_listed(&process.avoided_calls) {
            return false;
        }
        let mut idle = self.idle();
        if is_listed(&idle.avoided_calls) {
            return true;
        }
        idle.avoided_calls.push(function.to_owned());
        let message = format!(
            "{function} does not return at the end of a run ({}). The rows of the run are kept; instead of \
             further calls, the processes of unfreed instances are replaced",
            end.what
        );
        idle.quirks.push(Quirk { kind: QuirkKind::Promise, message, line: 0 });
        let outdated = idle.take_processes();
        drop(idle);
        drop(outdated);
        true
    }

    /// Returns the answer with the quirks, and true if the process can be used again.
    fn call_in<T>(
        &self,
        process: &mut Process,
        load: &Load,
        question: &Question<'_>,
        answer: &mut Frame,
        accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
    ) -> (Result<(T, Vec<Quirk>), FmiError>, bool) {
        if process.loaded != Some(load.id)
            && let Err(error) = ask_to_load(process, load, answer, question.context, &self.reported)
        {
            return (Err(error), false);
        }
        let began = Instant::now();
        let was_used = std::mem::replace(&mut process.is_used, true);
        let reported = ask(process, question, answer, accept, &self.reported);
        answer.is_of_used_process = was_used;
        let is_of_process =
            matches!(&reported, Err(FmiError::ReportedError(reported)) if reported.is_of_process());
        let can_go_on = !process.has_ended()
            && !is_of_process
            && !answer.is_last
            && !self.is_worn(process, began.elapsed());
        (reported.map(|accepted| (accepted, std::mem::take(&mut process.quirks))), can_go_on)
    }

    /// True if a worker has reached its maximum number of calls or its maximum memory growth.
    fn is_worn(&self, process: &mut Process, took: Duration) -> bool {
        if self.limits.calls.is_some_and(|most| process.n_calls >= most) {
            return true;
        }
        if process.first_size.is_some() && took < LONG_CALL && !process.n_calls.is_multiple_of(LOOK_EVERY) {
            return false;
        }
        let Some(size) = process.size() else { return false };
        let first = *process.first_size.get_or_insert(size);
        size > first.saturating_add(self.limits.growth)
    }

    fn idle(&self) -> MutexGuard<'_, Idle> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let process_id = std::process::id();
        if idle.owner != process_id {
            idle.processes.clear();
            (idle.begun, idle.starter) = (None, None);
            (idle.owner, idle.is_watched, idle.n_held) = (process_id, false, 0);
        }
        idle
    }

    /// Returns the number of idle workers with this load.
    pub fn n_idle(&self, load: &Load) -> usize {
        self.idle().lent_to(load).filter(|loaded| *loaded == load.id).count()
    }

    /// Ends the idle workers of this load, which are no longer needed.
    pub fn forget(&self, load: &Load) {
        let is_of_load = |(process, _): &mut (Process, Instant)| {
            process.loaded.is_some_and(|loaded| loaded.owner == load.id.number)
        };
        let ended: Vec<_> = self.idle().processes.extract_if(.., is_of_load).collect();
        drop(ended);
    }

    /// Returns an idle process with this load, or one that is [lent](Load::in_processes_of). No other process
    /// is used, because earlier work in a process may affect its answers.
    fn idle_process(&self, load: &Load, whom: RequestedProcess) -> Option<Process> {
        let mut idle = self.idle();
        let is_of_load = |(process, _): &(Process, Instant)| process.loaded == Some(load.id);
        let place = match whom {
            RequestedProcess::Any => {
                let is_lent = |(process, _): &(Process, Instant)| {
                    process.loaded.is_some_and(|loaded| loaded.owner == load.id.owner)
                };
                let of_load = idle.processes.iter().rposition(is_of_load);
                of_load.or_else(|| idle.processes.iter().rposition(is_lent))
            }
            RequestedProcess::LongestIdle => idle.processes.iter().position(is_of_load),
            RequestedProcess::Fresh | RequestedProcess::FreshOnce => None,
        };
        Some(idle.processes.remove(place?).0)
    }

    fn give_back(self: &Arc<Self>, process: Process) {
        let mut idle = self.idle();
        idle.processes.push((process, Instant::now()));
        self.watch(&mut idle);
    }

    /// Starts a thread that ends processes that are idle for too long.
    fn watch(self: &Arc<Self>, idle: &mut Idle) {
        if idle.is_watched {
            return;
        }
        let workers = Arc::downgrade(self);
        let watch = move || {
            loop {
                std::thread::sleep(IDLE / 4);
                let Some(workers) = workers.upgrade() else { break };
                let mut idle = workers.idle();
                let old = idle.take_old();
                let is_over = idle.processes.is_empty();
                let rest = is_over.then(|| (idle.begun.take(), idle.starter.take()));
                idle.is_watched = !is_over;
                drop(idle);
                drop((old, rest));
                if is_over {
                    break;
                }
            }
        };
        let thread = std::thread::Builder::new().name("fmufit-idle-workers".to_owned()).spawn(watch);
        idle.is_watched = thread.is_ok();
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        // Ends all workers at once.
        if let Some((starter, _)) = self.idle().starter.take() {
            starter.end();
        }
    }
}

/// Loads this into a process. A process that fails to load is discarded.
fn ask_to_load(
    process: &mut Process,
    load: &Load,
    answer: &mut Frame,
    context: &RunContext<'_>,
    reported: &Mutex<HashSet<String>>,
) -> Result<(), FmiError> {
    process.loaded = None;
    let requested = &load.frame().map_err(no_worker)?;
    let limits = AnswerLimits { run: None, runs: 0, size: FrameSize::of_numbers(0) };
    ask(
        process,
        &Question { requested, context, limits, is_repetition: false },
        answer,
        &mut |_| Ok(()),
        reported,
    )?;
    process.loaded = Some(load.id);
    Ok(())
}

/// Sends a request to a process, and forwards the notes in its answer.
fn ask<T>(
    process: &mut Process,
    question: &Question<'_>,
    answer: &mut Frame,
    accept: &mut dyn FnMut(&mut Frame) -> io::Result<T>,
    reported: &Mutex<HashSet<String>>,
) -> Result<T, FmiError> {
    loop {
        let notes = process.call(question, answer).map_err(|no_answer| match no_answer {
            NoAnswer::Cancelled => FmiError::Cancelled,
            NoAnswer::Ended(end) => FmiError::WorkerEnded(Box::new(end)),
            NoAnswer::Memory => no_memory(answer),
        })?;
        if !question.is_repetition {
            notes.pass_on(reported);
        }
        process.quirks.extend(notes.quirks);
        if !answer.is_repeated {
            break;
        }
        if process.n_repeated == MOST_REPEATED {
            let end = process.unreadable("too many repetitions were requested");
            return Err(FmiError::WorkerEnded(Box::new(end)));
        }
        process.n_repeated += 1;
    }
    let reported = match answer.is_error {
        true => answer.head::<ReportedError>().map(Err),
        false => accept(answer).map(Ok),
    };
    match reported {
        Ok(Ok(accepted)) => Ok(accepted),
        Ok(Err(reported)) if reported.kind == ReportedErrorKind::Cancelled => Err(FmiError::Cancelled),
        Ok(Err(reported)) => Err(FmiError::ReportedError(Box::new(reported))),
        Err(error) if error.kind() == io::ErrorKind::OutOfMemory => Err(no_memory(answer)),
        Err(error) => Err(FmiError::WorkerEnded(Box::new(process.unreadable(&error.to_string())))),
    }
}

/// Returns the error for an answer that does not fit into the memory of this process. `answer` is the
/// received part.
fn no_memory(answer: &Frame) -> FmiError {
    let bytes = 8 * answer.numbers.len() as u64;
    FmiError::Memory { what: "the received part of the result of the worker process".to_owned(), bytes }
}
