//! A run on a new instance, with which those of a check are compared; when a check is due, and how long its
//! runs are.

use crate::fmu::BeforeReading;
use crate::simulation::digest::Digest;
use crate::simulation::plan::SimulationPlan;
use crate::simulation::running::Running;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Largest cost of a check, as a fraction of the time of the runs before it.
const SHARE: f64 = 0.1;

/// A check that takes fewer seconds than this follows the first run: it is not felt, and says before the
/// second result whether runs depend on earlier ones.
const SHORT: f64 = 5e-3;

/// Runs of a check, as a rule.
const RUNS: u64 = 4;

/// Steps of each: what is not brought back shows in the first right-hand sides.
const STEPS: RangeInclusive<u64> = 3..=50;

/// A run on a new instance, with which those of checks are compared.
#[derive(Debug)]
pub(super) struct FirstRun {
    pub(super) plan: Arc<SimulationPlan>,
    pub(super) parameters: Vec<f64>,
    pub(super) wants_steps: bool,
    pub(super) digest: Digest,
    /// Its rows were read as those of later runs are.
    pub(super) before_reading: BeforeReading,
    n_steps: u64,
    /// Seconds of its start, and of all of it.
    starting: f64,
    took: f64,
    /// Seconds of the runs that no check has followed.
    pub(super) spent: f64,
}

impl FirstRun {
    /// A run that is about to begin.
    pub(super) fn new(plan: &Arc<SimulationPlan>, parameters: &[f64], wants_steps: bool) -> Self {
        Self {
            plan: Arc::clone(plan),
            parameters: parameters.to_vec(),
            wants_steps,
            digest: Digest::default(),
            before_reading: plan.fmu().before_reading(),
            n_steps: 0,
            starting: 0.0,
            took: 0.0,
            spent: 0.0,
        }
    }

    /// The run is over.
    pub(super) fn end(&mut self, running: &mut Running, n_steps: u64, starting: f64, took: f64) {
        self.digest = running.end_digest().unwrap_or_default();
        (self.n_steps, self.starting, self.took, self.spent) = (n_steps, starting, took, took);
    }

    /// Steps of a run of a check: counted from those of this run, so that they are no more than their share.
    pub(super) fn n_check_steps(&self) -> u64 {
        let most = (SHARE * self.n_steps as f64 / RUNS as f64) as u64;
        most.clamp(*STEPS.start(), *STEPS.end())
    }

    /// True if the runs so far have taken long enough for a check.
    pub(super) fn is_due(&self) -> bool {
        let per_step = (self.took - self.starting) / self.n_steps.max(1) as f64;
        let estimate = RUNS as f64 * (self.starting + per_step * self.n_check_steps() as f64);
        self.n_steps > 0 && estimate <= SHORT.max(SHARE * self.spent)
    }
}
