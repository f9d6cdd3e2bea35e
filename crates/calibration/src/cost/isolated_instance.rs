//! Instance that is controlled call by call, in a separate worker process or in this process.

use crate::cost::process::{with_hint, workers_of};
use crate::cost::request::{Job, unsaid};
use crate::problem::definition::ModelFile;
use base::RunContext;
use fmi::worker::{AnswerLimits, Frame, Load, PinnedProcess, Question, WorkerLimits};
use fmi::{DrivenInstance, FmiError, Fmu, InstanceAnswer, InstanceCall, InstanceOptions, InterfaceKind};
use std::sync::Arc;
use std::time::Duration;

const LOST: &str = "the instance was lost with its process. Create a new instance";
const INTERRUPTED: &str = "the instance was freed because a call was interrupted. Create a new instance";
const FORKED: &str =
    "the instance belongs to the parent process of this fork. Create one instance in each process";

/// Maximum wait for an unused instance to be freed.
const LONGEST_END: Duration = Duration::from_secs(1);

/// Instance that is controlled call by call, in a separate worker process or in this process.
#[derive(Debug)]
pub struct IsolatedInstance {
    fmu: Fmu,
    place: Place,
    /// Frames of the last call, whose memory is reused.
    frames: (Frame, Frame),
}

/// Location of the instance.
#[derive(Debug)]
enum Place {
    Worker(Box<PinnedProcess>),
    Here(DrivenInstance),
}

impl IsolatedInstance {
    /// Creates an instance in this process. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// Returns the errors of [`Fmu::instantiate`].
    pub fn here(fmu: &Fmu, kind: InterfaceKind, options: &InstanceOptions) -> Result<Self, FmiError> {
        let place = Place::Here(DrivenInstance::new(fmu, kind, options)?);
        Ok(Self { fmu: fmu.clone(), place, frames: Default::default() })
    }

    /// Creates an instance in a separate worker process.
    ///
    /// # Errors
    /// Returns the errors of [`here`](Self::here) and [`ModelProcess::new`](crate::ModelProcess::new),
    /// [`FmiError::WorkerEnded`] and [`FmiError::Cancelled`].
    pub fn in_worker(
        fmu: &Fmu,
        kind: InterfaceKind,
        options: &InstanceOptions,
        context: &RunContext<'_>,
    ) -> Result<Self, FmiError> {
        let workers = workers_of(fmu, WorkerLimits::default())?;
        let open = Arc::new(Job::Open(ModelFile::of(fmu)?, Box::new(fmu.options().clone())));
        fmu.note_needed_tool();
        let process = workers.pinned(&Load::new(move || Frame::of(&*open)), context)?;
        let mut instance =
            Self { fmu: fmu.clone(), place: Place::Worker(Box::new(process)), frames: Default::default() };
        let new = Job::NewInstance(kind, Box::new(options.clone()));
        match instance.ask(&new, &[], &mut Vec::new(), None, context) {
            Ok(_) => Ok(instance),
            Err(error) => {
                instance.free(LOST);
                Err(error)
            }
        }
    }

    /// Calls the instance as [`DrivenInstance::call`] does, with bit-for-bit identical results. The context
    /// can end the process of a call that does not return.
    ///
    /// # Errors
    /// Returns the errors of [`DrivenInstance::call`]. Returns [`FmiError::WorkerEnded`] if the process
    /// ended. The instance is then lost, and each later call returns [`FmiError::Freed`]. Also returns
    /// [`FmiError::Cancelled`].
    pub fn call(
        &mut self,
        call: InstanceCall,
        given: &[f64],
        vector: &mut Vec<f64>,
        context: &RunContext<'_>,
    ) -> Result<InstanceAnswer, FmiError> {
        match &mut self.place {
            Place::Here(instance) => instance.call(call, given, vector, context),
            Place::Worker(_) => self.ask(&Job::Instance(call), given, vector, None, context),
        }
    }

    /// Frees the instance after an interrupted call and ends its process.
    pub fn interrupt(&mut self) {
        self.free(INTERRUPTED);
    }

    /// Frees the instance and ends its process. A crash during this is logged.
    pub fn close(&mut self, context: &RunContext<'_>) {
        self.close_within(None, context);
    }

    fn close_within(&mut self, limit: Option<Duration>, context: &RunContext<'_>) {
        if let Place::Worker(process) = &self.place
            && process.is_child()
        {
            let close = Job::Instance(InstanceCall::Close);
            if let Err(error) = self.ask(&close, &[], &mut Vec::new(), limit, context) {
                log::info!("{}: an instance was not freed: {error}", self.fmu.description().model_name);
            }
        }
        self.free(DrivenInstance::CLOSED);
    }

    fn free(&mut self, reason: &'static str) {
        self.place = Place::Here(DrivenInstance::freed(reason));
    }

    /// Sends a job to the process. The instance is lost if the process ends.
    fn ask(
        &mut self,
        job: &Job,
        given: &[f64],
        vector: &mut Vec<f64>,
        limit: Option<Duration>,
        context: &RunContext<'_>,
    ) -> Result<InstanceAnswer, FmiError> {
        let Place::Worker(process) = &mut self.place else { return Err(FmiError::Freed(LOST)) };
        if !process.is_child() {
            return Err(FmiError::Freed(FORKED));
        }
        let (requested, answer) = &mut self.frames;
        requested.set_head(job).map_err(unsaid)?;
        requested.numbers.clear();
        requested.numbers.extend_from_slice(given);
        let limits = AnswerLimits { run: limit, runs: 0, size: process.limits().answer_size() };
        let question = Question { requested, context, limits, is_repetition: false };
        let reported = process.call(&question, answer, &mut |answer| {
            std::mem::swap(vector, &mut answer.numbers);
            answer.head()
        });
        if process.has_ended() {
            self.free(LOST);
        }
        let (answer, quirks) = reported.map_err(|error| with_hint(&self.fmu, error))?;
        self.fmu.add_quirks(quirks);
        Ok(answer)
    }
}

impl Drop for IsolatedInstance {
    fn drop(&mut self) {
        self.close_within(Some(LONGEST_END), &RunContext::new());
    }
}
