//! Engines that make the steps of a simulation: the integration driver, or the FMU itself.

use crate::description::{Value, Variable};
use crate::error::{FmiError, Result};
use crate::simulation::co_simulation::CoSimulationState;
use crate::simulation::model_exchange::{Integration, System};
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::Running;
use crate::simulation::settling::{settle, settling_driver};
use crate::simulation::shared_observer::SharedObserver;
use crate::simulation::variable_elements::RunInput;
use crate::sys::{InterfaceKind, RawInstance, note_start, set_float_mode};
use ode::{Driver, ErrorKind, Ignore, Observer, Report, Termination};
use std::sync::Arc;

/// Engine for running a model, with its instance.
#[derive(Debug)]
pub(crate) enum Engine {
    Integrated {
        driver: Box<Driver>,
        /// Driver of the approach to steady state.
        settling: Option<Box<Driver>>,
        system: Box<System>,
    },
    Stepping(Box<CoSimulationState>),
}

impl Engine {
    pub(crate) fn new(plan: &Arc<SimulationPlan>) -> Result<Self> {
        Ok(match plan.kind {
            InterfaceKind::ModelExchange => Engine::Integrated {
                driver: Box::new(Driver::new(plan.options.clone())?),
                settling: plan.steady.map(|_| settling_driver(plan)).transpose()?,
                system: Box::new(System::new(Arc::clone(plan))),
            },
            InterfaceKind::CoSimulation => {
                Engine::Stepping(Box::new(CoSimulationState::new(Arc::clone(plan))))
            }
        })
    }

    /// Returns the run state with the instance.
    pub(crate) fn running(&mut self) -> &mut Running {
        match self {
            Engine::Integrated { system, .. } => &mut system.running,
            Engine::Stepping(stepping) => &mut stepping.running,
        }
    }

    /// Brings a new instance to the start. Uses the plan's start values, or the values in `input` for the
    /// same variables.
    pub(crate) fn initialize(&mut self, raw: RawInstance, input: RunInput<'_>) -> Result<()> {
        note_start();
        set_float_mode();
        match self {
            Engine::Integrated { system, .. } => system.initialize(raw, input),
            Engine::Stepping(stepping) => stepping.initialize(raw, input),
        }
    }

    /// Handles the initial events if only initial values are needed.
    pub(crate) fn run_initial_events(&mut self) -> Result<()> {
        let plan = Arc::clone(&self.running().plan);
        let mut nobody = Ignore;
        let outside = SharedObserver::new(&plan.options, &mut nobody);
        match self {
            Engine::Integrated { system, .. } => {
                Integration { system, outside: &outside, is_settled: false }.initial_events()
            }
            Engine::Stepping(stepping) => stepping.run_initial_events(&outside).map(drop),
        }
    }

    /// Returns the value of a variable at the current point of the run.
    pub(crate) fn value(&mut self, variable: &Variable) -> Result<Value> {
        match self {
            Engine::Integrated { system, .. } => system.value(variable),
            Engine::Stepping(stepping) => stepping.value(variable),
        }
    }

    /// Runs the simulation.
    pub(crate) fn run(&mut self, plan: &SimulationPlan, observer: &mut dyn Observer) -> Result<Report> {
        // The FMU may have changed the floating-point mode when it was loaded and initialized.
        set_float_mode();
        let outside = SharedObserver::new(&plan.options, observer);
        match self {
            Engine::Integrated { driver, settling, system } => {
                let mut integration = Integration { system, outside: &outside, is_settled: false };
                let mut settled = None;
                if let Some((settling, limit)) = settling.as_mut().zip(plan.steady) {
                    let report = settle(&mut integration, settling, limit)?;
                    if report.termination == Termination::StoppedByObserver {
                        return Ok(report);
                    }
                    integration.is_settled = true;
                    settled = Some(report.stats);
                }
                let ended = driver.run(&mut integration, plan.start, plan.end, &plan.times, &mut &outside);
                let mut ended = ended.and_then(|report| system.compared_at_end(report));
                if let Some(before) = settled {
                    *ended.as_mut().map_or_else(|error| &mut error.stats, |report| &mut report.stats) +=
                        before;
                }
                ended.map_err(|mut error| {
                    if let Some(value) = &mut error.not_finite {
                        value.name = plan.name_of(value);
                    } else if matches!(
                        error.kind,
                        ErrorKind::DiscardedAtRestart | ErrorKind::StepTooSmall { discarded: true }
                    ) {
                        error.refusal = system.running.current.refusal();
                    }
                    FmiError::Simulation(error)
                })
            }
            Engine::Stepping(stepping) => stepping.run(plan.options.limits.max_steps, &outside),
        }
    }
}
