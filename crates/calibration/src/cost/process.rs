//! Simulations in worker processes: what a worker is asked for, and its answers.

use crate::cost::accuracy::Accuracy;
use crate::cost::failure::{CostFailure, ReportedCostFailure};
use crate::cost::parallel::beside;
use crate::cost::residual::CostRule;
use crate::cost::solver_comparison::{ComparisonOutcome, ComparisonRun, ComparisonTask};
use crate::error::CalibrationError;
use crate::problem::definition::{ModelFile, Problem};
use crate::problem::settings::SimulationSettings;
use base::RunContext;
use dfo::RobustLoss;
use fmi::worker::{AskedProcess, Frame, Isolation, Load, WorkerLimits, Workers};
use fmi::{FmiError, Fmu, OpenOptions, SimulateOptions, Trajectory};
use ode::{Method, Stats};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Data of a calibration that a worker loads.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Loaded {
    pub(crate) problem: Problem,
    pub(crate) options: OpenOptions,
}

/// Request to a worker.
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
    /// A simulation of a comparison of methods.
    SolverComparison(ComparisonTask),
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
    pub(crate) cost: Result<f64, ReportedCostFailure>,
    pub(crate) stats: Stats,
}

/// A simulation of a comparison; its samples and then its residuals are the numbers of the frame.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Compared {
    /// Without its samples.
    pub(crate) outcome: ComparisonOutcome,
    /// Statistics of all its simulations.
    pub(crate) stats: Stats,
    /// Number of residuals.
    pub(crate) at_start: Option<usize>,
}

/// How a point is evaluated.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evaluation {
    pub(crate) method: Method,
    /// Where it is not that of the problem.
    pub(crate) accuracy: Option<Accuracy>,
    pub(crate) process: ProcessChoice,
}

/// Process that answers a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ProcessChoice {
    /// Any that has loaded the problem.
    Any,
    /// The same, but the second question of this kind is asked in a new process, too, and the first one again
    /// after some of the later ones, to see whether the answers are the same.
    Checked,
    /// A new one.
    Fresh,
}

/// Message where the answers depend on earlier requests to a process.
pub(crate) const HIDDEN_STATE: &str = "a cost depends on what ran before it in the same process (a state that the model keeps and no variable shows): each \
                                       evaluation has a process of its own";

/// Worker processes that have loaded the same.
#[derive(Debug)]
struct Processes {
    fmu: Fmu,
    workers: Arc<Workers>,
    load: Load,
    /// No answer is checked for its dependence on earlier requests.
    is_checked: AtomicBool,
    /// The result of a fit was compared with a fresh process.
    is_compared: AtomicBool,
    /// Questions that were to be checked.
    n_checked: AtomicU64,
    /// The first of them, and the numbers of its answer.
    first: Mutex<Option<(Frame, Vec<f64>)>>,
    /// Frames that were used before.
    frames: Mutex<Vec<(Frame, Frame)>>,
}

impl Processes {
    /// Nothing is loaded yet.
    fn new(fmu: &Fmu, limits: WorkerLimits, load: Job, lender: Option<&Load>) -> Result<Self, FmiError> {
        let workers =
            fmu.workers(limits).ok_or_else(|| FmiError::NoWorker { reason: NO_LAUNCHER.to_owned() })?;
        let load = Load::new(move || Frame::of(&load));
        let load = lender.into_iter().fold(load, Load::in_processes_of);
        workers.prepare(&load);
        Ok(Self {
            fmu: fmu.clone(),
            workers,
            load,
            is_checked: AtomicBool::new(false),
            is_compared: AtomicBool::new(false),
            n_checked: AtomicU64::new(0),
            first: Mutex::default(),
            frames: Mutex::default(),
        })
    }

