//! Which method integrates the simulations of a calibration: the one that was named, or the winner of a race.

use crate::calibration::{Calibration, NoCost, no_cost};
use crate::error::CalibrationError;
use crate::race::{Lap, Race, race};
use dfo::Checkpoint;
use fmi::{FmiError, InterfaceKind, Pool, SimulateOptions, SimulationPlan, Simulator};
use ode::{ErrorKind, Method, Observer, Sample, Stats};
use sha2::{Digest, Sha256};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread;
use std::time::Duration;

/// Stack of the thread that simulates while the calling one polls.
const STACK_SIZE: usize = 16 << 20;
/// How long the calling thread waits at most between two polls.
const PATIENCE: Duration = Duration::from_millis(20);
/// The absolute tolerance of an output is this share of the relative one and its nominal value, as for states.
const ABSOLUTE_SHARE: f64 = 0.01;
/// Name of the solver among what identifies a fit.
const TAG: &str = "solver";

/// The method in use, and how it was found.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Solver {
    /// The method.
    pub method: Method,
    /// The race that it won; `None`: it was named, or taken from a checkpoint, or the model integrates itself.
    pub race: Option<Race>,
}

/// A choice that is made once.
#[derive(Debug, Default)]
pub(crate) struct Choice {
    made: OnceLock<Chosen>,
    racing: Mutex<()>,
}

#[derive(Debug)]
struct Chosen {
    solver: Solver,
    /// Simulators with this method, per experiment; none: those of the settings.
    pools: Vec<Pool>,
}

/// Keeps the samples of one simulation.
struct Samples<'a> {
    values: Vec<f64>,
    /// Numbers of a sample that have a name.
    named: usize,
    cancelled: &'a dyn Fn() -> bool,
    was_cancelled: bool,
}

