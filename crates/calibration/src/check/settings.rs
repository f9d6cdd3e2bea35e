//! Checks of the accuracy of the simulation settings: a loose tolerance, a step that is too large.

use super::series::{Evaluations, Place, all_series, rounded, size_of_difference};
use crate::cost::accuracy::Accuracy;
use crate::cost::calibration::Calibration;
use crate::cost::failure::NoCost;
use crate::cost::residual::{CostRule, PointResiduals};
use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use dfo::RobustLoss;
use ode::Number;

/// Simulations with a larger relative tolerance than this are rather a sketch.
const LOOSE: f64 = 1e-3;

/// Half the step may change an output by this part of what the measurements vary by.
const STEP_ERROR: f64 = 0.01;

/// A relative tolerance that was given, and is so large that simulations say little.
pub(super) fn loose_tolerance(calibration: &Calibration) -> Option<Finding> {
    let given = calibration.problem().settings.relative_tolerance?;
    (given > LOOSE && !calibration.has_fixed_step()).then(|| {
        Finding::new(
            Severity::Warning,
            "relative tolerance",
            format!(
                "relative_tolerance {} lets each step of a simulation err by {} % of its values: costs jump, and the best values shift",
                Number(given),
                Number(rounded(100.0 * given))
            ),
            "leave it out, or give 1e-6",
        )
    })
}

/// A fixed step that is too large: half of it changes an output by more than counts. One evaluation, where
/// the step is fixed.
///
/// # Errors
/// [`CalibrationError::Cancelled`].
pub(super) fn large_step(
    calibration: &Calibration,
    at: &PointResiduals,
    place: Place,
    evaluations: &mut Evaluations<'_>,
) -> Result<Option<Finding>, CalibrationError> {
    if !calibration.has_fixed_step() {
        return Ok(None);
    }
    evaluations.n += 1;
    let mut residuals = vec![0.0; calibration.n_residuals()];
    let rule = CostRule::whole(RobustLoss::default(), &evaluations.context);
    let stats = &mut evaluations.stats;
    match calibration.evaluate_with(Accuracy::HalfStep, &at.x, rule, &mut residuals, stats) {
        Ok(_) => {}
        Err(NoCost::Cancelled) => return Err(CalibrationError::Cancelled),
        Err(_) => return Ok(None),
    }
    let method = calibration.problem().settings.method.name();
    let [whole, half] = [&at.residuals, &residuals].map(|residuals| all_series(calibration, residuals));
    let changes = whole.iter().zip(&half).map(|(whole, half)| {
        let changed = size_of_difference(&whole.simulated, half.simulated.iter().copied());
        let mean = whole.of.measured.iter().sum::<f64>() / whole.of.measured.len() as f64;
        (changed, size_of_difference(&whole.of.measured, std::iter::repeat(mean)), whole.of)
    });
    let largest = changes.filter(|(changed, sd, _)| *changed > STEP_ERROR * sd);
    let largest = largest.max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    Ok(largest.map(|(changed, sd, of)| {
        Finding::new(
            Severity::Warning,
            "step",
            format!(
                "half the step of the solver '{method}' changes '{}' {place} by {} (RMS), where its measurements vary by {} (standard \
                 deviation): the step is too large",
                of.variable,
                Number(rounded(changed)),
                Number(rounded(sd))
            ),
            "give a smaller step_size, or a solver that chooses its steps",
        )
    }))
}