    /// Asks a worker, and hands its answer to `use_answer`. `limit`: of a single simulation.
    fn ask<T>(
        &self,
        job: &Job,
        process: ProcessChoice,
        limit: Option<Duration>,
        context: &RunContext<'_>,
        use_answer: impl FnOnce(&mut Frame) -> std::io::Result<T>,
    ) -> Result<T, FmiError> {
        let frames = || self.frames.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut asked, mut answer) = frames().pop().unwrap_or_default();
        asked.set_head(job).map_err(unsaid)?;
        let whom = match process {
            _ if self.fmu.has_hidden_state() => Some(AskedProcess::FreshOnce),
            ProcessChoice::Fresh => Some(AskedProcess::Fresh),
            ProcessChoice::Checked if !self.is_checked.load(Ordering::Relaxed) => None,
            ProcessChoice::Any | ProcessChoice::Checked => Some(AskedProcess::Any),
        };
        match whom {
            Some(whom) => self.call(&asked, &mut answer, whom, limit, context)?,
            None => self.ask_checked(&asked, &mut answer, limit, context)?,
        }
        let used = use_answer(&mut answer).map_err(unsaid);
        frames().push((asked, answer));
        used
    }

    fn call(
        &self,
        asked: &Frame,
        answer: &mut Frame,
        whom: AskedProcess,
        limit: Option<Duration>,
        context: &RunContext<'_>,
    ) -> Result<(), FmiError> {
        let quirks = self.workers.call(&self.load, asked, answer, context, limit, whom)?;
        self.fmu.add_quirks(quirks);
        Ok(())
    }

    /// Asks a worker. The second question also asks a fresh one, at the same time; the 4th, 8th, 16th and so
    /// on ask the first one again. Where numbers differ, and two fresh processes agree, each question has one
    /// of its own from now on.
    fn ask_checked(
        &self,
        asked: &Frame,
        answer: &mut Frame,
        limit: Option<Duration>,
        context: &RunContext<'_>,
    ) -> Result<(), FmiError> {
        let known = || self.first.lock().unwrap_or_else(PoisonError::into_inner);
        let first = known().clone();
        let Some((first, numbers)) = first else {
            self.call(asked, answer, AskedProcess::Any, limit, context)?;
            known().get_or_insert_with(|| (asked.clone(), answer.numbers.clone()));
            return Ok(());
        };
        let is_first = first == *asked;
        let n = if is_first { 1 } else { self.n_checked.fetch_add(1, Ordering::Relaxed) + 2 };
        if !n.is_power_of_two() {
            return self.call(asked, answer, AskedProcess::Any, limit, context);
        }
        let mut again = Frame::default();
        let in_fresh = |context: &RunContext<'_>| {
            let mut answer = Frame::default();
            self.call(asked, &mut answer, AskedProcess::Fresh, limit, context).map(|()| answer)
        };
        let mut in_used = || {
            self.call(asked, answer, AskedProcess::Any, limit, context)?;
            match !is_first && n > 2 {
                true => self.call(&first, &mut again, AskedProcess::Any, limit, context),
                false => Ok(()),
            }
        };
        let (own, fresh) = match n {
            2 => beside(context, in_fresh, in_used),
            _ => (in_used(), None),
        };
        own?;
        let again = if is_first { &*answer } else { &again };
        let is_first_same = *again == Frame::default() || has_same_bits(&again.numbers, &numbers);
        let fresh = match fresh {
            Some(Ok(fresh)) if is_first_same && has_same_bits(&fresh.numbers, &answer.numbers) => {
                return Ok(());
            }
            Some(Ok(fresh)) => fresh,
            None if !is_first_same => in_fresh(context)?,
            _ => return Ok(()),
        };
        self.call(asked, answer, AskedProcess::Fresh, limit, context)?;
        let model = &self.fmu.description().model_name;
        if has_same_bits(&fresh.numbers, &answer.numbers) {
            log::warn!("{model}: {HIDDEN_STATE}");
            self.fmu.note_hidden_state();
        } else {
            log::warn!(
                "{model}: the same simulation in two fresh processes differs: nothing can be reproduced"
            );
        }
        Ok(())
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        self.workers.forget(&self.load);
    }
}

fn has_same_bits(one: &[f64], other: &[f64]) -> bool {
    one.iter().map(|x| x.to_bits()).eq(other.iter().map(|x| x.to_bits()))
}

/// The worker processes of a calibration.
#[derive(Debug)]
pub(crate) struct Remote {
    processes: Processes,
    /// The limit of a single simulation.
    run_limit: Option<Duration>,
}

impl Remote {
    /// The processes for a problem, those of another one where they are lent; or why its model runs in this
    /// one; `None`: that was asked for.
    pub(crate) fn of(fmu: &Fmu, problem: &Problem, lender: Option<&Self>) -> Result<Self, Option<String>> {
        let settings = &problem.settings;
        if settings.isolation == Isolation::None || fmu.is_absent() {
            return Err(None);
        }
        if let Some(input) = problem.experiments.iter().find_map(|experiment| experiment.driven_by_function())
        {
            return Err(Some(format!("the input {input} is a function of this program")));
        }
        let limits = settings.worker_limits();
        // Where it is now, in this process no further process is started.
        let model = ModelFile::of(fmu).map_err(|error| Some(error.to_string()))?;
        let settings = SimulationSettings { isolation: Isolation::None, ..settings.clone() };
        let problem = Problem { model, settings, ..problem.clone() };
        let run_limit = problem.settings.run.timeout;
        let load = Job::Load(Box::new(Loaded { problem, options: fmu.options().clone() }));
        let lender = lender.map(|lender| &lender.processes.load);
        let processes = Processes::new(fmu, limits, load, lender).map_err(|error| match error {
            FmiError::NoWorker { reason } => Some(reason),
            error => Some(error.to_string()),
        })?;
        Ok(Self { processes, run_limit })
    }

    /// A fit evaluates its best point in a fresh process: its evaluations need no check of their own.
    pub(crate) fn set_checked(&self) {
        self.processes.is_checked.store(true, Ordering::Relaxed);
    }

    /// Has a process started that will be needed for a fit: beside that which searches, or at its end.
    pub(crate) fn prepare_second(&self) {
        self.processes.workers.prepare_second(&self.processes.load);
    }

