//! The worker process of a calibration, which loads the model and runs the requested simulations.

use crate::cost::failure::ReportedCostFailure;
use crate::cost::request::{Evaluated, Job, Loaded, put_trajectory, unsaid};
use crate::cost::residual::CostRule;
use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::problem::definition::ModelFile;
use base::RunContext;
use fmi::description::Quirk;
use fmi::worker::{Frame, Service};
use fmi::{DrivenInstance, FmiError, Fmu, InstanceAnswer, OpenOptions, Reuse, Session, Value};
use log::LevelFilter;
use ode::Stats;
use std::io;
use std::ops::ControlFlow;

/// Runs the worker process if this process was started as one; the process then ends in this function when it
/// is no longer needed. Otherwise returns immediately. From then on, this program starts itself for the
/// processes in which FMUs run.
///
/// Call this function at the beginning of `main`, before other threads are started. A program must call it,
/// or specify another program that does (see [`Launcher`](fmi::worker::Launcher)). Otherwise FMUs run in the
/// process of the program.
pub fn serve_if_worker() {
    fmi::worker::serve_if_worker(|| Box::new(Server::default()));
}

#[derive(Default)]
struct Server {
    /// The most recently opened model, with its session.
    model: Option<(ModelFile, Session)>,
    calibration: Option<Calibration>,
    /// The instance that is driven step by step.
    instance: Option<DrivenInstance>,
    /// Statistics of an evaluation that will be repeated.
    repeated: Stats,
    n_quirks: usize,
}

impl Server {
    /// Opens the model of a file and checks its content.
    fn open(&mut self, model: ModelFile, options: &OpenOptions) -> Result<Fmu, CalibrationError> {
        if let Some((loaded, session)) = &self.model
            && *loaded == model
            && session.fmu().options() == options
        {
            return Ok(session.fmu().clone());
        }
        (self.model, self.n_quirks) = (None, 0);
        let fmu = Fmu::open_with(&model.path, options)?;
        model.check(&fmu)?;
        // The next simulation reports the error.
        let _ = fmu.unpack_for_copies();
        self.model = Some((model, Session::new(fmu.clone())));
        Ok(fmu)
    }

    fn session(&mut self) -> Result<&mut Session, FmiError> {
        self.model.as_mut().map(|(_, session)| session).ok_or_else(not_loaded)
    }

    fn fmu(&self) -> Option<&Fmu> {
        self.model.as_ref().map(|(_, session)| session.fmu())
    }

    fn load(&mut self, Loaded { problem, options }: Loaded) -> Result<(), CalibrationError> {
        self.calibration = None;
        let fmu = self.open(problem.model.clone(), &options)?;
        // The process that created the problem has logged its warnings.
        let level = log::max_level();
        log::set_max_level(LevelFilter::Off);
        let calibration = Calibration::from_problem(fmu, problem);
        log::set_max_level(level);
        self.calibration = Some(calibration?);
        Ok(())
    }
}

impl Server {
    fn respond(
        &mut self,
        requested: &Frame,
        context: &RunContext<'_>,
        answer: &mut Frame,
    ) -> Result<(), FmiError> {
        match requested.head::<Job>().map_err(unsaid)? {
            Job::Load(loaded) => self.load(*loaded).map_err(model_error)?,
            Job::Open(model, options) => drop(self.open(model, &options).map_err(model_error)?),
            Job::Simulate(options) => {
                let trajectory = self.session()?.simulate_with(&options, &mut until(context))?;
                put_trajectory(trajectory, answer).map_err(unsaid)?;
            }
            Job::FinalValues(options, names) => {
                let values = self.session()?.final_values(&options, &names, &mut until(context))?;
                answer.set_head(&values).map_err(unsaid)?;
            }
            Job::InitialValues { kind, set, names } => {
                let mut session = Session::of_kind(self.session()?.fmu().clone(), kind);
                session.set_all(set.iter().map(|(name, value)| (name.as_str(), value.clone())))?;
                let values: Result<Vec<Value>, FmiError> =
                    names.iter().map(|name| session.get(name)).collect();
                answer.set_head(&values?).map_err(unsaid)?;
            }
            Job::NewInstance(kind, options) => {
                self.instance = Some(DrivenInstance::new(self.session()?.fmu(), kind, &options)?);
                answer.set_head(&InstanceAnswer::Done).map_err(unsaid)?;
            }
            Job::Instance(call) => {
                let instance = self.instance.as_mut().ok_or_else(not_loaded)?;
                let done = instance.call(call, &requested.numbers, &mut answer.numbers, context)?;
                answer.set_head(&done).map_err(unsaid)?;
            }
            job => {
                let calibration = self.calibration.as_ref().ok_or_else(not_loaded)?;
                done(calibration, job, &mut self.repeated, context, answer)?.map_err(unsaid)?;
            }
        }
        Ok(())
    }
}

