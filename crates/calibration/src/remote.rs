//! Simulations in worker processes: what a worker is asked for, and its answers.

use crate::accuracy::Accuracy;
use crate::error::CalibrationError;
use crate::experiment::SimulationSettings;
use crate::no_cost::{NoCost, ToldNoCost};
use crate::problem::{ModelFile, Problem};
use crate::race::{RaceOutcome, RaceRun, RaceTask};
use crate::residual::CostRule;
use dfo::RobustLoss;
use fmi::worker::{Frame, Isolation, Load, WorkerLimits, Workers};
use fmi::{FmiError, Fmu, OpenOptions, SimulateOptions, Trajectory};
use ode::{Method, Stats};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// What a worker has to know of a calibration.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Loaded {
    pub(crate) problem: Problem,
    pub(crate) options: OpenOptions,
}

/// What a worker is asked for.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum Job {
    /// To load a problem and its model, which the other jobs are of.
    Load(Box<Loaded>),
    /// To open a model, of which [`Simulate`](Self::Simulate) is.
    Open(ModelFile, Box<OpenOptions>),
    /// A simulation of the model.
    Simulate(Box<SimulateOptions>),
    /// The cost and the residuals at a point.
    Evaluate {
        x: Vec<f64>,
        method: Method,
        loss: RobustLoss,
        cutoff: f64,
        /// Where it is not that of the problem.
        accuracy: Option<Accuracy>,
    },
    /// A simulation of a race between methods.
    Race(RaceTask),
    /// The compared outputs of an experiment.
    Experiment { experiment: usize, x: Vec<f64>, method: Method, times: Option<Vec<f64>> },
    /// Variables of the model in an experiment.
    Variables {
        experiment: usize,
        x: Vec<f64>,
        method: Method,
        times: Option<Vec<f64>>,
        variables: Vec<String>,
    },
}

/// An evaluation; its residuals are the numbers of the frame.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Evaluated {
    pub(crate) cost: Result<f64, ToldNoCost>,
    pub(crate) stats: Stats,
}

/// A simulation of a race; its samples and then its residuals are the numbers of the frame.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Raced {
    pub(crate) outcome: RacedOutcome,
    /// What all its simulations have taken.
    pub(crate) stats: Stats,
    /// Number of residuals, and the seconds that they took.
    pub(crate) at_start: Option<(usize, f64)>,
}

/// A [`RaceOutcome`] without its samples.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum RacedOutcome {
    Finished(Stats),
    GivenUp,
    Failed(String),
}

/// The worker processes of a calibration.
#[derive(Debug)]
pub(crate) struct Remote {
    fmu: Fmu,
    workers: Arc<Workers>,
    load: Load,
    /// The limit of a single simulation.
    run_limit: Option<Duration>,
    /// Each point is evaluated in a process of its own.
    is_always_fresh: AtomicBool,
    /// Frames that were used before.
    frames: Mutex<Vec<(Frame, Frame)>>,
}

impl Remote {
    /// The processes for a problem, or why its model runs in this one; `None`: that was asked for.
    pub(crate) fn of(fmu: &Fmu, problem: &Problem) -> Result<Self, Option<String>> {
        let settings = &problem.settings;
        if settings.isolation == Isolation::None || fmu.is_absent() {
            return Err(None);
        }
        if let Some(input) = problem.experiments.iter().find_map(|experiment| experiment.driven_by_function())
        {
            return Err(Some(format!("the input {input} is a function of this program")));
        }
        let Some(workers) = fmu.workers(settings.worker_limits()) else {
            return Err(Some(NO_LAUNCHER.to_owned()));
        };
        // Where it is now, in this process no further process is started.
        let model = ModelFile::of(fmu).map_err(|error| Some(error.to_string()))?;
        let settings = SimulationSettings { isolation: Isolation::None, ..settings.clone() };
        let problem = Problem { model, settings, ..problem.clone() };
        let run_limit = problem.settings.timeout;
        let loaded = Job::Load(Box::new(Loaded { problem, options: fmu.options().clone() }));
        let frame = Frame::of(&loaded).map_err(|error| Some(error.to_string()))?;
        Ok(Self {
            fmu: fmu.clone(),
            workers,
            load: Load::new(frame),
            run_limit,
            is_always_fresh: AtomicBool::new(false),
            frames: Mutex::default(),
        })
    }

