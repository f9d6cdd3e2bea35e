//! Experiment as the subject of a check.

use crate::data::UnitConversion;
use crate::problem::column_units::declared;
use crate::problem::experiment::Experiment;
use crate::problem::parameter::Parameter;
use fmi::ModelDescription;

/// Experiment as the subject of a check.
pub(super) struct ExperimentSubject<'a> {
    /// Prefix of its findings: its name and a colon if there are several experiments, otherwise empty.
    pub(super) prefix: String,
    pub(super) experiment: &'a Experiment,
    pub(super) description: &'a ModelDescription,
    /// Parameters of the fit.
    pub(super) parameters: &'a [Parameter],
    /// Start time of the simulation.
    pub(super) start_time: f64,
}

/// Common units of various quantities, used as examples.
const EXAMPLES: [&str; 16] =
    ["mm", "degC", "K", "deg", "rpm", "bar", "km/h", "ms", "g", "cm2", "l", "l/min", "kg/h", "kW", "%", "Hz"];

impl ExperimentSubject<'_> {
    /// Returns the durations of the recording and of the default experiment of the model. A scenario of a
    /// design has no recording.
    pub(super) fn durations(&self) -> Option<(f64, f64)> {
        let suggested = &self.description.default_experiment;
        let requested = suggested.stop_time? - suggested.start_time.unwrap_or(0.0);
        let time = self.experiment.data.time();
        let duration = time.last()? - time.first()?;
        (requested > 0.0).then_some((duration, requested))
    }

    /// Returns a different unit in which values of a variable may be recorded. Returns `None` if the model
    /// declares no unit or an unknown one.
    pub(super) fn example_unit(&self, variable: &str) -> Option<String> {
        let variable = declared(self.description, variable)?;
        let unit_of_variable = variable.unit.as_deref()?;
        let is_other = |unit: &String| {
            UnitConversion::to_variable(unit, variable, self.description).is_ok_and(|c| !c.is_identity())
        };
        let with_prefix = ["m", "k"].map(|prefix| format!("{prefix}{unit_of_variable}"));
        EXAMPLES.iter().map(|unit| (*unit).to_owned()).chain(with_prefix).find(is_other)
    }
}
