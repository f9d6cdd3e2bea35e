//! `fmufit jobs`: a fit by independent jobs that share a folder.

use super::fit::{check_fit, conclude, print, searched};
use crate::arguments::{Jobs, JobsInit, JobsNext, JobsProblem, JobsRun, JobsStatus, JobsTell};
use crate::console::Console;
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::problem::{ProblemFile, short_form};
use calibration::{Calibration, Fit, FitOptions, JobDriver, JobFolder, RunContext, Stage};
use dfo::{Record, Value};
use serde::Serialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Stack size of the evaluating thread. Compiled models store large arrays on the stack.
const STACK_SIZE: usize = 16 << 20;

/// Interval between two attempts to drive the fit, in steps of [`STEP`].
const STEPS: usize = 20;
const STEP: Duration = Duration::from_millis(50);

pub(crate) fn run(command: &Jobs, console: &Console) -> Result<Exit, Error> {
    match command {
        Jobs::Init(arguments) => init(arguments, console),
        Jobs::Run(arguments) => work(arguments, console),
        Jobs::Next(arguments) => next(arguments, console),
        Jobs::Tell(arguments) => tell(arguments),
        Jobs::Status(arguments) => status(arguments, console),
    }
}

/// A fit and its folder.
struct JobFit {
    file: ProblemFile,
    calibration: Calibration,
    stages: Vec<Stage>,
    folder: JobFolder,
}

impl JobsProblem {
    fn folder(&self) -> std::path::PathBuf {
        self.folder.clone().unwrap_or_else(|| self.problem.with_extension("jobs"))
    }
}

impl JobFit {
    fn open(at: &JobsProblem, context: &RunContext<'_>) -> Result<Self, Error> {
        let folder = JobFolder::open(&at.folder()).map_err(Error::of_input)?;
        let mut file = ProblemFile::read(&at.problem)?;
        file.set("fit", folder.options().clone());
        let calibration = file.calibration(context)?;
        let (options, stages) = options(&file, &calibration)?;
        let identity = JobFolder::identity(&calibration, &options, &stages).map_err(Error::of_input)?;
        folder.check(&identity).map_err(Error::of_input)?;
        Ok(Self { file, calibration, stages, folder })
    }

    /// Drives the fit to its end and saves the result. Returns `None` if the fit has not ended: `is_over` was
    /// true, or the driver has found no answer and `is_once` is set.
    fn drive(
        &self,
        is_once: bool,
        is_over: &dyn Fn() -> bool,
        console: &Console,
    ) -> Result<Option<Fit>, Error> {
        let (mut options, _) = options(&self.file, &self.calibration)?;
        let driver = JobDriver::new(self.folder.clone(), options.run.workers.unwrap_or(1));
        let state = driver.state();
        options.engine = Some(Rc::new(RefCell::new(driver)));
        if let Some(uncertainty) = &mut options.uncertainty {
            // These simulations run in this job.
            uncertainty.workers = Some(base::available_cores());
        }
        let is_requested = || {
            let is_requested = is_over() || (is_once && state.is_waiting.get());
            state.is_leaving.set(state.is_leaving.get() || is_requested);
            is_requested
        };
        let fit = searched(&self.calibration, options, &self.stages, (&is_requested, None), console);
        if let Some(error) = state.error.take() {
            return Err(Error::of_input(error));
        }
        if state.is_leaving.get() {
            return Ok(None);
        }
        let fit = fit?;
        fit.save(&self.calibration, self.folder.result()).map_err(Error::of_input)?;
        Ok(Some(fit))
    }
}

/// Returns the options and the stages of a fit.
fn options(
    file: &ProblemFile,
    calibration: &Calibration,
) -> Result<(FitOptions<'static>, Vec<Stage>), Error> {
    let n = calibration.parameters().len();
    let options = file.options(n)?;
    let stages = file.stages(n, options.run.workers)?;
    Ok((options, stages))
}