    /// Evaluates each point in a process of its own from now on.
    pub(crate) fn set_always_fresh(&self) {
        self.is_always_fresh.store(true, Ordering::Relaxed);
    }

    /// Whether each point is evaluated in a process of its own.
    pub(crate) fn is_always_fresh(&self) -> bool {
        self.is_always_fresh.load(Ordering::Relaxed)
    }

    /// Asks a worker, and hands its answer to `use_answer`.
    fn ask<T>(
        &self,
        job: &Job,
        is_fresh: bool,
        cancelled: &dyn Fn() -> bool,
        use_answer: impl FnOnce(&mut Frame) -> std::io::Result<T>,
    ) -> Result<T, FmiError> {
        let frames = || self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut asked, mut answer) = frames().pop().unwrap_or_default();
        asked.set_head(job).map_err(unsaid)?;
        let (load, limit) = (&self.load, self.run_limit);
        let quirks = self.workers.call(load, &asked, &mut answer, cancelled, limit, is_fresh)?;
        self.fmu.add_quirks(quirks);
        let used = use_answer(&mut answer).map_err(unsaid);
        frames().push((asked, answer));
        used
    }

    /// The cost at a point, its residuals into `out`; see [`Evaluator::evaluate`](crate::evaluate::Evaluator::evaluate).
    pub(crate) fn evaluate(
        &self,
        (x, method): (&[f64], Method),
        rule: CostRule<'_>,
        (accuracy, is_fresh): (Option<Accuracy>, bool),
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, NoCost> {
        let CostRule { loss, cutoff, cancelled } = rule;
        let job = Job::Evaluate { x: x.to_vec(), method, loss, cutoff, accuracy };
        let is_fresh = is_fresh || self.is_always_fresh();
        let mut use_answer = |answer: &mut Frame| {
            let Evaluated { cost, stats } = answer.head()?;
            if cost.is_ok() {
                if answer.numbers.len() != out.len() {
                    let message = format!("{} residuals instead of {}", answer.numbers.len(), out.len());
                    return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, message));
                }
                out.copy_from_slice(&answer.numbers);
            }
            Ok((cost, stats))
        };
        let mut evaluated = self.ask(&job, is_fresh, cancelled, &mut use_answer);
        if !is_fresh && matches!(&evaluated, Ok((Err(told), _)) if told.is_of_process()) {
            // A process that was used before may have lost what it needs.
            evaluated = self.ask(&job, true, cancelled, &mut use_answer);
        }
        let (cost, taken) = evaluated.map_err(NoCost::of_worker)?;
        *stats += taken;
        cost.map_err(NoCost::from)
    }

    /// A simulation of a race, and the residuals at the start with the seconds that they took.
    pub(crate) fn race(
        &self,
        task: RaceTask,
        cancelled: &dyn Fn() -> bool,
        stats: &mut Stats,
    ) -> Result<RaceRun, CalibrationError> {
        let raced = self.ask(&Job::Race(task), self.is_always_fresh(), cancelled, |answer| {
            let raced: Raced = answer.head()?;
            Ok((raced, std::mem::take(&mut answer.numbers)))
        });
        let (Raced { outcome, stats: taken, at_start }, mut samples) = match raced {
            Ok(raced) => raced,
            Err(error) => {
                return match NoCost::of_worker(error) {
                    NoCost::Failed { reason, .. } => Ok((RaceOutcome::Failed(reason), None)),
                    NoCost::Over(error) => Err(CalibrationError::Model(*error)),
                    NoCost::Above | NoCost::Cancelled => Err(CalibrationError::Cancelled),
                };
            }
        };
        *stats += taken;
        let at_start =
            at_start.map(|(n, seconds)| (samples.split_off(samples.len().saturating_sub(n)), seconds));
        let outcome = match outcome {
            RacedOutcome::Finished(stats) => RaceOutcome::Finished { samples, stats },
            RacedOutcome::GivenUp => RaceOutcome::GivenUp,
            RacedOutcome::Failed(reason) => RaceOutcome::Failed(reason),
        };
        Ok((outcome, at_start))
    }

    /// A recorded simulation.
    pub(crate) fn trajectory(
        &self,
        job: &Job,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Trajectory, CalibrationError> {
        let trajectory = self.ask(job, self.is_always_fresh(), cancelled, trajectory_of);
        trajectory.map_err(|error| match error {
            FmiError::Cancelled => CalibrationError::Cancelled,
            error => error.into(),
        })
    }
}

