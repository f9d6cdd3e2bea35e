//! Co-simulation: the loop over communication points, which delivers the same samples as the integration of a model.
//! Which points these are says [`Communication`].

mod run;
mod samples;

use crate::beginning::{Start, StartValues};
use crate::clocks::{ClockState, Tick};
use crate::description::Variable;
use crate::digest::Digest;
use crate::error::FmiError;
use crate::input::InputState;
use crate::instance::{CoSimulation, Core, Initialization, Instance, StepMode};
use crate::outputs::OutputBuffers;
use crate::plan::SimulationPlan;
use crate::sys::RawInstance;
use ode::{ErrorKind, EventOutcome, Limits, Observer, Report, Seconds, SimulationError, Stats, Stopwatch};
use run::{Call, Exit, Run};
use std::sync::Arc;
use std::time::Instant;

/// What a run has of its FMU at the moment.
#[derive(Debug)]
enum Mode {
    /// Nothing: none was made yet, or it broke.
    Gone,
    /// An instance with a past, to be reset before its next use.
    Spare(RawInstance),
    Stepping(Instance<StepMode, CoSimulation>),
}

/// One worker's co-simulation: the instance and everything that is written during a run.
#[derive(Debug)]
pub(crate) struct Stepping {
    plan: Arc<SimulationPlan>,
    mode: Mode,
    /// An FMU call failed: the instance is not used again.
    broken: bool,
    inputs: InputState,
    buffers: OutputBuffers,
    clocks: ClockState,
    /// Rows of outputs at the beginning and the end of a step, and one in between.
    before: Vec<f64>,
    after: Vec<f64>,
    between: Vec<f64>,
    slopes: Vec<f64>,
    /// Derivatives of outputs at the end of a step, where there are some.
    ends: Vec<f64>,
    /// Inputs on their way during a step.
    intermediate: Vec<f64>,
    /// Values of parameters on their way.
    signed: Vec<f64>,
    /// What the initial events told.
    initial: EventOutcome,
    /// Running digest of all samples; only while reset is checked.
    digest: Option<Digest>,
    stopwatch: Stopwatch<{ Call::KINDS }>,
}

impl Stepping {
    pub(crate) fn new(plan: Arc<SimulationPlan>) -> Self {
        let row = || vec![0.0; plan.outputs().len()];
        Self {
            mode: Mode::Gone,
            broken: false,
            inputs: InputState::new(&plan.inputs),
            buffers: OutputBuffers::new(plan.outputs()),
            clocks: ClockState::default(),
            before: row(),
            after: row(),
            between: row(),
            slopes: vec![0.0; plan.inputs.continuous.start.len()],
            ends: Vec::with_capacity(plan.outputs().smooth.0.len()),
            intermediate: Vec::with_capacity(plan.inputs.intermediate.0.len()),
            signed: Vec::new(),
            initial: EventOutcome::default(),
            digest: None,
            stopwatch: Stopwatch::new(),
            plan,
        }
    }

    /// The outputs as they were read last.
    pub(crate) fn buffers(&self) -> &OutputBuffers {
        &self.buffers
    }

    /// Seconds since the start in input functions of the user.
    pub(crate) fn seconds_elsewhere(&self) -> f64 {
        self.inputs.seconds_in_functions()
    }

    /// The ticks of all clocks in the last run.
    pub(crate) fn take_ticks(&mut self) -> Vec<Tick> {
        std::mem::take(&mut self.clocks.ticks)
    }

    /// Starts collecting a digest of what the FMU answers.
    pub(crate) fn begin_digest(&mut self) {
        self.digest = Some(Digest::default());
    }

    /// Ends collecting.
    pub(crate) fn end_digest(&mut self) -> Option<u64> {
        self.digest.take().map(Digest::value)
    }

    /// Takes an instance that will have to be reset.
    pub(crate) fn adopt(&mut self, raw: RawInstance) {
        self.broken = false;
        self.mode = Mode::Spare(raw);
    }

    /// Hands what the FMU has logged in a run to the program's logger.
    pub(crate) fn pass_log_on(&self) {
        if let Mode::Stepping(instance) = &self.mode {
            instance.pass_log_on();
        }
    }

