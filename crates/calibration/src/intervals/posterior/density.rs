//! Log density of the posterior distribution, from the residuals of a simulation.

use crate::error::CalibrationError;
use crate::fit::one_stage::{Fit, FitNoise};
use crate::loaded::calibration::Calibration;
use crate::problem::objective::{CostKind, NamedCost};
use crate::problem::parameter::{Parameter, Scale};
use crate::problem::prior::Prior;
use crate::problem::residual_layout::OutputResiduals;

/// Residuals that share one unknown standard deviation, or whose weights state it.
#[derive(Debug, Clone, PartialEq)]
struct NoiseGroup {
    variable: String,
    is_known: bool,
    /// Rows of the residual vector, with factors that remove weights that do not describe the noise.
    rows: Vec<(usize, f64)>,
}

/// Log density of the posterior distribution, up to a constant.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LogDensity {
    groups: Vec<NoiseGroup>,
    /// Rows of the residual vector that belong to priors.
    priors: Vec<usize>,
}

impl LogDensity {
    /// Creates the density with the noise of a fit.
    ///
    /// # Errors
    /// Returns an error if the fit minimised a robust loss, or a cost that is not a likelihood of normal
    /// noise.
    pub(super) fn of_fit(calibration: &Calibration, fit: &Fit) -> Result<Self, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        let is_likelihood = fit.objective == CostKind::Named(NamedCost::Likelihood).name();
        if !is_likelihood && fit.objective != CostKind::default().name() {
            return setup(format!(
                "the posterior distribution requires normal noise, but the fit minimised another cost ({})",
                fit.objective
            ));
        }
        if !fit.report.loss.is_linear() {
            return setup(format!(
                "the posterior distribution requires normal noise, but the fit used the robust loss {}",
                fit.report.loss
            ));
        }
        let (problem, layout) = (calibration.problem(), calibration.residual_layout());
        let is_known = |output: &OutputResiduals| {
            !is_likelihood
                && match &fit.noise {
                    Some(FitNoise::Known | FitNoise::Stated) => true,
                    Some(FitNoise::Estimated(noise)) => noise.is_known || output.is_noise_known,
                    None => output.is_noise_known,
                }
        };
        let mut groups: Vec<NoiseGroup> = Vec::new();
        for output in &layout.outputs {
            let is_known = is_known(output);
            let weight = &problem.experiments[output.experiment].outputs[output.output].weight;
            let factor = |row: usize| match weight.is_scale() {
                true => 1.0 / output.weights[row - output.range.start],
                false => 1.0,
            };
            let rows = output.noisy_rows().map(|row| (row, factor(row)));
            match groups
                .iter_mut()
                .find(|group| group.variable == output.variable && group.is_known == is_known)
            {
                Some(group) => group.rows.extend(rows),
                None => groups.push(NoiseGroup {
                    variable: output.variable.clone(),
                    is_known,
                    rows: rows.collect(),
                }),
            }
        }
        Ok(Self { groups, priors: layout.priors.iter().map(|prior| prior.index).collect() })
    }

    /// Returns the log density at the parameter values `x` from their residuals.
    pub(super) fn at(&self, parameters: &[Parameter], x: &[f64], residuals: &[f64]) -> f64 {
        let of_group = |group: &NoiseGroup| {
            let squares: f64 =
                group.rows.iter().map(|(row, factor)| (residuals[*row] * factor).powi(2)).sum();
            match group.is_known {
                true => -0.5 * squares,
                false => -0.5 * group.rows.len() as f64 * squares.ln(),
            }
        };
        let of_groups: f64 = self.groups.iter().map(of_group).sum();
        let of_priors: f64 = self.priors.iter().map(|row| -0.5 * residuals[*row].powi(2)).sum();
        // A log-normal density contains 1 / x, unless the logarithm itself is sampled. A normal density of x has the
        // factor x in the coordinate ln x.
        let of_scale =
            |(parameter, x): (&Parameter, &f64)| match (parameter.stated_prior(), parameter.scale_kind()) {
                (Some(Prior::LogNormal { .. }), Scale::Linear) => -x.ln(),
                (Some(Prior::Normal { .. }), Scale::Log) => x.ln(),
                _ => 0.0,
            };
        of_groups + of_priors + parameters.iter().zip(x).map(of_scale).sum::<f64>()
    }
}
