//! Quality of fit of each output.

use crate::cost::calibration::Calibration;
use crate::cost::residual::CostRule;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use base::RunContext;
use dfo::RobustLoss;
use ode::Stats;
use serde::{Deserialize, Serialize};

/// Quality of fit of one output of one experiment.
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
    /// Number of measurements that count.
    pub n: usize,
    /// Root of the mean squared difference between simulation and measurement, without weights, in the unit
    /// of the variable.
    pub rms: f64,
    /// The same at the start; `None` if the simulation failed there.
    pub start_rms: Option<f64>,
    /// Fit percentage: `100 (1 - |simulated - measured| / |measured - mean|)`; NaN where the measurements do
    /// not vary.
    pub fit_percent: f64,
}

/// Residuals that the run of a fit has computed: at its start, and at the point of the lowest cost.
#[derive(Debug, Default)]
pub(crate) struct KeptResiduals {
    start: Option<Vec<f64>>,
    best: Option<Kept>,
}

/// A point, its cost and its residuals.
#[derive(Debug)]
struct Kept {
    x: Vec<f64>,
    cost: f64,
    residuals: Vec<f64>,
}

impl KeptResiduals {
    /// Those at the start, known before the run.
    pub(crate) fn of_start(start: Option<Vec<f64>>) -> Self {
        Self { start, best: None }
    }

    /// Those at the start, and those of a point, as they counted.
    pub(crate) fn of_both(start: Option<&[f64]>, best: Option<(&[f64], &[f64])>) -> Self {
        let best =
            best.map(|(x, residuals)| Kept { x: x.to_vec(), cost: f64::NAN, residuals: residuals.to_vec() });
        Self { start: start.map(<[f64]>::to_vec), best }
    }

    /// The same by the weights of another layout of the same measurements; of residuals without a loss.
    pub(crate) fn reweighed(mut self, from: &ResidualLayout, to: &ResidualLayout) -> Self {
        if from != to {
            let best = self.best.as_mut().map(|kept| &mut kept.residuals);
            best.into_iter().chain(&mut self.start).for_each(|residuals| to.reweigh(residuals, from));
        }
        self
    }

    /// Those at the start, as they counted.
    pub(crate) fn at_start(&self) -> Option<&[f64]> {
        self.start.as_deref()
    }

    /// Those at `x`, as they counted, if they are known: at the point of the lowest cost, and at the start.
    pub(crate) fn at(&self, (x, start): (&[f64], &[f64])) -> Option<&[f64]> {
        let best = self.best.as_ref().filter(|kept| kept.x == x).map(|kept| kept.residuals.as_slice());
        best.or_else(|| self.at_start().filter(|_| x == start))
    }

    /// Notes an evaluation that has a cost.
    pub(crate) fn note(&mut self, (x, start): (&[f64], &[f64]), cost: f64, residuals: &[f64]) {
        if self.start.is_none() && x == start {
            self.start = Some(residuals.to_vec());
        }
        match &mut self.best {
            Some(kept) if cost < kept.cost => {
                kept.x.copy_from_slice(x);
                kept.cost = cost;
                kept.residuals.copy_from_slice(residuals);
            }
            Some(_) => {}
            best => *best = Some(Kept { x: x.to_vec(), cost, residuals: residuals.to_vec() }),
        }
    }

    /// The residuals at the start and at `x`, without the loss.
    fn plain(&self, (start, x): (&[f64], &[f64]), loss: RobustLoss) -> [Option<Vec<f64>>; 2] {
        [self.at_start(), self.at((x, start))]
            .map(|residuals| residuals.map(|r| r.iter().map(|r| loss.inverse(*r)).collect()))
    }
}

impl Calibration {
    /// The residuals at the start of a fit and at `x`, without a loss: those that are known, else from
    /// simulations, as long as it is not cancelled. None at the start where there are none at `x`.
    pub(crate) fn plain_residuals(
        &self,
        (start, x): (&[f64], &[f64]),
        (known, loss): (&KeptResiduals, RobustLoss),
        context: &RunContext<'_>,
        stats: &mut Stats,
    ) -> (Option<Vec<f64>>, Option<Vec<f64>>) {
        let [at_start, at_end] = known.plain((start, x), loss);
        let mut simulated = |x: &[f64]| {
            let mut residuals = vec![0.0; self.n_residuals()];
            let rule = CostRule::whole(RobustLoss::default(), context);
            let cost = (!context.is_over()).then(|| self.evaluate_into(x, rule, &mut residuals, stats));
            cost.is_some_and(|cost| cost.is_ok()).then_some(residuals)
        };
        let Some(at_end) = at_end.or_else(|| simulated(x)) else { return (None, None) };
        (at_start.or_else(|| simulated(start)), Some(at_end))
    }

    /// Quality of fit of each output at the end, with the RMS at the start of a fit, from the plain
    /// residuals.
    pub(crate) fn output_fits_of(&self, at_end: &[f64], at_start: Option<&[f64]>) -> Vec<OutputFit> {
        let of_output = |series: &OutputResiduals| {
            let rms = |residuals: &[f64]| {
                let own = residuals[series.range.clone()].iter().zip(&series.weights);
                let sum: f64 = own.map(|(r, w)| (r / w).powi(2)).sum();
                (sum / series.measured.len() as f64).sqrt()
            };
            let declared = self.fmu().description().variable(&series.variable);
            let rms_at_end = rms(at_end);
            OutputFit {
                experiment: self.evaluator().simulations[series.experiment].name.clone(),
                variable: series.variable.clone(),
                column: series.column.clone(),
                unit: declared.and_then(|variable| variable.unit.clone()),
                n: series.measured.len(),
                rms: rms_at_end,
                start_rms: at_start.map(rms),
                fit_percent: 100.0 * (1.0 - rms_at_end / deviation(&series.measured)),
            }
        };
        self.residual_layout().outputs.iter().map(of_output).collect()
    }
}

/// Root of the mean squared distance from the mean; NaN where all values are the same.
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
    fn residuals_of_the_best_point_and_of_the_start_are_kept() {
        let mut kept = KeptResiduals::default();
        let start = [1.0];
        kept.note((&[2.0], &start), 4.0, &[2.0]);
        kept.note((&[1.0], &start), 9.0, &[3.0]);
        kept.note((&[0.5], &start), 1.0, &[-1.0]);
        kept.note((&[0.7], &start), 2.0, &[1.0]);
        let plain = kept.plain((&start, &[0.5]), RobustLoss::default());
        assert_eq!(plain, [Some(vec![3.0]), Some(vec![-1.0])]);
    }

    #[test]
    fn constant_values_have_no_deviation_to_compare_with() {
        assert!(deviation(&[0.1; 7]).is_nan());
        assert_eq!(deviation(&[1.0, 3.0]), 1.0);
    }
}
