//! A simulator that many threads use in turns.

use super::simulator::Simulator;
use crate::error::FmiError;
use crate::simulation::plan::SimulationPlan;
use base::RunContext;
use std::sync::{Arc, Mutex, PoisonError};

/// A simulator of one plan for any number of threads, which use it one at a time; so they use all pools of
/// one [`Fmu`](crate::Fmu) and its clones.
#[derive(Debug)]
pub struct SharedSimulator {
    plan: Arc<SimulationPlan>,
    simulator: Mutex<Option<Simulator>>,
}

impl SharedSimulator {
    /// A pool for this plan. Nothing is loaded or run yet.
    pub fn new(plan: Arc<SimulationPlan>) -> Self {
        Self { plan, simulator: Mutex::default() }
    }

    /// The plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Uses the simulator when nobody else does; the context is looked at every 20 ms until then. The wait
    /// counts in no time limit.
    ///
    /// # Errors
    /// Those of `work` and of [`Simulator::new`]; [`FmiError::Cancelled`].
    pub fn with_simulator<T>(
        &self,
        context: &RunContext<'_>,
        work: impl FnOnce(&mut Simulator) -> Result<T, FmiError>,
    ) -> Result<T, FmiError> {
        let turn = self.plan.fmu().turns().enter_while(&mut || !context.is_over());
        let _turn = turn.ok_or(FmiError::Cancelled)?;
        let lock = || self.simulator.lock().unwrap_or_else(PoisonError::into_inner);
        // Taken out: one that panics is not used again, and a thread may come here again within its work.
        let known = lock().take();
        let mut simulator = match known {
            Some(simulator) => simulator,
            None => Simulator::new(Arc::clone(&self.plan))?,
        };
        let result = work(&mut simulator);
        let replaced = lock().replace(simulator);
        drop(replaced);
        result
    }
}
