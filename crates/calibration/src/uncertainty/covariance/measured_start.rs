//! Initial states that are taken from a measurement: its noise moves the whole simulation.

use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::experiment::InitialState;
use dfo::RobustLoss;
use fmi::Value;
use nalgebra::DVector;

impl Calibration {
    /// Changes of the residuals by one standard deviation of the noise of each measured initial state: a
    /// column for each state of each experiment, from one simulation for each state. `variances`: of the
    /// residuals.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn changes_by_measured_starts(
        &self,
        x: &[f64],
        residuals: &[f64],
        variances: &[f64],
        simulations: &mut Simulations<'_>,
    ) -> Result<Vec<DVector<f64>>, CalibrationError> {
        let experiments = &self.problem().experiments;
        let measured = |state: &(String, InitialState)| state.1 == InitialState::Measured;
        let all = experiments.iter().flat_map(|e| e.initial_states.iter().filter(|s| measured(s)));
        let mut states: Vec<&String> = all.map(|(state, _)| state).collect();
        states.sort();
        states.dedup();
        let mut columns = Vec::new();
        for state in states {
            let mut problem = self.problem().clone();
            let mut moved = Vec::new();
            for (k, experiment) in problem.experiments.iter_mut().enumerate() {
                let initial = experiment.initial_states.iter_mut().find(|s| s.0 == *state && measured(s));
                let output =
                    self.residual_layout().outputs.iter().find(|o| o.experiment == k && o.variable == *state);
                let starts = &self.evaluator().simulations[k].options.start_values;
                let start = starts.iter().find(|(name, _)| name == state).map(|(_, value)| value);
                if let (Some((_, initial)), Some(output), Some(Value::Real(start))) = (initial, output, start)
                {
                    let first = output.range.start;
                    *initial = InitialState::Value(start + variances[first].sqrt() / output.weights[0].abs());
                    moved.push(k);
                }
            }
            let Ok(derived) = self.derived_beside(problem) else { continue };
            let (workers, context) = (simulations.workers, simulations.context);
            let mut own = Simulations::new(&derived, RobustLoss::default(), workers, &context)?;
            let found = own.residuals(&[Point::new(x.to_vec())])?.swap_remove(0);
            simulations.n += own.n;
            simulations.stats += own.stats;
            let Ok(found) = found else { continue };
            for k in moved {
                let mut column = DVector::zeros(residuals.len());
                let outputs = self.residual_layout().outputs.iter().filter(|output| output.experiment == k);
                for i in outputs.flat_map(|output| output.range.clone()) {
                    column[i] = found[i] - residuals[i];
                }
                columns.push(column);
            }
        }
        Ok(columns)
    }
}