fn init(arguments: &JobsInit, console: &Console) -> Result<Exit, Error> {
    let mut file = ProblemFile::read(&arguments.at.problem)?;
    if file.is_design() {
        return Err(Error::input(
            "jobs run fits, but the problem has an objective and no recordings. Use fmufit optimize",
        ));
    }
    let mut given: Record = short_form::options(&arguments.option)?.into_iter().collect();
    given.insert("workers".to_owned(), Value::Count(arguments.jobs));
    file.set("fit", given.clone());
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    let calibration = file.calibration(&RunContext::new().polling(&is_requested))?;
    calibration.columns_without_unit().iter().for_each(|reported| console.note(reported));
    if options(&file, &calibration)?.0.run.seed.is_none() {
        given.insert("rng".to_owned(), Value::Count(dfo::draw_seed()));
        file.set("fit", given.clone());
    }
    let (options, stages) = options(&file, &calibration)?;
    let is_timed = std::iter::once(&options.run.limits).chain(stages.iter().map(|stage| &stage.limits));
    if is_timed.into_iter().any(|limits| limits.max_time.is_some()) {
        return Err(Error::input(
            "max_time is not available for jobs, because each job has its own clock; limit the time of the \
             jobs, or set max_evaluations",
        ));
    }
    if options.run.checkpoint.is_some() {
        return Err(Error::input(
            "checkpoint is not available for jobs, because their folder contains the state of the fit; remove \
             the option",
        ));
    }
    check_fit(&calibration, &options, &stages)?;
    let identity = JobFolder::identity(&calibration, &options, &stages).map_err(Error::of_input)?;
    let path = arguments.at.folder();
    JobFolder::create(&path, identity, given, arguments.lease).map_err(Error::of_input)?;
    console.result(&format!("created {}", path.display()));
    Ok(Exit::Success)
}

fn work(arguments: &JobsRun, console: &Console) -> Result<Exit, Error> {
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    let fit = JobFit::open(&arguments.at, &RunContext::new().polling(&is_requested))?;
    // Opened separately, so that the driver and the evaluation do not affect each other.
    let fmu = fit.file.model()?;
    let (is_over, has_failed) = (AtomicBool::new(false), AtomicBool::new(false));
    let folder = &fit.folder;
    let (driven, evaluated) = std::thread::scope(|scope| {
        let evaluate = || {
            let evaluated = folder.evaluate(&fmu, &is_over);
            has_failed.store(evaluated.is_err(), Ordering::Relaxed);
            evaluated
        };
        let thread = std::thread::Builder::new().stack_size(STACK_SIZE).spawn_scoped(scope, evaluate);
        let thread = thread.map_err(|error| Error::work(format!("cannot start a thread: {error}")))?;
        let is_ending = || interrupt.is_requested() || has_failed.load(Ordering::Relaxed);
        let driven = drive_when_free(&fit, &is_ending, console);
        is_over.store(true, Ordering::Relaxed);
        let evaluated = thread.join().map_err(|_| Error::work("the evaluating thread has panicked"))?;
        Ok::<_, Error>((driven, evaluated))
    })?;
    let n = evaluated.map_err(Error::of_input)?;
    let driven = driven?;
    console.note(&format!("this job evaluated {n} points"));
    match driven {
        Some(found) => {
            console.note(&format!("saved {}", folder.result().display()));
            print(&found, &fit.calibration, arguments.json, console)?;
            Ok(conclude(&found, false, console))
        }
        None if folder.is_done() => Ok(Exit::Success),
        None => Ok(Exit::Interrupted),
    }
}

/// Drives the fit as soon as no other job drives it. Returns `None` if another job has ended the fit, or if
/// `is_over` is true.
fn drive_when_free(
    fit: &JobFit,
    is_over: &dyn Fn() -> bool,
    console: &Console,
) -> Result<Option<Fit>, Error> {
    loop {
        let claim = fit.folder.claim_drive().map_err(Error::of_input)?;
        if fit.folder.is_done() || is_over() {
            return Ok(None);
        }
        if claim.is_some() {
            return fit.drive(false, is_over, console);
        }
        for _ in 0..STEPS {
            if !is_over() {
                std::thread::sleep(STEP);
            }
        }
    }
}

