//! Initial states taken from a measurement, whose noise affects the whole simulation.

use crate::error::CalibrationError;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::experiment::InitialState;
use crate::problem::residual_layout::OutputResiduals;
use dfo::RobustLoss;
use nalgebra::DVector;

/// Relative step of a start without noise.
const SHORTEST: f64 = 1e-6;

/// An initial state of an experiment that is set to a measured value.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MeasuredStart {
    /// Index of the experiment, from 0.
    pub(crate) experiment: usize,
    /// Name of the state or the start parameter.
    pub(crate) state: String,
    /// Index of the output that measures it in the residual layout.
    pub(crate) output: usize,
    /// Row of its residual, which is zero for all parameter values. `None` if it is not compared or has
    /// weight zero.
    pub(crate) row: Option<usize>,
    /// Value of the state.
    pub(crate) value: f64,
    /// Absolute weight of the measurement.
    pub(crate) weight: f64,
    /// Change of the plain residuals per unit of the state.
    pub(crate) change: DVector<f64>,
}

impl Calibration {
    /// Returns the measured initial states of all experiments. Their changes are not computed yet.
    pub(crate) fn measured_starts(&self, x: &[f64]) -> Vec<MeasuredStart> {
        let outputs = &self.residual_layout().outputs;
        let of = |k: usize, state: &String, by: &str| {
            let is_of_column = |o: &OutputResiduals| o.experiment == k && o.variable == by;
            let output = outputs.iter().position(is_of_column)?;
            let value = self.evaluator().simulations[k].measured_start(state, x)?;
            let counts = outputs[output].starts_simulation && outputs[output].weights.first() != Some(&0.0);
            let row = counts.then_some(outputs[output].range.start);
            let change = DVector::zeros(0);
            // The noise of measurements of weight zero is unknown.
            let weight = outputs[output].weights.iter().find(|weight| **weight != 0.0)?.abs();
            Some(MeasuredStart { experiment: k, state: state.clone(), output, row, value, weight, change })
        };
        let experiments = self.problem().experiments.iter().enumerate();
        let states = experiments.flat_map(|(k, e)| e.initial_states.iter().map(move |state| (k, state)));
        states.filter_map(|(k, (state, initial))| of(k, state, initial.measured_output(state)?)).collect()
    }

    /// Creates a calibration of the same problem with these starts as numbers, each moved by its step.
    ///
    /// # Errors
    /// Returns an error if the problem cannot be loaded.
    pub(crate) fn with_starts_moved(
        &self,
        moved: &[(&MeasuredStart, f64)],
    ) -> Result<Self, CalibrationError> {
        let mut problem = self.problem().clone();
        for (start, step) in moved {
            let states = &mut problem.experiments[start.experiment].initial_states;
            let initial_state = states.iter_mut().find(|(name, _)| *name == start.state);
            initial_state
                .into_iter()
                .for_each(|(_, initial)| *initial = InitialState::Value(start.value + step));
        }
        self.derived_beside(problem)
    }

    /// Computes the changes of the residuals due to measured initial states, with one simulation for each
    /// state. The steps are about the noise of the measurements. Starts whose simulation fails are omitted.
    ///
    /// # Errors
    /// Returns [`CalibrationError::Cancelled`] if the context has ended.
    pub(crate) fn find_changes_by_starts(
        &self,
        starts: Vec<MeasuredStart>,
        x: &[f64],
        residuals: &[f64],
        simulations: &mut Simulations<'_>,
    ) -> Result<Vec<MeasuredStart>, CalibrationError> {
        let outputs = &self.residual_layout().outputs;
        let step = |start: &MeasuredStart| {
            let output = &outputs[start.output];
            let residuals_of_output = &residuals[output.range.clone()];
            let squares: f64 = residuals_of_output
                .iter()
                .zip(&output.weights)
                .filter(|(_, w)| **w != 0.0)
                .map(|(r, w)| (r / w) * (r / w))
                .sum();
            let size = (squares / residuals_of_output.len() as f64).sqrt();
            let shortest = SHORTEST * start.value.abs();
            let step = if size > shortest && size.is_finite() { size } else { shortest };
            if step > 0.0 { step } else { SHORTEST }
        };
        let mut states: Vec<&String> = starts.iter().map(|start| &start.state).collect();
        states.sort();
        states.dedup();
        let mut found = Vec::new();
        for state in states {
            let moved: Vec<(&MeasuredStart, f64)> = starts
                .iter()
                .filter(|start| start.state == *state)
                .map(|start| (start, step(start)))
                .collect();
            let Ok(derived) = self.with_starts_moved(&moved) else { continue };
            let (workers, context) = (simulations.workers, simulations.context);
            let mut simulations_with_start =
                Simulations::new(&derived, RobustLoss::default(), workers, &context)?;
            let there = simulations_with_start.residuals(&[Point::new(x.to_vec())])?.swap_remove(0);
            simulations.n += simulations_with_start.n;
            simulations.stats += simulations_with_start.stats;
            let Ok(there) = there else { continue };
            for (start, step) in moved {
                let mut change = DVector::zeros(residuals.len());
                let rows = outputs.iter().filter(|output| output.experiment == start.experiment);
                for i in rows.flat_map(|output| output.range.clone()).filter(|i| Some(*i) != start.row) {
                    change[i] = (there[i] - residuals[i]) / step;
                }
                found.push(MeasuredStart { change, ..start.clone() });
            }
        }
        Ok(found)
    }
}
