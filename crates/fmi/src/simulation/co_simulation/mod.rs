//! Co-simulation: the loop over the communication points (see [`Communication`]). It delivers the same kind
//! of samples as the integration of a model.
//!
//! At each point the row is read first. The inputs of the next step are set immediately before the step. Rows
//! are therefore limits from the left. Rows at the start are read after the initialization with the inputs of
//! that time.
//!
//! Limits from the right exist only in event mode (FMI 3.0). At a point with events or input jumps, the row
//! is read after them. A time listed twice has both limits.

mod run;
mod samples;
mod state;

pub(crate) use state::CoSimulationState;

use crate::error::{FmiError, Result};
use crate::simulation::running::no_instance;
use crate::simulation::shared_observer::SharedObserver;
use ode::{ErrorKind, Report, Seconds, SimulationError, Stats};
use run::{Exit, Run};
use std::sync::Arc;
use std::time::Instant;

impl CoSimulationState {
    /// Runs from the start to the end.
    ///
    /// # Errors
    /// Returns [`FmiError::Simulation`] with the reason, the time and the statistics. Samples delivered
    /// before the error stay valid.
    pub(crate) fn run(&mut self, max_steps: Option<u64>, outside: &SharedObserver<'_>) -> Result<Report> {
        let began = Instant::now();
        let plan = Arc::clone(&self.running.plan);
        let Some(communication) = &plan.communication else { return Err(no_instance()) };
        self.stopwatch.reset();
        let mut run = Run {
            stepping: self,
            plan: &plan,
            communication,
            max_steps,
            outside,
            t: plan.start,
            origin: plan.start,
            passed: 0,
            on_grid: true,
            next_row: 0,
            lengths: [f64::NAN; _],
            longest: f64::INFINITY,
            next_event: None,
            discards: 0,
            holds_inputs: true,
            is_elsewhere: false,
            tried: 0.0,
            stats: Stats { runs: 1, ..Stats::default() },
        };
        let exit = match run.start() {
            Ok(()) => loop {
                if let Err(exit) = run.advance() {
                    break exit;
                }
            },
            Err(exit) => exit,
        };
        let seconds = began.elapsed().as_secs_f64();
        run.stats.seconds = Seconds::new(seconds);
        run.stats.seconds_in_model = Seconds::new(run.stepping.stopwatch.seconds().min(seconds));
        let (time, step, stats) = (run.t.min(plan.end), run.tried, run.stats);
        match exit {
            Exit::Normal(termination) => Ok(Report { termination, time, stats }),
            Exit::Error(kind) => {
                if matches!(kind, ErrorKind::Model(_)) {
                    self.running.current.broken = true;
                    self.note_failure();
                }
                let error = SimulationError {
                    kind,
                    time,
                    step,
                    worst_state: None,
                    last_event: None,
                    not_finite: None,
                    undetermined: None,
                    refusal: None,
                    stats,
                };
                Err(FmiError::Simulation(Box::new(error)))
            }
        }
    }
}
