//! Checks of the times of a recording: a different unit, or times far from the start of the simulation.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{rounded, rounded_time};
use crate::data::sampling_interval;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use base::Number;

/// Returns the unit in which the recording is as long as the default experiment of the model in s.
fn unit_by_duration(subject: &ExperimentSubject<'_>) -> Option<&'static str> {
    if subject.experiment.data.has_dates() {
        return None;
    }
    let (duration, requested) = subject.durations()?;
    let interval = sampling_interval(subject.experiment.data.time())?;
    let units = [(1e3, "ms"), (1e6, "us"), (1.0 / 60.0, "min"), (1.0 / 3600.0, "h")];
    let unit = units.into_iter().find(|(factor, _)| (duration / requested / factor - 1.0).abs() < 0.02);
    // A row spacing in ms or us is at least one.
    unit.filter(|(factor, _)| *factor < 1.0 || interval >= 0.5).map(|(_, unit)| unit)
}

/// Returns findings about times that are far from the start of the simulation, or in a different unit than s.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, start_time, .. } = subject;
    let (data, mut findings) = (&experiment.data, Vec::new());
    let (name, first) = (format!("{prefix}{}", data.source()), data.time()[0]);
    if let Some((unit, (duration, requested))) = unit_by_duration(subject).zip(subject.durations()) {
        let [duration, requested] = [duration, requested].map(|seconds| Number(rounded(seconds)));
        findings.push(Finding::warning(
            FindingId::TimeUnit,
            name.clone(),
            format!(
                "the recording lasts {duration} s, but the default experiment of the model lasts {requested} s. The times are probably in {unit}"
            ),
            format!("State the unit in the name of the column: 'time [{unit}]'"),
        ));
    }
    let is_late = sampling_interval(data.time()).is_some_and(|interval| first - start_time > 1.5 * interval);
    if is_late && experiment.windows.is_empty() {
        let [first, start] = [first, *start_time].map(|time| Number(rounded_time(time)));
        findings.push(Finding::warning(
            FindingId::LateFirstRow,
            name,
            format!(
                "the first row is at {first} s, but the simulation starts at {start} s. The state at the first row is then a result of \
                 the simulation"
            ),
            format!("Set start_time={first} if the start values of the model belong to the first row"),
        ));
    }
    findings
}
