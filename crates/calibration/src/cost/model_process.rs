//! A model of which single simulations are made in worker processes, and values asked for.

use crate::cost::process::{Job, ProcessChoice, Processes, wrong};
use crate::problem::definition::ModelFile;
use base::RunContext;
use fmi::worker::{AnswerLimits, Frame, WorkerLimits};
use fmi::{FmiError, Fmu, InterfaceChoice, SimulateOptions, Trajectory, Value};

/// A model that is simulated in processes of its own.
#[derive(Debug)]
pub struct ModelProcess {
    processes: Processes,
}

impl ModelProcess {
    /// Limits of its processes.
    pub fn limits(&self) -> &WorkerLimits {
        self.processes.workers.limits()
    }

    /// Nothing is loaded yet.
    ///
    /// # Errors
    /// The file of the model cannot be read any more; [`FmiError::NoWorker`]: this program cannot start
    /// processes for it; [`FmiError::NoSandbox`]: not confined ones.
    pub fn new(fmu: &Fmu, limits: WorkerLimits) -> Result<Self, FmiError> {
        let open = Job::Open(ModelFile::of(fmu)?, Box::new(fmu.options().clone()));
        Ok(Self { processes: Processes::new(fmu, limits, open, None)? })
    }

    /// As [`Fmu::simulate_with`], with the same bits. The context ends it. The second simulation is also made
    /// in a new process, at the same time; where that gives others, each one has a new process from then on.
    ///
    /// # Errors
    /// As [`Fmu::simulate`]; [`FmiError::WorkerEnded`]; [`FmiError::Cancelled`].
    pub fn simulate(
        &self,
        options: &SimulateOptions,
        context: &RunContext<'_>,
    ) -> Result<Trajectory, FmiError> {
        let job = Job::Simulate(Box::new(options.clone()));
        let size = self.processes.workers.limits().answer_size();
        let limits = AnswerLimits { run: options.run.timeout, runs: 1, size };
        self.processes.trajectory(&job, limits, None, context)
    }

    /// Values of variables at the end of a simulation: of the last one if it had these options, else it is
    /// made again.
    ///
    /// # Errors
    /// As [`simulate`](Self::simulate); unknown names.
    pub fn final_values(
        &self,
        options: &SimulateOptions,
        names: &[String],
        context: &RunContext<'_>,
    ) -> Result<Vec<Value>, FmiError> {
        self.values(Job::FinalValues(Box::new(options.clone()), names.to_vec()), names.len(), context)
    }

    /// Values of variables after the initialization with these values set.
    ///
    /// # Errors
    /// As [`Session::get`](fmi::Session::get); [`FmiError::WorkerEnded`]; [`FmiError::Cancelled`].
    pub fn initial_values(
        &self,
        kind: InterfaceChoice,
        set: Vec<(String, Value)>,
        names: &[String],
        context: &RunContext<'_>,
    ) -> Result<Vec<Value>, FmiError> {
        let job = Job::InitialValues { kind, set, names: names.to_vec() };
        self.values(job, names.len(), context)
    }

    fn values(&self, job: Job, n: usize, context: &RunContext<'_>) -> Result<Vec<Value>, FmiError> {
        let size = self.processes.workers.limits().answer_size();
        let limits = AnswerLimits { run: None, runs: 1, size };
        let mut accept = |answer: &mut Frame| match answer.head::<Vec<Value>>()? {
            values if values.len() == n => Ok(values),
            values => Err(wrong(format!("{} values instead of {n}", values.len()))),
        };
        self.processes.ask(&job, ProcessChoice::Any, limits, context, &mut accept)
    }
}
