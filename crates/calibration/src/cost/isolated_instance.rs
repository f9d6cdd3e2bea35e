//! An instance that is driven call by call, in a worker process of its own or in this process.

use crate::cost::process::{Job, unsaid, with_hint, workers_of};
use crate::problem::definition::ModelFile;
use base::RunContext;
use fmi::worker::{AnswerLimits, Frame, Load, PinnedProcess, Question, WorkerLimits};
use fmi::{DrivenInstance, FmiError, Fmu, InstanceAnswer, InstanceCall, InstanceOptions, InterfaceKind};
use std::sync::Arc;
use std::time::Duration;

const LOST: &str = "the instance was lost with its process: make another one";
const INTERRUPTED: &str = "the instance was freed when a call into it was interrupted: make another one";
const FORKED: &str =
    "the instance belongs to the process that this one was forked from: make one in each process";

/// Limit of the wait for an instance that is freed because nobody uses it any more.
const LONGEST_END: Duration = Duration::from_secs(1);

/// An instance that is driven call by call, in a worker process of its own or in this process.
#[derive(Debug)]
pub struct IsolatedInstance {
    fmu: Fmu,
    place: Place,
    /// Frames of the last call: their memory is used again.
    frames: (Frame, Frame),
}

/// Place where the instance lives.
#[derive(Debug)]
enum Place {
    Worker(Box<PinnedProcess>),
    Here(DrivenInstance),
}

impl IsolatedInstance {
    /// Makes an instance in this process. **This loads the library and runs its code.**
    ///
    /// # Errors
    /// As [`Fmu::instantiate`].
    pub fn here(fmu: &Fmu, kind: InterfaceKind, options: &InstanceOptions) -> Result<Self, FmiError> {
        let place = Place::Here(DrivenInstance::new(fmu, kind, options)?);
        Ok(Self { fmu: fmu.clone(), place, frames: Default::default() })
    }

    /// Makes an instance in a worker process of its own.
    ///
    /// # Errors
    /// As [`here`](Self::here) and [`ModelProcess::new`](crate::ModelProcess::new);
    /// [`FmiError::WorkerEnded`]; [`FmiError::Cancelled`].
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

    /// As [`DrivenInstance::call`], with the same bits. The context ends the process of a call that does not
    /// return.
    ///
    /// # Errors
    /// As [`DrivenInstance::call`]; [`FmiError::WorkerEnded`]: the instance is lost then, and each later call
    /// is [`FmiError::Freed`]; [`FmiError::Cancelled`].
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

    /// Frees the instance after a call that was interrupted; its process ends.
    pub fn interrupt(&mut self) {
        self.free(INTERRUPTED);
    }

    /// Frees the instance and ends its process. A crash while it is freed is logged.
    pub fn close(&mut self, context: &RunContext<'_>) {
        self.close_within(None, context);
    }

    fn close_within(&mut self, limit: Option<Duration>, context: &RunContext<'_>) {
        if let Place::Worker(process) = &self.place
            && process.is_own()
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

    /// Sends a job to the process; the instance is lost where that ends.
    fn ask(
        &mut self,
        job: &Job,
        given: &[f64],
        vector: &mut Vec<f64>,
        limit: Option<Duration>,
        context: &RunContext<'_>,
    ) -> Result<InstanceAnswer, FmiError> {
        let Place::Worker(process) = &mut self.place else { return Err(FmiError::Freed(LOST)) };
        if !process.is_own() {
            return Err(FmiError::Freed(FORKED));
        }
        let (asked, answer) = &mut self.frames;
        asked.set_head(job).map_err(unsaid)?;
        asked.numbers.clear();
        asked.numbers.extend_from_slice(given);
        let limits = AnswerLimits { run: limit, runs: 0, size: process.limits().answer_size() };
        let question = Question { asked, context, limits, is_repetition: false };
        let told = process.call(&question, answer, &mut |answer| {
            std::mem::swap(vector, &mut answer.numbers);
            answer.head()
        });
        if process.has_ended() {
            self.free(LOST);
        }
        let (answer, quirks) = told.map_err(|error| with_hint(&self.fmu, error))?;
        self.fmu.add_quirks(quirks);
        Ok(answer)
    }
}

impl Drop for IsolatedInstance {
    fn drop(&mut self) {
        self.close_within(Some(LONGEST_END), &RunContext::new());
    }
}
