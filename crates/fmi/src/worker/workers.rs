//! Worker processes for as many threads as ask for something: started when they are needed, replaced when
//! they end or grow.

use super::fork_server::Template;
use super::frame::Frame;
use super::isolation::AskedProcess;
use super::launcher::Launcher;
use super::limits::WorkerLimits;
use super::load::{Load, LoadId};
use super::worker_process::{NoAnswer, Process};
use crate::description::Quirk;
use crate::error::{EndKind, FmiError, ReportedError, ReportedErrorKind, WorkerEnd};
use base::RunContext;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A worker that nobody has asked for anything for so long is ended.
const IDLE: Duration = Duration::from_secs(5);

/// A worker is there after this time.
const START: Duration = Duration::from_secs(60);

/// A confined one compiles the sources of its model before.
const START_CONFINED: Duration = Duration::from_secs(600);

/// One that was started before it was needed is there after this time, or is not waited for.
const PREPARED: Duration = Duration::from_secs(10);

/// The memory of a worker is looked at after each so many calls, and after every one that took so long.
const LOOK_EVERY: u64 = 32;
const LONG_CALL: Duration = Duration::from_millis(20);

/// A set of worker processes of one program, with limits. Each serves one thread at a time.
#[derive(Debug)]
pub struct Workers {
    launcher: Launcher,
    limits: WorkerLimits,
    idle: Mutex<Idle>,
}

#[derive(Debug, Default)]
struct Idle {
    /// With the time since when they are; those that were asked last at the end.
    processes: Vec<(Process, Instant)>,
    /// One that is being started.
    begun: Option<Process>,
    /// What they are copied from.
    template: Option<Arc<Template>>,
    /// Somebody looks after those that are idle for long.
    is_watched: bool,
    /// Whose they are: a child that was forked meanwhile has none.
    owner: u32,
}

impl Idle {
    /// What those have loaded that may be asked for this.
    fn lent_to(&self, load: &Load) -> impl Iterator<Item = LoadId> {
        let loaded = self.processes.iter().filter_map(|(process, _)| process.loaded);
        loaded.filter(|loaded| loaded.owner == load.id.owner)
    }
}

impl Workers {
    /// Nothing is started yet. `None`: this program does not know how to start a worker (see [`Launcher`]).
    pub fn new(limits: WorkerLimits) -> Option<Arc<Self>> {
        let launcher = Launcher::known()?;
        Some(Arc::new(Self { launcher, limits, idle: Mutex::default() }))
    }

    /// The limits.
    pub fn limits(&self) -> &WorkerLimits {
        &self.limits
    }

    /// Starts the program of the workers, has it load this, and the first worker copied from it, in the
    /// background: that takes longer than a short evaluation.
    pub fn prepare(&self, load: &Load) {
        self.prepare_one_of(1, load, false);
    }

    /// Has a second worker started in the background, and its model loaded: it will be needed soon.
    pub fn prepare_second(&self, load: &Load) {
        self.prepare_one_of(2, load, true);
    }

    fn prepare_one_of(&self, n: usize, load: &Load, is_prepared: bool) {
        let are_there = |idle: &Idle| idle.begun.is_some() || idle.lent_to(load).count() >= n;
        if !are_there(&self.idle()) {
            // Who needs a worker meets the same error.
            let begun = self.begin(load, is_prepared).ok();
            self.idle().begun = begun;
        }
    }

    fn has_no_template(&self) -> bool {
        self.idle().template.as_ref().is_none_or(|template| template.is_broken())
    }

    fn begin(&self, load: &Load, is_prepared: bool) -> Result<Process, FmiError> {
        Process::begin(&self.template(load)?, &self.limits, is_prepared)
    }

    /// The process that workers are copied from.
    fn template(&self, load: &Load) -> Result<Arc<Template>, FmiError> {
        let mut idle = self.idle();
        match &idle.template {
            Some(template) if !template.is_broken() => Ok(Arc::clone(template)),
            _ => Ok(Arc::clone(idle.template.insert(Arc::new(Template::loading(&self.launcher, load)?)))),
        }
    }

    /// A process that was never asked for anything. An FMU may have ended the template: then there is another
    /// one.
    fn new_process(&self, load: &Load, context: &RunContext<'_>) -> Result<Process, FmiError> {
        let arrived = |mut process: Process, longest| process.arrive(context, longest).map(|()| process);
        let begun = self.idle().begun.take();
        // One that does not arrive may have loaded a model that ends it: then the next one says so.
        if let Some(Ok(process)) = begun.map(|process| arrived(process, PREPARED)) {
            return Ok(process);
        }
        let longest = if self.limits.sandbox { START_CONFINED } else { START };
        match arrived(self.begin(load, false)?, longest) {
            Err(FmiError::NoWorker { .. }) if self.has_no_template() => {
                arrived(self.begin(load, false)?, longest)
            }
            outcome => outcome,
        }
    }