impl Observer for Samples<'_> {
    fn sample(&mut self, sample: &Sample<'_>) -> ControlFlow<()> {
        if sample.index.is_some() {
            self.values.extend_from_slice(&sample.outputs[..self.named]);
        }
        ControlFlow::Continue(())
    }

    fn poll(&mut self) -> ControlFlow<()> {
        self.was_cancelled = (self.cancelled)();
        if self.was_cancelled { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl Calibration {
    /// The method that integrates the simulations of this calibration, in fits and outside of them. Where the settings
    /// name none, it is found at the first use, by a race at the parameters' start values (see [`race`]): up to four
    /// simulations of every experiment, one if the model is not stiff there. It stays the same from then on.
    ///
    /// # Errors
    /// The model cannot be loaded or instantiated. Simulations that fail are no error: they lose.
    pub fn solver(&self) -> Result<&Solver, CalibrationError> {
        self.solver_until(&|| false)
    }

    /// The same, if it is known already.
    pub fn known_solver(&self) -> Option<&Solver> {
        self.choice().made.get().map(|chosen| &chosen.solver)
    }

    /// As [`solver`](Self::solver); gives up when `cancelled` says so.
    ///
    /// # Errors
    /// As [`solver`](Self::solver), and [`CalibrationError::Cancelled`].
    pub fn solver_until(&self, cancelled: &dyn Fn() -> bool) -> Result<&Solver, CalibrationError> {
        self.chosen(cancelled).map(|chosen| &chosen.solver)
    }

    /// The simulators of an experiment with the method in use.
    pub(crate) fn pool(&self, experiment: usize, cancelled: &dyn Fn() -> bool) -> Result<&Pool, NoCost> {
        let chosen = self.chosen(cancelled).map_err(|error| match error {
            CalibrationError::Model(error) => no_cost(error),
            _ => NoCost::Cancelled,
        })?;
        Ok(chosen.pools.get(experiment).unwrap_or_else(|| self.pool_of_settings(experiment)))
    }

    fn chosen(&self, cancelled: &dyn Fn() -> bool) -> Result<&Chosen, CalibrationError> {
        if let Some(chosen) = self.choice().made.get() {
            return Ok(chosen);
        }
        let _turn = self.choice().racing.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(chosen) = self.choice().made.get() {
            return Ok(chosen);
        }
        let method = self.method_of_settings();
        let integrates = self.pool_of_settings(0).plan().kind() == InterfaceKind::ModelExchange;
        let solver = if method == Method::Auto && integrates {
            let race = loop {
                let before = self.n_history_findings();
                let race = self.race(cancelled)?;
                if self.n_history_findings() == before {
                    break race;
                }
            };
            Solver { method: race.method, race: Some(race) }
        } else {
            Solver { method, race: None }
        };
        self.choose(solver)
    }

    /// Fixes the choice, unless it is made.
    fn choose(&self, solver: Solver) -> Result<&Chosen, CalibrationError> {
        let mut pools = Vec::new();
        if solver.method != self.method_of_settings() {
            for options in self.all_options() {
                let options = SimulateOptions { method: solver.method, ..options.clone() };
                let plan = Arc::new(SimulationPlan::new(self.fmu(), &options)?);
                pools.push(Pool::with_reference(plan, &self.start())?);
            }
        }
        Ok(self.choice().made.get_or_init(|| Chosen { solver, pools }))
    }

    fn race(&self, cancelled: &dyn Fn() -> bool) -> Result<Race, CalibrationError> {
        let plan = self.pool_of_settings(0).plan();
        let (relative, n) = (plan.relative_tolerance(), plan.n_states());
        let variables = &self.fmu().description().variables;
        let nominal = |v: &usize| variables[*v].nominal.map(f64::abs).filter(|n| n.is_finite() && *n > 0.0);
        // The samples of all experiments stand one after the other, so their tolerances have to be laid out likewise.
        let plans: Vec<_> =
            (0..self.all_options().count()).map(|k| self.pool_of_settings(k).plan()).collect();
        let absolute: Vec<f64> = plans
            .iter()
            .flat_map(|plan| {
                let row = plan.output_variables().iter().map(nominal);
                let row: Vec<f64> = row.map(|n| ABSOLUTE_SHARE * relative * n.unwrap_or(1.0)).collect();
                plan.times().iter().flat_map(move |_| row.clone())
            })
            .collect();
        race(relative, &absolute, n, |heat| {
            let (mut all, mut total) = (Vec::new(), Stats::default());
            for options in self.all_options() {
                let options = SimulateOptions {
                    method: heat.method,
                    relative_tolerance: Some(heat.relative_tolerance),
                    max_work: heat.max_work.map(|most| (most - total.work(n)).max(0.0)),
                    ..options.clone()
                };
                let plan = Arc::new(SimulationPlan::new(self.fmu(), &options)?);
                let named = plan.output_names().len();
                let mut simulator = Simulator::new(plan)?;
                let mut samples = Samples { values: all, named, cancelled, was_cancelled: false };
                let ran = simulator.run(&self.start(), &mut samples);
                if samples.was_cancelled {
                    return Err(CalibrationError::Cancelled);
                }
                all = samples.values;
                match ran {
                    Ok(report) => total += report.stats,
                    Err(FmiError::Simulation(e)) if matches!(e.kind, ErrorKind::TooMuchWork(_)) => {
                        return Ok(Lap::GivenUp);
                    }
                    Err(error) => {
                        return match no_cost(error) {
                            NoCost::Failed { reason, .. } => Ok(Lap::Failed(reason)),
                            NoCost::Over(error) => Err(CalibrationError::Model(*error)),
                            NoCost::Above | NoCost::Cancelled => Err(CalibrationError::Cancelled),
                        };
                    }
                }
            }
            Ok(Lap::Finished { samples: all, stats: total })
        })
    }

    /// Finds the solver on another thread, while this one polls.
    pub(crate) fn find_solver(
        &self,
        mut poll: Option<&mut (dyn FnMut() -> bool + '_)>,
    ) -> Result<&Solver, CalibrationError> {
        if self.known_solver().is_some() || self.method_of_settings() != Method::Auto {
            return self.solver();
        }
        let (done, is_done) = channel::<()>();
        let asked = AtomicBool::new(false);
        thread::scope(|scope| {
            let cancelled = || asked.load(Ordering::Relaxed);
            let work = move || {
                // Dropped at the end, however it ends.
                let _done = done;
                self.solver_until(&cancelled)
            };
            let racing = thread::Builder::new()
                .stack_size(STACK_SIZE)
                .spawn_scoped(scope, work)
                .map_err(|e| CalibrationError::Setup(format!("a thread cannot be started: {e}")))?;
            while is_done.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                if poll.as_mut().is_some_and(|poll| poll()) {
                    asked.store(true, Ordering::Relaxed);
                }
            }
            racing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })
    }

    /// Takes the solver of a checkpoint that will be continued, if it is of this calibration and there is no race yet.
    pub(crate) fn adopt_solver(&self, checkpoint: &Checkpoint) -> Result<(), CalibrationError> {
        if self.method_of_settings() != Method::Auto || self.known_solver().is_some() {
            return Ok(());
        }
        let Some(stored) = checkpoint.stored_identity()? else { return Ok(()) };
        let value = |name: &str| stored.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str());
        if self.identity().iter().any(|(name, given)| value(name) != Some(given)) {
            return Ok(());
        }
        if let Some(method) = value(TAG).and_then(|name| name.parse().ok()) {
            self.choose(Solver { method, race: None })?;
        }
        Ok(())
    }

    /// What a cost depends on but the parameters' values, as a hash: model, data, settings, solver, and what each parameter
    /// sets; neither bounds nor starts.
    pub(crate) fn problem(&self, solver: &Solver) -> String {
        let mut hasher = Sha256::new();
        let own = self.identity().iter().map(|(name, value)| (name.as_str(), value.as_str()));
        for (name, value) in own.chain([(TAG, solver.method.name())]) {
            for text in [name, value] {
                hasher.update((text.len() as u64).to_le_bytes());
                hasher.update(text);
            }
        }
        hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// A checkpoint that knows what it belongs to.
    pub(crate) fn tag(&self, checkpoint: Checkpoint, solver: &Solver) -> Checkpoint {
        let tagged = |checkpoint: Checkpoint, (name, value): &(String, String)| checkpoint.tag(name, value);
        self.identity().iter().fold(checkpoint, tagged).tag(TAG, solver.method.name())
    }
}
