//! Fits whose simulations run in an executor or on other machines.

use crate::loaded::calibration::Calibration;
use dfo::{Answer, EvaluationKind, Evaluator, Query, RobustLoss};
use ode::Stats;

/// Evaluator that simulates the points of a fit, for example on other machines. Each answer must equal the
/// answer of [`Calibration::answer_counted`] for residuals with the same calibration.
pub trait SimulationExecutor: Evaluator {
    /// Sets the calibration and the robust loss of the following points. The calibration has chosen its
    /// solver. It is the calibration of the fit, or a copy with other weights or tolerances.
    fn begin(&mut self, calibration: &Calibration, loss: RobustLoss);

    /// Returns the statistics of the simulations answered since the last call.
    fn take_stats(&mut self) -> Stats;
}

impl Calibration {
    /// Answers a query for a [`SimulationExecutor`], with the outcome and the residuals after this loss,
    /// followed by the criteria of trajectories. Adds the statistics of the simulations to `stats`. Omits the
    /// residuals and the criteria if the query requests only the cost.
    pub fn answer_counted(
        &self,
        x: &[f64],
        query: &Query<'_>,
        loss: RobustLoss,
        stats: &mut Stats,
    ) -> Answer {
        let mut answer = Answer::default();
        self.evaluate_counted(x, query, loss, None, &mut answer, stats);
        if query.kind == EvaluationKind::Cost {
            answer.residuals.clear();
        }
        answer
    }
}