/// A model that is simulated in processes of its own.
#[derive(Debug)]
pub struct ModelProcess {
    fmu: Fmu,
    workers: Arc<Workers>,
    load: Load,
}

impl ModelProcess {
    /// Nothing is started yet.
    ///
    /// # Errors
    /// The file of the model cannot be read any more; [`FmiError::NoWorker`]: this program cannot start processes for it.
    pub fn new(fmu: &Fmu, limits: WorkerLimits) -> Result<Self, FmiError> {
        let workers =
            fmu.workers(limits).ok_or_else(|| FmiError::NoWorker { reason: NO_LAUNCHER.to_owned() })?;
        let open = Job::Open(ModelFile::of(fmu)?, Box::new(fmu.options().clone()));
        let load = Load::new(Frame::of(&open).map_err(unsaid)?);
        Ok(Self { fmu: fmu.clone(), workers, load })
    }

    /// As [`Fmu::simulate_with`], with the same bits. `cancelled` ends it.
    ///
    /// # Errors
    /// As [`Fmu::simulate`]; [`FmiError::WorkerEnded`]; [`FmiError::Cancelled`]; inputs that are functions.
    pub fn simulate(
        &self,
        options: &SimulateOptions,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Trajectory, FmiError> {
        if let Some(input) = options.inputs.as_ref().and_then(|inputs| inputs.driven_by_function()) {
            let problem =
                format!("the input {input} is a function of this program, which no other process can call");
            return Err(FmiError::BadSetting { problem });
        }
        let (mut asked, mut answer) = (Frame::default(), Frame::default());
        asked.set_head(&Job::Simulate(Box::new(options.clone()))).map_err(unsaid)?;
        let quirks = self.workers.call(&self.load, &asked, &mut answer, cancelled, options.timeout, false)?;
        self.fmu.add_quirks(quirks);
        trajectory_of(&mut answer).map_err(unsaid)
    }
}

const NO_LAUNCHER: &str = "this program cannot start processes for it (worker::serve_if_asked)";

fn unsaid(error: std::io::Error) -> FmiError {
    FmiError::BadSetting { problem: error.to_string() }
}

/// Puts a trajectory into a frame: its rows are the numbers.
pub(crate) fn put_trajectory(mut trajectory: Trajectory, answer: &mut Frame) -> std::io::Result<()> {
    answer.numbers.append(&mut trajectory.time);
    trajectory.columns.iter_mut().for_each(|column| answer.numbers.append(column));
    answer.set_head(&trajectory)
}

fn trajectory_of(answer: &mut Frame) -> std::io::Result<Trajectory> {
    let mut trajectory: Trajectory = answer.head()?;
    let rows = answer.numbers.len() / (trajectory.columns.len() + 1);
    let mut columns = answer.numbers.chunks(rows.max(1));
    let mut column = || columns.next().map(<[f64]>::to_vec).unwrap_or_default();
    trajectory.time = column();
    trajectory.columns.iter_mut().for_each(|values| *values = column());
    Ok(trajectory)
}
