//! Model for single simulations in worker processes, and for queries of values.

use crate::cost::comparison::ProcessChoice;
use crate::cost::process::Processes;
use crate::cost::request::{Job, wrong};
use crate::problem::definition::ModelFile;
use base::RunContext;
use fmi::worker::{AnswerLimits, Frame, WorkerLimits};
use fmi::{FmiError, Fmu, InterfaceChoice, SimulateOptions, Trajectory, Value};

/// Model that is simulated in separate processes.
#[derive(Debug)]
pub struct ModelProcess {
    processes: Processes,
}

impl ModelProcess {
    /// Returns the limits of the processes.
    pub fn limits(&self) -> &WorkerLimits {
        self.processes.workers.limits()
    }

    /// Prepares the processes of a model.
    ///
    /// # Errors
    /// Returns an error if the file of the model cannot be read. Returns [`FmiError::NoWorker`] if this
    /// program cannot start processes for it, or [`FmiError::NoSandbox`] if it cannot start confined ones.
    pub fn new(fmu: &Fmu, limits: WorkerLimits) -> Result<Self, FmiError> {
        let open = Job::Open(ModelFile::of(fmu)?, Box::new(fmu.options().clone()));
        Ok(Self { processes: Processes::new(fmu, limits, open, None)? })
    }

    /// Simulates the model as [`Fmu::simulate_with`] does, with bit-for-bit identical results. The context
    /// can end the simulation. Some answers of used processes are compared with answers of fresh processes.
    /// If they differ, the next simulations use a new instance, or a new process if that is not sufficient.
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::simulate`], [`FmiError::WorkerEnded`] and [`FmiError::Cancelled`].
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

    /// Returns the values of variables at the end of a simulation. Repeats the simulation unless the last one
    /// had the same options.
    ///
    /// # Errors
    /// Returns the errors of [`simulate`](Self::simulate), and an error for unknown names.
    pub fn final_values(
        &self,
        options: &SimulateOptions,
        names: &[String],
        context: &RunContext<'_>,
    ) -> Result<Vec<Value>, FmiError> {
        self.values(Job::FinalValues(Box::new(options.clone()), names.to_vec()), names.len(), context)
    }

    /// Returns the values of variables after an initialization with these values set.
    ///
    /// # Errors
    /// Returns the errors of [`Session::get`](fmi::Session::get), [`FmiError::WorkerEnded`] and
    /// [`FmiError::Cancelled`].
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
