//! Checks of the simulation settings: a step that is too large or too small.

use super::simulated_outputs::{Evaluations, Place, all_series, rounded, size, size_of_difference};
use crate::cost::accuracy::Accuracy;
use crate::cost::residual::PointResiduals;
use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use base::Number;
use dfo::RobustLoss;

/// Maximum change of an output by half the step, as a part of the standard deviation of the measurements.
const STEP_ERROR: f64 = 0.01;

/// Returns a finding if a simulation requires more than a million steps of equal length.
pub(super) fn many_steps(calibration: &Calibration) -> Option<Finding> {
    let sentence = calibration.evaluator().simulations.iter().find_map(|s| s.pool.plan().many_steps())?;
    Some(Finding::warning(FindingId::ManySteps, "step", sentence, "Set a larger step_size"))
}

/// Returns a finding if the fixed step, or the communication step of a co-simulation, is too large. This is
/// the case if half the step changes an output significantly or, for a fitted co-simulation, by more than its
/// residuals. Requires one evaluation if there is such a step.
///
/// # Errors
/// Returns [`CalibrationError::Cancelled`].
pub(super) fn large_step(
    calibration: &Calibration,
    at: &PointResiduals,
    place: Place,
    evaluations: &mut Evaluations<'_>,
) -> Result<Option<Finding>, CalibrationError> {
    let is_co_simulation = calibration.is_co_simulation();
    if !calibration.has_fixed_step() && !is_co_simulation {
        return Ok(None);
    }
    evaluations.n += 1;
    let (loss, context) = (RobustLoss::default(), evaluations.context);
    let half = Some(Accuracy::HalfStep);
    let residuals = calibration.residuals_with(half, &at.x, loss, &context, &mut evaluations.stats)?;
    let Some(residuals) = residuals else { return Ok(None) };
    let step = match is_co_simulation {
        true => "the communication step".to_owned(),
        false => format!("the step of the solver '{}'", calibration.problem().settings.run.method.name()),
    };
    let [whole, half] = [&at.residuals, &residuals].map(|residuals| all_series(calibration, residuals));
    let changes = whole.iter().zip(&half).map(|(whole, half)| {
        let measured = &whole.of.measured;
        let changed = size_of_difference(&whole.simulated, half.simulated.iter().copied());
        let (limit, beside) = match is_co_simulation && place == Place::Fitted {
            true => {
                let left = size_of_difference(measured, whole.simulated.iter().copied());
                // If the residuals consist only of simulation errors, the tolerance of the model determines
                // the limit.
                let least = 10.0 * calibration.relative_tolerance() * size(measured.iter().copied());
                (left.max(least), format!("its residuals have an RMS of {}", Number(rounded(left))))
            }
            false => {
                let mean = measured.iter().sum::<f64>() / measured.len() as f64;
                let sd = size_of_difference(measured, std::iter::repeat(mean));
                let beside = format!("its measurements vary by {} (standard deviation)", Number(rounded(sd)));
                (STEP_ERROR * sd, beside)
            }
        };
        (changed, limit, beside, &whole.of.variable)
    });
    let largest = changes.filter(|(changed, limit, ..)| changed > limit);
    let largest = largest.max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)));
    Ok(largest.map(|(changed, _, beside, variable)| {
        let (changed, too_large) = (
            Number(rounded(changed)),
            if is_co_simulation { "The results depend on the step" } else { "The step is too large" },
        );
        let smaller = Accuracy::smaller_step(calibration.step_in_use());
        let remedy = match is_co_simulation {
            true => smaller,
            false => format!("{smaller}, or use a solver that chooses its steps"),
        };
        let sentence =
            format!("half {step} changes '{variable}' {place} by {changed} (RMS), and {beside}. {too_large}");
        Finding::warning(FindingId::InaccurateSimulation, "step", sentence, remedy)
    }))
}
