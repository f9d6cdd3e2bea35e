//! Checks of the times of a recording: a different unit, or times far from the start of the simulation.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{Evaluations, rounded, rounded_time};
use crate::cost::residual::{PointResiduals, sum_of_squares};
use crate::data::{TimeUnit, sampling_interval};
use crate::error::CalibrationError;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use base::Number;
use dfo::RobustLoss;

/// Units in which recordings and models count time.
const UNITS: [&str; 6] = ["us", "ms", "s", "min", "h", "d"];

/// Returns the unit in which the recording is as long as the default experiment of the model: the unit of the
/// times if the recording states none, otherwise the time unit of the model.
fn unit_by_duration(subject: &ExperimentSubject<'_>) -> Option<&'static str> {
    let ((duration, requested), data) = (subject.durations()?, &subject.experiment.data);
    let interval = sampling_interval(data.time())?;
    let model = TimeUnit::of_model(subject.description).length?;
    let is_found = |unit: &&str| {
        let Some((n, d)) = TimeUnit::named(unit, subject.description).length else { return false };
        let ratio = (n / d) * (model.1 / model.0);
        let longer = if data.states_time_unit() { ratio } else { 1.0 / ratio };
        // A row spacing in ms or us is at least one.
        let is_possible = data.states_time_unit() || longer < 1.0 || interval >= 0.5;
        ratio != 1.0 && is_possible && (duration / requested / longer - 1.0).abs() < 0.02
    };
    UNITS.into_iter().find(is_found)
}

/// Returns findings about times or a model in another unit of time. A finding requires that the cost at the
/// start values is lower with this unit, which takes one evaluation. `start` contains the residuals there
/// unless the simulation failed.
///
/// # Errors
/// Returns [`CalibrationError::Cancelled`].
pub(super) fn other_unit(
    calibration: &Calibration,
    subjects: &[ExperimentSubject<'_>],
    (x, start): (&[f64], Option<&PointResiduals>),
    evaluations: &mut Evaluations<'_>,
) -> Result<Vec<Finding>, CalibrationError> {
    let found = |subject: &ExperimentSubject<'_>| {
        Some((unit_by_duration(subject)?, subject.experiment.data.states_time_unit()))
    };
    let Some((unit, is_of_model)) = subjects.iter().find_map(found) else { return Ok(Vec::new()) };
    let mut problem = calibration.problem().clone();
    for (experiment, subject) in problem.experiments.iter_mut().zip(subjects) {
        if !is_of_model && found(subject) == Some((unit, false)) {
            let data = std::mem::take(&mut experiment.data);
            experiment.data = data.with_times_in(TimeUnit::named(unit, subject.description));
        }
    }
    if is_of_model {
        problem.settings.time_unit = Some(unit.to_owned());
    }
    // A setup that is invalid with the other unit does not support it.
    let Ok(other) = calibration.derived(problem) else { return Ok(Vec::new()) };
    evaluations.n += 1;
    let (loss, context) = (RobustLoss::default(), evaluations.context);
    let Some(residuals) = other.residuals_with(None, x, loss, &context, &mut evaluations.stats)? else {
        return Ok(Vec::new());
    };
    let cost = sum_of_squares(&residuals);
    let before = start.map(|start| sum_of_squares(&start.residuals));
    if before.is_some_and(|before| cost >= before) {
        return Ok(Vec::new());
    }
    let falls = before.map_or_else(
        || "can be simulated".to_owned(),
        |before| format!("have the cost {} instead of {}", Number(rounded(cost)), Number(rounded(before))),
    );
    let finding = |subject: &ExperimentSubject<'_>| {
        let ((duration, requested), data) = (subject.durations()?, &subject.experiment.data);
        let [duration, requested] = [duration, requested].map(|time| Number(rounded(time)));
        let own = data.time_unit();
        let (what, remedy) = match is_of_model {
            true => ("The model probably counts its time", format!("Set time_unit = \"{unit}\"")),
            false => (
                "The times are probably",
                format!("State the unit in the name of the column: 'time [{unit}]'"),
            ),
        };
        Some(Finding::warning(
            FindingId::TimeUnit,
            format!("{}{}", subject.prefix, data.source()),
            format!(
                "the recording lasts {duration} {own}, but the default experiment of the model lasts {requested} {own}. In {unit}, the \
                 start values {falls}. {what} in {unit}"
            ),
            remedy,
        ))
    };
    let concerned = subjects.iter().filter(|subject| found(subject) == Some((unit, is_of_model)));
    Ok(concerned.filter_map(finding).collect())
}

/// Returns findings about times that are far from the start of the simulation.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, start_time, .. } = subject;
    let (data, mut findings) = (&experiment.data, Vec::new());
    // A scenario of a design has no rows.
    let Some(&first) = data.time().first() else { return findings };
    let (name, unit) = (format!("{prefix}{}", data.source()), data.time_unit());
    let is_late = sampling_interval(data.time()).is_some_and(|interval| first - start_time > 1.5 * interval);
    if is_late && experiment.windows.is_empty() {
        let [first, start] = [first, *start_time].map(|time| Number(rounded_time(time)));
        findings.push(Finding::warning(
            FindingId::LateFirstRow,
            name,
            format!(
                "the first row is at {first} {unit}, but the simulation starts at {start} {unit}. The state at the first row is then a result of \
                 the simulation"
            ),
            format!("Set start_time={first} if the start values of the model belong to the first row"),
        ));
    }
    findings
}
