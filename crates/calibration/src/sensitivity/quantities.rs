//! Quantities whose dependence on the parameters is analysed.

use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;

/// Results of the simulations of a point.
pub(super) struct PointResults<'a> {
    pub(super) x: &'a [f64],
    pub(super) cost: f64,
    pub(super) residuals: &'a [f64],
    /// Criteria of all experiments.
    pub(super) criteria: &'a [f64],
}

/// Function from the results of a point to the values of the quantities. NaN is a missing value.
pub(super) type ValuesOf<'a> = Box<dyn Fn(&PointResults<'_>) -> Vec<f64> + Sync + 'a>;

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
            values: Box::new(|point| {
                let errors = outputs.iter().map(|output| rms(output, point.residuals));
                [point.cost].into_iter().chain(errors).collect()
            }),
        }
    }

    /// Returns the goals of a design, and the criteria of each scenario.
    pub(super) fn design(calibration: &'a Calibration) -> Self {
        let (problem, evaluator) = (calibration.problem(), calibration.evaluator());
        let are_several = evaluator.simulations.len() > 1;
        let of_scenario = evaluator.simulations.iter().flat_map(|simulation| {
            simulation.criteria.texts().iter().map(move |text| match are_several {
                true => format!("{}: {text}", simulation.name),
                false => text.clone(),
            })
        });
        let goals = problem.goals.iter().map(|goal| goal.text().to_owned());
        // A goal that is a criterion would appear twice.
        let is_goal = |text: &String| !are_several && problem.goals.iter().any(|goal| goal.text() == text);
        let criteria: Vec<(usize, String)> =
            of_scenario.enumerate().filter(|(_, text)| !is_goal(text)).collect();
        let places: Vec<usize> = criteria.iter().map(|(place, _)| *place).collect();
        Self {
            names: goals.chain(criteria.into_iter().map(|(_, text)| text)).collect(),
            values: Box::new(move |point| {
                let goals = &evaluator.goals;
                let value = |k: usize| goals.value(k, point.x, point.criteria);
                let criterion = |place: &usize| point.criteria.get(*place).copied().unwrap_or(f64::NAN);
                (0..goals.len()).map(value).chain(places.iter().map(criterion)).collect()
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
