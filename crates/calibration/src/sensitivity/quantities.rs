//! Quantities whose dependence on the parameters is analysed.

use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;

/// Function from the cost and the residuals of a point to the values of the quantities. NaN is a missing
/// value.
pub(super) type ValuesOf<'a> = Box<dyn Fn(f64, &[f64]) -> Vec<f64> + Sync + 'a>;

/// Quantities with their names.
pub(super) struct Quantities<'a> {
    pub(super) names: Vec<String>,
    pub(super) values: ValuesOf<'a>,
}

impl<'a> Quantities<'a> {
    /// Returns the cost and the RMS error of each output of each experiment, in the unit of the variable.
    pub(super) fn misfit(calibration: &'a Calibration) -> Self {
        let outputs = &calibration.residual_layout().outputs;
        let experiments = calibration.problem().experiment_names();
        let name = |output: &OutputResiduals| match experiments.len() {
            1 => format!("rms({})", output.variable),
            _ => format!("rms({}: {})", experiments[output.experiment], output.variable),
        };
        Self {
            names: ["cost".to_owned()].into_iter().chain(outputs.iter().map(name)).collect(),
            values: Box::new(|cost, residuals| {
                let errors = outputs.iter().map(|output| rms(output, residuals));
                [cost].into_iter().chain(errors).collect()
            }),
        }
    }
}

/// Returns the root of the mean squared difference between simulation and measurement, without the
/// measurements of weight zero.
fn rms(output: &OutputResiduals, residuals: &[f64]) -> f64 {
    let differences = output.differences(residuals);
    let counted = || differences.iter().zip(&output.weights).filter(|(_, weight)| **weight != 0.0);
    (counted().map(|(d, _)| d * d).sum::<f64>() / counted().count() as f64).sqrt()
}
