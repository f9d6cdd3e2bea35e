//! Quality of fit of each output.

use crate::cost::residual::{CostRule, PointResiduals};
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use base::RunContext;
use dfo::RobustLoss;
use ode::Stats;
use serde::{Deserialize, Serialize};

/// Quality of fit of one output of one experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct OutputFit {
    /// Name of the experiment.
    pub experiment: String,
    /// Variable of the model.
    pub variable: String,
    /// Column of the measurements.
    pub column: String,
    /// Unit of the variable, if the model declares one.
    pub unit: Option<String>,
    /// Number of measurements that count.
    pub n: usize,
    /// Root of the mean squared difference between simulation and measurement, without weights. It has the
    /// unit of the variable.
    pub rms: f64,
    /// RMS at the start; `None` if the simulation failed there.
    pub start_rms: Option<f64>,
    /// Fit percentage: `100 (1 - |simulated - measured| / |measured - mean|)`; NaN if the measurements do not
    /// vary.
    pub fit_percent: f64,
    /// True if the fit compared [logarithms](crate::Weight::Log).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_log: bool,
    /// Sum of the logarithms of the weights of the calibration that are not zero. `None` for fits of older
    /// versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_weights: Option<f64>,
}

/// Residuals, with weights and loss, that the search of a fit computed at its start and at the point of the
/// lowest cost.
#[derive(Debug, Clone, Default)]
pub(crate) struct KeptResiduals {
    start: Vec<f64>,
    at_start: Option<Vec<f64>>,
    best: Option<PointResiduals>,
    /// Cost at the best point.
    cost: f64,
}

impl KeptResiduals {
    /// Creates the record, with the residuals at the start if they are known before the run.
    pub(crate) fn new(start: &[f64], at_start: Option<Vec<f64>>) -> Self {
        Self { start: start.to_vec(), at_start, ..Self::default() }
    }

    /// Replaces the best point by `x` with these residuals.
    pub(crate) fn with(self, x: &[f64], residuals: Option<&[f64]>) -> Self {
        let best = residuals.map(|r| PointResiduals { x: x.to_vec(), residuals: r.to_vec() });
        Self { best, ..self }
    }

    /// Converts the weights of one layout to the weights of another layout of the same measurements. The
    /// residuals must not include a loss.
    pub(crate) fn reweighed(mut self, from: &ResidualLayout, to: &ResidualLayout) -> Self {
        if from != to {
            let best = self.best.as_mut().map(|best| &mut best.residuals);
            best.into_iter().chain(&mut self.at_start).for_each(|residuals| to.reweigh(residuals, from));
        }
        self
    }

    /// Returns the residuals at the start.
    pub(crate) fn at_start(&self) -> Option<&[f64]> {
        self.at_start.as_deref()
    }

    /// Returns the residuals at the point of the lowest cost, otherwise the residuals at the start.
    pub(crate) fn at_best(&self) -> Option<&[f64]> {
        self.best.as_ref().map(|best| best.residuals.as_slice()).or(self.at_start())
    }

    /// Returns the residuals at the point of the lowest cost. Returns `None` if an earlier search found a
    /// lower cost than this point, as in a resumed search.
    pub(crate) fn at_best_within(&self, cost: f64) -> Option<&[f64]> {
        self.best.as_ref().filter(|_| self.cost <= cost).map(|best| best.residuals.as_slice())
    }

    /// Returns the residuals at `x` if `x` is the point of the lowest cost or the start.
    pub(crate) fn at(&self, x: &[f64]) -> Option<&[f64]> {
        let best = self.best.as_ref().filter(|best| best.x == x).map(|best| best.residuals.as_slice());
        best.or_else(|| self.at_start().filter(|_| x == self.start))
    }

    /// Records an evaluation that returned a cost.
    pub(crate) fn note(&mut self, x: &[f64], cost: f64, residuals: &[f64]) {
        if self.at_start.is_none() && x == self.start {
            self.at_start = Some(residuals.to_vec());
        }
        match &mut self.best {
            Some(best) if cost < self.cost => {
                best.x.copy_from_slice(x);
                best.residuals.copy_from_slice(residuals);
            }
            Some(_) => return,
            best => *best = Some(PointResiduals { x: x.to_vec(), residuals: residuals.to_vec() }),
        }
        self.cost = cost;
    }

