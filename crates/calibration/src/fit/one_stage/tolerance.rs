//! Choice of the relative tolerance of the simulations of a fit, small enough for its `f_tol`.

use super::noise::{EstimatedNoise, NoiseRule};
use super::search::Job;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;
use base::Number;
use dfo::{RobustLoss, ToleranceMeasure};
use fmi::InterfaceKind;
use serde::{Deserialize, Serialize};

/// Relative tolerance chosen for the simulations of a fit if the user did not specify one.
///
/// Simulations with a tolerance T are assumed to change the residuals by T times the measurements, a change
/// with the norm `d`. Near the best values, the N residuals are noise of size s. The cost then has the
/// relative uncertainty `2 d / (N s) + d^2 / (N s^2)`, because error and noise are independent.
///
/// T is the tolerance of the calibration, which is the tolerance of the model but at most 1e-6. The chosen
/// tolerance is the first of T, T / 10, T / 100 and so on whose uncertainty is below 0.3 `f_tol`. The noise s
/// is estimated from the differences between neighbouring measurements. If `f_tol` is at least 100 times the
/// tolerance of the model, T is used.
///
/// The choice requires no simulation. The [uncertainty](super::Fit::uncertainty) of the fit compares the
/// result with a more accurate simulation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct ChosenTolerance {
    /// Tolerance of the simulations of the fit.
    pub used: f64,
    /// Tolerance of the model, or the default.
    pub stated: f64,
    /// Expected relative uncertainty of the cost near the best values with the tolerance T of the
    /// calibration. `None` if it was not estimated.
    pub noise: Option<f64>,
}

/// Maximum uncertainty of the cost as a part of `f_tol`. The errors of different points differ.
const SHARE: f64 = 0.3;

/// With a tolerance below this part of `f_tol`, the cost is smooth enough.
const SMALL_ENOUGH: f64 = 0.01;

/// Smallest tolerance that is chosen.
const SMALLEST: f64 = 1e-9;

/// Minimum noise that measurements are assumed to have, relative to their size.
const LEAST_NOISE: f64 = 1e-4;

impl ChosenTolerance {
    /// Returns a finding if the tolerance is smaller than the tolerance of the model.
    pub(crate) fn finding(&self) -> Option<Finding> {
        let [used, stated] = [self.used, self.stated].map(Number);
        let sentence = format!(
            "simulations use the relative tolerance {used} instead of {stated}, with which the cost would be noisier than f_tol allows"
        );
        let remedy = "Set relative_tolerance to override it";
        let finding = || Finding::note(FindingId::ChosenTolerance, "relative tolerance", sentence, remedy);
        (self.used < self.stated).then(finding)
    }
}

impl Calibration {
    /// Chooses the tolerance of a fit. Returns `None` if the tolerance is given, a co-simulation has its own,
    /// the step is fixed, or `f_tol` is zero.
    pub(crate) fn choose_tolerance(&self, job: &Job<'_>) -> Option<ChosenTolerance> {
        let (loss, tolerances) = (job.loss, &job.run.tolerances);
        let stated = self.fmu().description().default_experiment.tolerance.filter(|t| *t > 0.0 && *t < 1.0);
        let plan = self.evaluator().simulations[0].pool.plan();
        let is_given = self.problem().settings.run.relative_tolerance.is_some();
        let has_model_tolerance = stated.is_none() && plan.kind() != InterfaceKind::ModelExchange;
        if is_given || has_model_tolerance || self.has_fixed_step() || tolerances.f_tol == 0.0 {
            return None;
        }
        let first = plan.relative_tolerance();
        let stated = stated.unwrap_or(first);
        let chosen = ChosenTolerance { used: first, stated, noise: None };
        let is_relative = tolerances.measure == ToleranceMeasure::Relative;
        // Allow for the rounding of the product.
        if is_relative && stated <= SMALL_ENOUGH * tolerances.f_tol * (1.0 + 1e-9) {
            return Some(chosen);
        }
        let (n, size) = (self.n_measurements() as f64, self.residual_layout().size_of_measurements());
        let least = self.squares_of_noise(loss).max(f64::MIN_POSITIVE);
        let uncertain = |tolerance: f64| {
            let error = tolerance * size;
            2.0 * error / (n * least).sqrt() + error * error / least
        };
        let most = SHARE * if is_relative { tolerances.f_tol } else { tolerances.f_tol / least };
        let part = |tenths: i32| first / 10f64.powi(tenths);
        let mut tenths = 0;
        while uncertain(part(tenths)) > most && part(tenths + 1) >= SMALLEST {
            tenths += 1;
        }
        Some(ChosenTolerance { used: part(tenths), noise: Some(uncertain(first)), ..chosen })
    }

    /// Returns the expected sum of the squared residuals due to noise, from the differences between
    /// neighbouring measurements.
    fn squares_of_noise(&self, loss: RobustLoss) -> f64 {
        let Ok(Some(noise)) = EstimatedNoise::first(self, NoiseRule::Estimated, true) else { return 0.0 };
        let of = |output: &OutputResiduals| {
            let weighted = output.measured.iter().zip(&output.weights).map(|(y, w)| y * w);
            let size: f64 = weighted.map(|y| y * y).sum();
            let of_noise = loss.transform(noise.of_weighted(self.problem(), output)).powi(2);
            (output.measured.len() as f64 * of_noise).max(LEAST_NOISE * LEAST_NOISE * size)
        };
        self.residual_layout().outputs.iter().map(of).sum()
    }
}
