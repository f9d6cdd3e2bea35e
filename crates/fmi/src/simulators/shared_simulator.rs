//! A simulator that threads use in turn.

use super::simulator::Simulator;
use crate::error::FmiError;
use crate::simulation::plan::SimulationPlan;
use base::RunContext;
use std::sync::{Arc, Mutex, PoisonError};

/// Simulator of one plan for any number of threads, one at a time. Threads also take turns across all pools
/// of one [`Fmu`](crate::Fmu) and its clones.
#[derive(Debug)]
pub struct SharedSimulator {
    plan: Arc<SimulationPlan>,
    simulator: Mutex<Option<Simulator>>,
}

impl SharedSimulator {
    /// Creates a pool for this plan. It does not load or run the model.
    pub fn new(plan: Arc<SimulationPlan>) -> Self {
        Self { plan, simulator: Mutex::default() }
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Arc<SimulationPlan> {
        &self.plan
    }

    /// Runs `work` with the simulator when no other thread uses it. Checks `context` every 20 ms while it
    /// waits. The wait does not count towards any time limit.
    ///
    /// # Errors
    /// Returns the errors of `work` and of [`Simulator::new`], and [`FmiError::Cancelled`].
    pub fn with_simulator<T>(
        &self,
        context: &RunContext<'_>,
        work: impl FnOnce(&mut Simulator) -> Result<T, FmiError>,
    ) -> Result<T, FmiError> {
        let turn = self.plan.fmu().turns().enter_while(&mut || !context.is_over());
        let _turn = turn.ok_or(FmiError::Cancelled)?;
        let lock = || self.simulator.lock().unwrap_or_else(PoisonError::into_inner);
        // The simulator is taken out so that it is not used again after a panic. `work` may also call this
        // function again.
        let kept = lock().take();
        let mut simulator = match kept {
            Some(simulator) => simulator,
            None => Simulator::new(Arc::clone(&self.plan))?,
        };
        let result = work(&mut simulator);
        let replaced = lock().replace(simulator);
        drop(replaced);
        result
    }
}
