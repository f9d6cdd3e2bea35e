//! Layout of the residual vector.

use crate::data::Series;
use crate::problem::prior::Prior;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Layout of the residual vector: the measurements, output by output, then the priors.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ResidualLayout {
    /// The residuals of the measurements: experiment by experiment, output by output.
    pub outputs: Vec<OutputResiduals>,
    /// The residuals of the priors, which follow those of the measurements.
    pub priors: Vec<PriorResidual>,
}

/// The residuals of one output of one experiment: `weight (simulated - measured)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputResiduals {
    /// The experiment, counted from 0.
    pub experiment: usize,
    /// The output, counted from 0 within the experiment.
    pub output: usize,
    /// The variable of the model.
    pub variable: String,
    /// The column that measured it.
    pub column: String,
    /// Where they stand in the residual vector.
    pub range: Range<usize>,
    /// Times of the measurements, in s.
    pub times: Series,
    /// Measured values.
    pub measured: Series,
    /// Weights of the differences.
    pub weights: Series,
    /// True if a simulation starts from the first of the measurements: its residual is zero whatever the
    /// parameters are.
    #[serde(default)]
    pub starts_simulation: bool,
}

impl OutputResiduals {
    /// The residuals that have noise: neither of weight zero nor of the measurement that a simulation starts
    /// from.
    pub(crate) fn noisy_rows(&self) -> impl Iterator<Item = usize> + '_ {
        let of_start = self.starts_simulation.then_some(self.range.start);
        let rows = self.range.clone().zip(&self.weights);
        rows.filter(move |(row, weight)| **weight != 0.0 && Some(*row) != of_start).map(|(row, _)| row)
    }
}

/// The residual of a prior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PriorResidual {
    /// The parameter: an entry of `x`, counted from 0.
    pub parameter: usize,
    /// Prior of the parameter.
    pub prior: Prior,
    /// Where it stands in the residual vector.
    pub index: usize,
}

impl ResidualLayout {
    /// Number of residuals that belong to measurements; those of the priors follow.
    pub fn n_measurements(&self) -> usize {
        self.outputs.last().map_or(0, |output| output.range.end)
    }

    /// Length of the residual vector.
    pub fn n_residuals(&self) -> usize {
        self.n_measurements() + self.priors.len()
    }

    /// Root of the sum of the squares of the measurements, times their weights.
    pub(crate) fn size_of_measurements(&self) -> f64 {
        let all = self.outputs.iter().flat_map(|o| o.measured.iter().zip(&o.weights));
        all.map(|(y, w)| (y * w) * (y * w)).sum::<f64>().sqrt()
    }

    /// Residuals by these weights, from those by the weights of another layout of the same measurements.
    pub(crate) fn reweighed(&self, residuals: &[f64], from: &Self) -> Vec<f64> {
        let mut own = residuals.to_vec();
        self.reweigh(&mut own, from);
        own
    }

    /// The same in place.
    pub(crate) fn reweigh(&self, residuals: &mut [f64], from: &Self) {
        for (from, to) in from.outputs.iter().zip(&self.outputs) {
            let weights = from.weights.iter().zip(&to.weights);
            for (r, (from, to)) in residuals[to.range.clone()].iter_mut().zip(weights) {
                if from != to {
                    *r *= to / from;
                }
            }
        }
    }
}
