//! Layout of the residual vector.

use crate::data::Series;
use crate::problem::prior::Prior;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Layout of the residual vector: the measurements, output by output, then the priors.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ResidualLayout {
    /// Residuals of the measurements: experiment by experiment, output by output.
    pub outputs: Vec<OutputResiduals>,
    /// Residuals of the priors, which follow the residuals of the measurements.
    pub priors: Vec<PriorResidual>,
    /// Relative tolerance of the simulations, which limits the [likelihood](crate::NamedCost::Likelihood).
    /// Zero if it is not known.
    #[serde(default)]
    pub relative_tolerance: f64,
}

/// Residuals of one output of one experiment: `weight (simulated - measured)`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputResiduals {
    /// Index of the experiment, from 0.
    pub experiment: usize,
    /// Index of the output within the experiment, from 0.
    pub output: usize,
    /// Variable of the model.
    pub variable: String,
    /// Column that measured the variable.
    pub column: String,
    /// Range in the residual vector.
    pub range: Range<usize>,
    /// Times of the measurements, in s.
    pub times: Series,
    /// Measured values.
    pub measured: Series,
    /// Weights of the differences.
    pub weights: Series,
    /// True if a simulation starts from the first measurement. Its residual is then zero for all parameter
    /// values.
    #[serde(default)]
    pub starts_simulation: bool,
    /// True if the noise is [known](crate::Weight::Sigma): a weighted residual has the standard deviation 1.
    #[serde(default)]
    pub is_noise_known: bool,
    /// True if [logarithms](crate::Weight::Log) are compared: `measured` contains the logarithms of the
    /// measurements.
    #[serde(default)]
    pub is_log: bool,
}

impl OutputResiduals {
    /// Returns the measured values in the unit of the variable.
    pub fn measured_values(&self) -> Vec<f64> {
        self.measured.iter().map(|y| self.value(*y)).collect()
    }

    /// Returns the simulated values in the unit of the variable, up to rounding, from the residual vector
    /// without a loss.
    pub fn simulated_values(&self, residuals: &[f64]) -> Vec<f64> {
        let rows = residuals[self.range.clone()].iter().zip(&self.weights).zip(&self.measured);
        rows.map(|((r, w), y)| self.value(y + r / w)).collect()
    }

    /// Returns simulated minus measured values in the unit of the variable, from the residual vector without
    /// a loss.
    pub fn differences(&self, residuals: &[f64]) -> Vec<f64> {
        let rows = residuals[self.range.clone()].iter().zip(&self.weights).zip(&self.measured);
        rows.map(|((r, w), y)| if self.is_log { (y + r / w).exp() - y.exp() } else { r / w }).collect()
    }

    /// Returns the row of each measurement in a recording with these times and measured values.
    pub(crate) fn rows_of(&self, time: &[f64], recorded: &[f64]) -> Vec<usize> {
        let mut rows = Vec::with_capacity(self.times.len());
        // Both are in the order of the recording.
        for (row, (time, recorded)) in time.iter().zip(recorded).enumerate() {
            let k = rows.len();
            let compared = if self.is_log { recorded.ln() } else { *recorded };
            if k < self.times.len() && (*time, compared) == (self.times[k], self.measured[k]) {
                rows.push(row);
            }
        }
        rows
    }

    /// Returns a value of the variable from a compared value.
    pub(crate) fn value(&self, compared: f64) -> f64 {
        if self.is_log { compared.exp() } else { compared }
    }

    /// Returns the indices of residuals with noise. It excludes residuals of weight zero and the residual of
    /// the measurement that a simulation starts from.
    pub(crate) fn noisy_rows(&self) -> impl Iterator<Item = usize> + '_ {
        let of_start = self.starts_simulation.then_some(self.range.start);
        let rows = self.range.clone().zip(&self.weights);
        rows.filter(move |(row, weight)| **weight != 0.0 && Some(*row) != of_start).map(|(row, _)| row)
    }
}

/// Residual of a prior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PriorResidual {
    /// Index of the parameter: an entry of `x`, from 0.
    pub parameter: usize,
    /// Prior of the parameter.
    pub prior: Prior,
    /// Index in the residual vector.
    pub index: usize,
}

impl ResidualLayout {
    /// Returns the number of residuals that belong to measurements. The residuals of the priors follow.
    pub fn n_measurements(&self) -> usize {
        self.outputs.last().map_or(0, |output| output.range.end)
    }

    /// Returns the length of the residual vector.
    pub fn n_residuals(&self) -> usize {
        self.n_measurements() + self.priors.len()
    }

    /// Returns the root of the sum of the squared weighted measurements.
    pub(crate) fn size_of_measurements(&self) -> f64 {
        let all = self.outputs.iter().flat_map(|o| o.measured.iter().zip(&o.weights));
        all.map(|(y, w)| (y * w) * (y * w)).sum::<f64>().sqrt()
    }

    /// Converts residuals to the weights of this layout from the weights of another layout of the same
    /// measurements.
    pub(crate) fn reweighed(&self, residuals: &[f64], from: &Self) -> Vec<f64> {
        let mut reweighed_residuals = residuals.to_vec();
        self.reweigh(&mut reweighed_residuals, from);
        reweighed_residuals
    }

    /// Converts residuals to the weights of this layout in place.
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