    /// True if the result of an earlier fit was compared with a fresh process.
    pub(crate) fn is_compared(&self) -> bool {
        self.processes.is_compared.load(Ordering::Relaxed)
    }

    /// The result of a fit has been compared with a fresh process.
    pub(crate) fn set_compared(&self) {
        self.processes.is_compared.store(true, Ordering::Relaxed);
    }

    fn ask<T>(
        &self,
        job: &Job,
        process: ProcessChoice,
        context: &RunContext<'_>,
        use_answer: impl FnOnce(&mut Frame) -> std::io::Result<T>,
    ) -> Result<T, FmiError> {
        self.processes.ask(job, process, self.run_limit, context, use_answer)
    }

    /// The cost at a point, its residuals into `out`; see
    /// [`LoadedProblem::evaluate`](crate::cost::loaded_problem::LoadedProblem::evaluate).
    pub(crate) fn evaluate(
        &self,
        x: &[f64],
        evaluation: Evaluation,
        rule: CostRule<'_>,
        out: &mut [f64],
        stats: &mut Stats,
    ) -> Result<f64, CostFailure> {
        let CostRule { loss, cutoff, context } = rule;
        let Evaluation { method, accuracy, process } = evaluation;
        let job = Job::Evaluate { x: x.to_vec(), method, loss, cutoff, accuracy };
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
        let mut evaluated = self.ask(&job, process, &context, &mut use_answer);
        if process != ProcessChoice::Fresh && matches!(&evaluated, Ok((Err(told), _)) if told.is_of_process())
        {
            // A process that was used before may have lost what it needs.
            if let Ok((Ok(cost), stats)) = self.ask(&job, ProcessChoice::Fresh, &context, &mut use_answer) {
                evaluated = Ok((Ok(cost), stats));
            }
        }
        let (cost, taken) = evaluated.map_err(CostFailure::of_worker)?;
        *stats += taken;
        cost.map_err(CostFailure::from)
    }

    /// A simulation of a comparison, and the residuals at the start.
    pub(crate) fn compare(
        &self,
        task: ComparisonTask,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> Result<ComparisonRun, CalibrationError> {
        let compared = self.ask(&Job::SolverComparison(task), ProcessChoice::Any, context, |answer| {
            let compared: Compared = answer.head()?;
            Ok((compared, std::mem::take(&mut answer.numbers)))
        });
        let (Compared { mut outcome, stats: taken, at_start }, mut numbers) = match compared {
            Ok(compared) => compared,
            Err(error) => {
                return Ok((
                    ComparisonOutcome::Failed(CostFailure::of_worker(error).of_point()?.reason),
                    None,
                ));
            }
        };
        *stats += taken;
        let at_start = at_start.map(|n| numbers.split_off(numbers.len().saturating_sub(n)));
        if let ComparisonOutcome::Finished { samples, .. } = &mut outcome {
            *samples = numbers;
        }
        Ok((outcome, at_start))
    }

    /// A recorded simulation.
    pub(crate) fn trajectory(
        &self,
        job: &Job,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, CalibrationError> {
        let trajectory = self.ask(job, ProcessChoice::Checked, context, trajectory_of);
        trajectory.map_err(|error| match error {
            FmiError::Cancelled => CalibrationError::Cancelled,
            error => error.into(),
        })
    }
}

/// A model that is simulated in processes of its own.
#[derive(Debug)]
pub struct ModelProcess {
    processes: Processes,
}

impl ModelProcess {
    /// Nothing is loaded yet.
    ///
    /// # Errors
    /// The file of the model cannot be read any more; [`FmiError::NoWorker`]: this program cannot start
    /// processes for it.
    pub fn new(fmu: &Fmu, limits: WorkerLimits) -> Result<Self, FmiError> {
        let open = Job::Open(ModelFile::of(fmu)?, Box::new(fmu.options().clone()));
        Ok(Self { processes: Processes::new(fmu, limits, open, None)? })
    }

    /// As [`Fmu::simulate_with`], with the same bits. The context ends it. The second simulation is also made
    /// in a new process, at the same time; where that gives others, each one has a new process from then on.
    ///
    /// # Errors
    /// As [`Fmu::simulate`]; [`FmiError::WorkerEnded`]; [`FmiError::Cancelled`]; inputs that are functions.
    pub fn simulate(
        &self,
        options: &SimulateOptions,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, FmiError> {
        if let Some(input) = options.inputs.as_ref().and_then(|inputs| inputs.driven_by_function()) {
            let problem =
                format!("the input {input} is a function of this program, which no other process can call");
            return Err(FmiError::BadSetting(problem));
        }
        let job = Job::Simulate(Box::new(options.clone()));
        self.processes.ask(&job, ProcessChoice::Checked, options.run.timeout, context, trajectory_of)
    }
}

const NO_LAUNCHER: &str = "this program cannot start processes for it (worker::serve_if_worker)";

fn unsaid(error: std::io::Error) -> FmiError {
    FmiError::BadSetting(error.to_string())
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