    /// Returns the residuals at a point without the loss.
    fn plain(&self, x: &[f64], loss: RobustLoss) -> Option<PointResiduals> {
        let mut residuals = self.at(x)?.to_vec();
        loss.inverse_all(&mut residuals);
        Some(PointResiduals { x: x.to_vec(), residuals })
    }
}

/// Residuals at the start of a fit and at its result, without a loss. If the residuals at the result are
/// unknown, the residuals at the start are also `None`.
#[derive(Debug)]
pub(crate) struct EndResiduals {
    pub(crate) start: Option<PointResiduals>,
    pub(crate) end: Option<PointResiduals>,
}

impl Calibration {
    /// Returns the residuals at the start of a fit and at `x`. Simulates the points that are not known,
    /// unless the run has ended.
    pub(crate) fn end_residuals(
        &self,
        x: &[f64],
        kept: &KeptResiduals,
        loss: RobustLoss,
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> EndResiduals {
        let mut at = |x: &[f64]| {
            kept.plain(x, loss).or_else(|| {
                let mut residuals = vec![0.0; self.n_values()];
                let rule = CostRule::whole(RobustLoss::default(), context);
                let cost = (!context.is_over()).then(|| self.evaluate_into(x, rule, &mut residuals, stats));
                residuals.truncate(self.n_residuals());
                cost?.ok().map(|_| PointResiduals { x: x.to_vec(), residuals })
            })
        };
        let end = at(x);
        EndResiduals { start: end.as_ref().and_then(|_| at(&kept.start)), end }
    }

    /// Returns the quality of fit of each output at a point and its RMS at the start, from residuals without
    /// a loss.
    pub(crate) fn output_fits(&self, end: &PointResiduals, start: Option<&PointResiduals>) -> Vec<OutputFit> {
        let of_output = |series: &OutputResiduals| {
            let rms = |at: &PointResiduals| {
                let sum: f64 = series.differences(&at.residuals).iter().map(|d| d * d).sum();
                (sum / series.measured.len() as f64).sqrt()
            };
            let declared = self.fmu().description().variable(&series.variable);
            let rms_at_end = rms(end);
            OutputFit {
                experiment: self.evaluator().simulations[series.experiment].name.clone(),
                variable: series.variable.clone(),
                column: series.column.clone(),
                unit: declared.and_then(|variable| variable.unit.clone()),
                n: series.measured.len(),
                rms: rms_at_end,
                start_rms: start.map(rms),
                is_log: series.is_log,
                log_weights: log_weights(series),
                fit_percent: 100.0 * (1.0 - rms_at_end / deviation(&series.measured_values())),
            }
        };
        self.residual_layout().outputs.iter().map(of_output).collect()
    }
}

/// Returns the sum of the logarithms of the weights that are not zero, or `None` if it is not finite.
pub(crate) fn log_weights(output: &OutputResiduals) -> Option<f64> {
    let weights = output.weights.iter().filter(|weight| **weight != 0.0);
    Some(weights.map(|weight| weight.ln()).sum::<f64>()).filter(|sum| sum.is_finite())
}

/// Returns the root of the mean squared distance from the mean, or NaN if all values are equal.
fn deviation(values: &[f64]) -> f64 {
    if values.windows(2).all(|pair| pair[0] == pair[1]) {
        return f64::NAN;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_residuals_store_the_best_point_and_the_start() {
        let mut kept = KeptResiduals::new(&[1.0], None);
        for (x, cost, residual) in [(2.0, 4.0, 2.0), (1.0, 9.0, 3.0), (0.5, 1.0, -1.0), (0.7, 2.0, 1.0)] {
            kept.note(&[x], cost, &[residual]);
        }
        assert_eq!([1.0, 0.5, 0.7].map(|x| kept.at(&[x])), [Some([3.0].as_slice()), Some(&[-1.0]), None]);
        // A search resumed with a cost of 0.5 has a better point than these residuals.
        assert_eq!([1.0, 0.5].map(|cost| kept.at_best_within(cost)), [Some([-1.0].as_slice()), None]);
    }

    #[test]
    fn deviation_is_nan_when_values_are_constant() {
        assert!(deviation(&[0.1; 7]).is_nan());
        assert_eq!(deviation(&[1.0, 3.0]), 1.0);
    }
}