/// Answer of `jobs next`.
#[derive(Serialize)]
struct NextDocument<'d> {
    /// `point`, `wait` (all points are being evaluated) or `done` (the fit has ended).
    state: &'d str,
    point: Option<&'d str>,
    parameters: Option<BTreeMap<&'d str, f64>>,
}

fn next(arguments: &JobsNext, console: &Console) -> Result<Exit, Error> {
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    let fit = JobFit::open(&arguments.at, &RunContext::new().polling(&is_requested))?;
    let take = || fit.folder.take(Duration::from_secs(arguments.lease)).map_err(Error::of_input);
    let mut taken = take()?;
    if taken.is_none() && !fit.folder.is_done() {
        if let Some(_claim) = fit.folder.claim_drive().map_err(Error::of_input)? {
            fit.drive(true, &is_requested, console)?;
        }
        taken = take()?;
    }
    if interrupt.is_requested() {
        taken.iter().try_for_each(|point| fit.folder.give_back(point)).map_err(Error::of_input)?;
        return Ok(Exit::Interrupted);
    }
    let names = fit.calibration.parameters().iter().map(|parameter| parameter.name());
    console.json(&NextDocument {
        state: match &taken {
            Some(_) => "point",
            None if fit.folder.is_done() => "done",
            None => "wait",
        },
        point: taken.as_ref().map(|point| point.name()),
        parameters: taken.as_ref().map(|point| names.zip(point.x().iter().copied()).collect()),
    })?;
    Ok(Exit::Success)
}

fn tell(arguments: &JobsTell) -> Result<Exit, Error> {
    let fit = JobFit::open(&arguments.at, &RunContext::new())?;
    let point = fit.folder.claimed(&arguments.point).map_err(Error::of_input)?;
    let residuals = match (&arguments.failed, &arguments.residuals) {
        (Some(reason), _) => Err(reason.clone()),
        (None, path) => Ok(residuals(path.as_deref())?),
    };
    fit.folder.tell(&point, fit.calibration.fmu(), residuals).map_err(Error::of_input)?;
    Ok(Exit::Success)
}

/// Reads numbers from a file or from the standard input.
fn residuals(path: Option<&std::path::Path>) -> Result<Vec<f64>, Error> {
    let name = path.map_or_else(|| "the standard input".to_owned(), |path| path.display().to_string());
    let text = match path {
        Some(path) => std::fs::read_to_string(path),
        None => std::io::read_to_string(std::io::stdin()),
    };
    let text = text.map_err(|error| Error::input(format!("cannot read {name}: {error}")))?;
    let parts = text.split(|c: char| c.is_whitespace() || "[],".contains(c)).filter(|part| !part.is_empty());
    let number =
        |part: &str| part.parse().map_err(|_| Error::input(format!("{name}: '{part}' is not a number")));
    parts.map(number).collect()
}

fn status(arguments: &JobsStatus, console: &Console) -> Result<Exit, Error> {
    let folder = JobFolder::open(&arguments.at.folder()).map_err(Error::of_input)?;
    let status = folder.status().map_err(Error::of_input)?;
    if arguments.json {
        console.json(&status)?;
        return Ok(Exit::Success);
    }
    let state = match (status.is_done, status.is_driven) {
        (true, _) => format!("the fit has ended; the result is {}", folder.result().display()),
        (false, true) => "the fit is running".to_owned(),
        (false, false) => "no job drives the fit".to_owned(),
    };
    console.result(&format!(
        "{state}\n{} answers, {} points waiting, {} being evaluated, {} lost",
        status.n_answers, status.n_waiting, status.n_claimed, status.n_lost
    ));
    Ok(Exit::Success)
}