    /// Ends the run of the instance, if there is one that is still good for another run, and gives it up.
    pub(crate) fn retire(&mut self) -> Option<RawInstance> {
        let instance = match std::mem::replace(&mut self.mode, Mode::Gone) {
            Mode::Gone => return None,
            Mode::Spare(raw) => return Some(raw),
            Mode::Stepping(instance) => instance,
        };
        if self.broken {
            return None;
        }
        instance.terminate().ok().map(|instance| instance.into_raw().0)
    }

    /// Brings a fresh instance to its first communication point: values, inputs, initialization.
    pub(crate) fn initialize(&mut self, raw: RawInstance, parameters: &[f64]) -> Result<(), FmiError> {
        let plan = Arc::clone(&self.plan);
        self.initialize_with(raw, &plan.start_values, parameters)
    }

    /// The same with other start values for the variables that have some in the plan.
    pub(crate) fn initialize_with(
        &mut self,
        raw: RawInstance,
        start_values: &StartValues,
        parameters: &[f64],
    ) -> Result<(), FmiError> {
        let plan = Arc::clone(&self.plan);
        self.mode = Mode::Gone;
        self.broken = false;
        self.buffers.begin();
        let ends_exactly = plan.communication.as_ref().is_some_and(|c| c.ends_exactly);
        let Self { inputs, clocks, buffers, signed, .. } = self;
        let start = Start { plan: &plan, start_values, parameters, stop: ends_exactly.then_some(plan.end) };
        let instance: Instance<Initialization, CoSimulation> = start.begin(raw, signed, inputs, clocks)?;
        let (instance, outcome) = instance.begin_steps(|core, time| {
            let recorded = &plan.outputs().clocks;
            clocks.settle(&plan.clocks, core, time, (recorded, buffers)).map(|(outcome, _)| outcome)
        })?;
        self.initial = outcome;
        self.mode = Mode::Stepping(instance);
        Ok(())
    }

    /// Value of a variable at the last communication point.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<crate::Value, FmiError> {
        if self.broken {
            return Err(no_instance());
        }
        let core = self.core()?;
        if core.raw.is_stale() {
            return Err(FmiError::Disturbed { library: core.raw.library_path() });
        }
        core.value(variable)
    }

    pub(crate) fn core(&mut self) -> Result<&mut Core, FmiError> {
        match &mut self.mode {
            Mode::Stepping(instance) => Ok(instance.core()),
            Mode::Gone | Mode::Spare(_) => Err(no_instance()),
        }
    }

    /// Runs from the start to the end.
    ///
    /// # Errors
    /// [`FmiError::Simulation`] says why, where and with which numbers; samples delivered before it stay valid.
    pub(crate) fn run(&mut self, limits: &Limits, observer: &mut dyn Observer) -> Result<Report, FmiError> {
        let plan = Arc::clone(&self.plan);
        let Some(communication) = &plan.communication else { return Err(no_instance()) };
        self.stopwatch.reset();
        let mut run = Run {
            stepping: self,
            plan: &plan,
            communication,
            limits,
            observer,
            t: plan.start,
            passed: 0,
            on_grid: true,
            next_row: 0,
            longest: f64::INFINITY,
            next_event: None,
            discards: 0,
            tried: 0.0,
            stats: Stats::default(),
            began: Instant::now(),
        };
        let exit = match run.start() {
            Ok(()) => loop {
                if let Err(exit) = run.advance() {
                    break exit;
                }
            },
            Err(exit) => exit,
        };
        let seconds = run.began.elapsed().as_secs_f64();
        run.stats.seconds = Seconds::new(seconds);
        run.stats.seconds_in_model = Seconds::new(run.stepping.stopwatch.seconds().min(seconds));
        let (time, step, stats) = (run.t.min(plan.end), run.tried, run.stats);
        match exit {
            Exit::Normal(termination) => Ok(Report { termination, time, stats }),
            Exit::Error(kind) => {
                self.broken |= matches!(kind, ErrorKind::Model(_));
                let error = SimulationError { kind, time, step, worst_state: None, last_event: None, stats };
                Err(FmiError::Simulation(Box::new(error)))
            }
        }
    }
}

fn no_instance() -> FmiError {
    FmiError::BadSetting { problem: "there is no running instance".to_owned() }
}