impl Service for Server {
    fn answer(
        &mut self,
        requested: &Frame,
        context: &RunContext<'_>,
        answer: &mut Frame,
    ) -> Result<(), FmiError> {
        if let Some(fmu) = self.fmu() {
            fmu.set_reuse(if requested.needs_new_instance { Reuse::Reinstantiate } else { Reuse::Reset });
        }
        let outcome = self.respond(requested, context, answer);
        let is_repeated = self.fmu().is_some_and(Fmu::take_repetition);
        if is_repeated && !context.is_over() {
            answer.clear();
            answer.is_repeated = true;
            return Ok(());
        }
        self.repeated = Stats::default();
        outcome
    }

    fn provide_files(&mut self) {
        if let Some(fmu) = self.fmu() {
            // The next simulation reports the error.
            let _ = fmu.provide_libraries();
        }
    }

    fn prepare(&mut self) {
        if let Some(calibration) = &self.calibration {
            // The next simulation reports the error.
            let _ = calibration.prepare();
        }
    }

    fn new_quirks(&mut self) -> Vec<Quirk> {
        let Some(fmu) = self.fmu() else { return Vec::new() };
        let mut seen = fmu.quirks_seen();
        let new = seen.split_off(self.n_quirks.min(seen.len()));
        self.n_quirks += new.len();
        new
    }
}

/// Returns a callback that stops a simulation when the context has ended.
fn until(context: &RunContext<'_>) -> impl FnMut() -> ControlFlow<()> {
    || if context.is_over() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

fn not_loaded() -> FmiError {
    let problem = "a worker process was asked before it had loaded anything".to_owned();
    FmiError::BadSetting(problem)
}

/// Runs a job and writes its result to `answer`.
fn done(
    calibration: &Calibration,
    job: Job,
    repeated: &mut Stats,
    context: &RunContext<'_>,
    answer: &mut Frame,
) -> Result<io::Result<()>, FmiError> {
    Ok(match job {
        Job::Load(_)
        | Job::Open(..)
        | Job::Simulate(_)
        | Job::FinalValues(..)
        | Job::NewInstance(..)
        | Job::Instance(_)
        | Job::InitialValues { .. } => Ok(()),
        Job::Evaluate { x, loss, cutoff, accuracy, recording } => {
            calibration.check_length(&x).map_err(model_error)?;
            let (rule, mut stats) = (CostRule { loss, cutoff, context: *context }, *repeated);
            let cost = match recording {
                None => {
                    answer.numbers.resize(calibration.n_values(), 0.0);
                    calibration.evaluate_with(accuracy, &x, rule, &mut answer.numbers, &mut stats)
                }
                Some(k) => {
                    answer.numbers.resize(calibration.n_values_of(k).map_err(model_error)?, 0.0);
                    calibration.evaluate_recording(k, &x, rule, &mut answer.numbers, &mut stats)
                }
            };
            if cost.is_err() {
                answer.numbers.clear();
            }
            let cost = cost.map_err(ReportedCostFailure::from);
            answer.is_last |= cost.as_ref().is_err_and(ReportedCostFailure::is_of_process);
            *repeated = stats;
            answer.set_head(&Evaluated { cost, stats })
        }
        Job::Experiment { experiment, x, times } => {
            let trajectory = calibration.simulate_experiment(experiment, &x, times.as_deref(), context);
            put_trajectory(trajectory.map_err(model_error)?, answer)
        }
        Job::Variables { experiment, x, times, variables } => {
            let trajectory =
                calibration.simulate_variables(experiment, &x, times.as_deref(), &variables, context);
            put_trajectory(trajectory.map_err(model_error)?, answer)
        }
    })
}

/// Converts an error for the process that sent the request.
fn model_error(error: CalibrationError) -> FmiError {
    match error {
        CalibrationError::Model(error) => error,
        CalibrationError::Cancelled => FmiError::Cancelled,
        other => FmiError::BadSetting(other.to_string()),
    }
}