    /// Asks a worker that has loaded `load`, and returns the quirks of the model that it has found. The
    /// context is looked at every 10 ms, and the worker has 0.1 s to answer once it is over; a single
    /// simulation that takes longer than `run_limit` and 0.25 s ends the worker. Where a worker dies, the
    /// same is asked once more in a fresh one, unless it was one.
    ///
    /// # Errors
    /// [`FmiError::ReportedError`]: what the worker says; [`FmiError::WorkerEnded`]: it ended twice, or once by the time limit; [`FmiError::NoWorker`]; [`FmiError::Cancelled`].
    pub fn call(
        self: &Arc<Self>,
        load: &Load,
        asked: &Frame,
        answer: &mut Frame,
        context: &RunContext<'_>,
        run_limit: Option<Duration>,
        whom: AskedProcess,
    ) -> Result<Vec<Quirk>, FmiError> {
        let is_fresh = matches!(whom, AskedProcess::Fresh | AskedProcess::FreshOnce);
        let mut call = |process: Option<Process>| {
            let mut process = match process {
                Some(process) => process,
                None => self.new_process(load, context)?,
            };
            let (quirks, can_go_on) = self.call_in(&mut process, load, asked, answer, context, run_limit);
            // Otherwise it ends here.
            if can_go_on && whom != AskedProcess::FreshOnce {
                self.give_back(process);
            }
            quirks
        };
        let process = self.idle_process(load, whom);
        let was_used = process.is_some();
        let error = match call(process) {
            Err(error) => error,
            outcome => return outcome,
        };
        let is_tried_again = match &error {
            FmiError::WorkerEnded(end) => end.kind != EndKind::Hung,
            // A process that was used before may have lost what it needs.
            FmiError::ReportedError(told) => was_used && told.is_of_process(),
            _ => false,
        };
        if is_fresh || !is_tried_again {
            return Err(error);
        }
        log::info!("{error}; the same is tried once more in a fresh process");
        call(None)
    }

    /// The quirks; and whether the process can be asked again.
    fn call_in(
        &self,
        process: &mut Process,
        load: &Load,
        asked: &Frame,
        answer: &mut Frame,
        context: &RunContext<'_>,
        run_limit: Option<Duration>,
    ) -> (Result<Vec<Quirk>, FmiError>, bool) {
        if process.loaded != Some(load.id)
            && let Err(error) = ask_to_load(process, load, answer, context)
        {
            return (Err(error), false);
        }
        let began = Instant::now();
        let told = ask(process, asked, answer, context, run_limit);
        let is_of_process = matches!(&told, Err(FmiError::ReportedError(told)) if told.is_of_process());
        let can_go_on = !process.has_ended()
            && !is_of_process
            && !answer.is_last
            && !self.is_worn(process, began.elapsed());
        (told.map(|()| std::mem::take(&mut process.quirks)), can_go_on)
    }

    /// True if a worker has served long enough, or has grown too much.
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
        let this = std::process::id();
        if idle.owner != this {
            idle.processes.clear();
            (idle.begun, idle.template) = (None, None);
            (idle.owner, idle.is_watched) = (this, false);
        }
        idle
    }

    /// Ends the idle workers of this: nobody asks them any more.
    pub fn forget(&self, load: &Load) {
        let is_of_load = |(process, _): &mut (Process, Instant)| {
            process.loaded.is_some_and(|loaded| loaded.owner == load.id.number)
        };
        let ended: Vec<_> = self.idle().processes.extract_if(.., is_of_load).collect();
        drop(ended);
    }

    /// One of those that have loaded this, else one that is [lent](Load::in_processes_of), and no other: what
    /// ran before in a process may show in its answers.
    fn idle_process(&self, load: &Load, whom: AskedProcess) -> Option<Process> {
        let mut idle = self.idle();
        let is_of_load = |(process, _): &(Process, Instant)| process.loaded == Some(load.id);
        let place = match whom {
            AskedProcess::Any => {
                let is_lent = |(process, _): &(Process, Instant)| {
                    process.loaded.is_some_and(|loaded| loaded.owner == load.id.owner)
                };
                let own = idle.processes.iter().rposition(is_of_load);
                own.or_else(|| idle.processes.iter().rposition(is_lent))
            }
            AskedProcess::Fresh | AskedProcess::FreshOnce => None,
        };
        Some(idle.processes.remove(place?).0)
    }

    fn give_back(self: &Arc<Self>, process: Process) {
        let mut idle = self.idle();
        idle.processes.push((process, Instant::now()));
        self.watch(&mut idle);
    }

    /// Ends what nobody has asked for anything for long.
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
                let old =
                    idle.processes.extract_if(.., |(_, since)| since.elapsed() > IDLE).collect::<Vec<_>>();
                let is_over = idle.processes.is_empty();
                let rest = is_over.then(|| (idle.begun.take(), idle.template.take()));
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
        // All at once.
        if let Some(template) = self.idle().template.take() {
            template.end();
        }
    }
}

/// Has a process load this. One that cannot is of no use to anybody.
fn ask_to_load(
    process: &mut Process,
    load: &Load,
    answer: &mut Frame,
    context: &RunContext<'_>,
) -> Result<(), FmiError> {
    process.loaded = None;
    let frame = load.frame().map_err(|error| FmiError::NoWorker { reason: error.to_string() })?;
    ask(process, &frame, answer, context, None)?;
    process.loaded = Some(load.id);
    Ok(())
}

/// Asks a process, and passes on what it says beside its answer.
fn ask(
    process: &mut Process,
    asked: &Frame,
    answer: &mut Frame,
    context: &RunContext<'_>,
    run_limit: Option<Duration>,
) -> Result<(), FmiError> {
    let notes = process.call(asked, answer, context, run_limit).map_err(|no_answer| match no_answer {
        NoAnswer::Cancelled => FmiError::Cancelled,
        NoAnswer::Ended(end) => FmiError::WorkerEnded(Box::new(end)),
    })?;
    notes.pass_on();
    process.quirks.extend(notes.quirks);
    match answer.is_error {
        true => Err(match answer.head::<ReportedError>().map_err(garbage)? {
            told if told.kind == ReportedErrorKind::Cancelled => FmiError::Cancelled,
            told => FmiError::ReportedError(Box::new(told)),
        }),
        false => Ok(()),
    }
}

/// An answer that cannot be understood.
pub(super) fn garbage(error: std::io::Error) -> FmiError {
    FmiError::WorkerEnded(Box::new(WorkerEnd {
        kind: EndKind::Garbage,
        what: error.to_string(),
        function: None,
        time: None,
        output: String::new(),
    }))
}
