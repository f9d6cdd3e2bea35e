//! How well each output is reproduced.

use serde::{Deserialize, Serialize};

/// How well a fit reproduces one output of one experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct OutputFit {
    /// The experiment.
    pub experiment: String,
    /// The variable of the model.
    pub variable: String,
    /// The column that measured it.
    pub column: String,
    /// The unit of the variable, where the model states it.
    pub unit: Option<String>,
    /// How many measurements count.
    pub n: usize,
    /// Root of the mean squared difference between simulation and measurement, without weights, in the unit of the variable.
    pub rms: f64,
    /// The same at the start; `None` if the simulation failed there.
    pub start_rms: Option<f64>,
    /// Fit percentage: `100 (1 - |simulated - measured| / |measured - mean|)`; NaN where the measurements do not vary.
    pub fit_percent: f64,
}
