//! A fit whose simulations are made elsewhere: by an executor, on other machines.

use crate::loaded::calibration::Calibration;
use dfo::{Answer, Evaluator, Query, RobustLoss};
use ode::Stats;

/// Simulates the points of a fit, wherever it likes: each as [`Calibration::answer_counted`] does with the
/// same calibration, for residuals.
pub trait SimulationExecutor: Evaluator {
    /// The points from here on are of this calibration, which has chosen its solver: that of the fit, or the
    /// same with other weights or tolerances. What is robust counts by this loss.
    fn begin(&mut self, calibration: &Calibration, loss: RobustLoss);

    /// Statistics of the simulations whose answers have come since the last call.
    fn take_stats(&mut self) -> Stats;
}

impl Calibration {
    /// Answer of an [`SimulationExecutor`] to a query: outcome, and residuals as they count by this loss; the
    /// statistics of the simulations are added to `stats`. The residuals of a query for costs are left out.
    pub fn answer_counted(
        &self,
        x: &[f64],
        query: &Query<'_>,
        loss: RobustLoss,
        stats: &mut Stats,
    ) -> Answer {
        let mut answer = Answer::default();
        self.evaluate_counted(x, query, loss, &mut answer, stats);
        answer
    }
}
