//! Checks of the times of a recording: gaps, duplicate rows, another unit, months taken for days.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{rounded, rounded_time};
use crate::data::sampling_interval;
use crate::findings::finding::{Finding, Severity};
use base::Number;

/// A distance of times so many times the usual one is a gap.
const GAP: f64 = 20.0;

/// A day in s.
const DAY: f64 = 24.0 * 3600.0;

/// The unit in which a recording is exactly as long as the experiment that the model suggests in s.
pub(super) fn unit_by_duration(subject: &ExperimentSubject<'_>) -> Option<&'static str> {
    if subject.experiment.data.has_dates() {
        return None;
    }
    let (duration, asked) = subject.durations()?;
    let interval = sampling_interval(subject.experiment.data.time())?;
    let units = [(1e3, "ms"), (1e6, "us"), (1.0 / 60.0, "min"), (1.0 / 3600.0, "h")];
    let unit = units.into_iter().find(|(factor, _)| (duration / asked / factor - 1.0).abs() < 0.02);
    // Of ms and us a row is at least one.
    unit.filter(|(factor, _)| *factor < 1.0 || interval >= 0.5).map(|(_, unit)| unit)
}

/// Rows that jump from one month to the same day of the next where the next day would follow: what is found,
/// and what to do.
fn months(time: &[f64], interval: f64) -> Option<(String, &'static str)> {
    let is_month = |seconds: f64| {
        let days = seconds / DAY;
        (27.5..31.5).contains(&days) && (days - days.round()).abs() * DAY < 1.0
    };
    let remedy = "write dates as 2024-05-31, year, month, day; if the rows are a month apart, all is well";
    let distances = || time.windows(2).map(|pair| pair[1] - pair[0]).filter(|distance| *distance > 0.0);
    if distances().count() > 1 && distances().all(is_month) {
        let sentence = "its rows are a month of the calendar apart: are day and month swapped, and the rows a day apart?";
        return Some((sentence.to_owned(), remedy));
    }
    // From the last row of a day to the first of the next there is the usual distance.
    let mut jumps = distances().filter(|distance| *distance > DAY + interval).peekable();
    let is_swapped =
        interval < DAY && jumps.peek().is_some() && jumps.all(|jump| is_month(jump - interval + DAY));
    is_swapped.then(|| {
        let sentence = "from the end of a day its times jump to the same day of the next month: are day and month swapped?";
        (sentence.to_owned(), remedy)
    })
}

/// Times with a gap, twice, far from the start of the simulation, or in another unit than s.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, start_time, .. } = subject;
    let (data, mut findings) = (&experiment.data, Vec::new());
    let time = data.time();
    let name = format!("{prefix}{}", data.source());
    let first = time[0];
    let Some(interval) = sampling_interval(time) else { return findings };
    let mut find = |severity, sentence: String, remedy: String| {
        findings.push(Finding::new(severity, name.clone(), sentence, remedy));
    };
    if let Some((unit, (duration, asked))) = unit_by_duration(subject).zip(subject.durations()) {
        let [duration, asked] = [duration, asked].map(|seconds| Number(rounded(seconds)));
        find(
            Severity::Warning,
            format!(
                "it lasts {duration} s, the experiment that the model suggests {asked} s: the times look as if they were in {unit}"
            ),
            format!("state the unit in the name of the column: 'time [{unit}]'"),
        );
    }
    if let Some((found, remedy)) = months(time, interval) {
        find(Severity::Warning, found, remedy.to_owned());
    }
    if first - start_time > 1.5 * interval && experiment.windows.is_empty() {
        let [first, start] = [first, *start_time].map(|time| Number(rounded_time(time)));
        find(
            Severity::Warning,
            format!("its first row is at {first} s, the simulation starts at {start} s"),
            format!("give start_time={first} if the model's start values are those of the first row"),
        );
    }
    let twice = time.windows(2).filter(|pair| pair[0] == pair[1]).count();
    if twice > 0 && experiment.inputs.is_empty() {
        let rows = if twice == 1 { "one time stands".to_owned() } else { format!("{twice} times stand") };
        find(Severity::Note, format!("{rows} there twice"), "remove one of both rows".to_owned());
    }
    // The interval is a difference of times, too.
    let longest = GAP * interval + (GAP + 1.0) * base::time_tolerance(first, time[time.len() - 1]);
    let gap = time.windows(2).filter(|pair| pair[1] - pair[0] > longest).map(|pair| (pair[0], pair[1]));
    let gap = gap.max_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)));
    if let Some((from, to)) = gap {
        let [from, to, interval] = [from, to, interval].map(|time| Number(rounded_time(time)));
        find(
            Severity::Note,
            format!("there are no rows from {from} s to {to} s, elsewhere one every {interval} s"),
            "measurements in dense parts count more for it; inputs are linear over the gap".to_owned(),
        );
    }
    findings
}
