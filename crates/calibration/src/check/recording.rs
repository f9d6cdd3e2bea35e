//! What a recording shows by itself: its times, and values that are constant, clipped or missing.

use super::subject::Subject;
use crate::data::sampling_interval;
use crate::finding::{Finding, Severity};
use ode::Number;

/// A distance of times so many times the usual one is a gap.
const GAP: f64 = 20.0;

/// Fewer different values than these make a column of states or quantised values, for which to stay at its largest is no sign of
/// clipping.
const FEW_VALUES: usize = 20;

/// A part of the values that lies exactly at the largest or the smallest one, in runs of at least so many that are entered at a slope
/// of at least this part of the range in one row, is clipped. A response that settles comes to its end slowly.
const CLIPPED: (f64, usize, f64) = (0.05, 5, 0.01);

/// Times with a gap, twice, far from the start of the simulation, or in another unit than s.
pub(super) fn times(subject: &Subject<'_>) -> Vec<Finding> {
    let Subject { prefix, experiment, description, start_time } = subject;
    let (data, mut findings) = (&experiment.data, Vec::new());
    let time = data.time();
    let name = format!("{prefix}{}", data.source());
    let (first, last) = (time[0], time[time.len() - 1]);
    let Some(interval) = sampling_interval(time) else { return findings };
    let mut find = |severity, sentence: String, remedy: String| {
        findings.push(Finding::new(severity, name.clone(), sentence, remedy));
    };
    let asked = description
        .default_experiment
        .stop_time
        .map(|stop| stop - description.default_experiment.start_time.unwrap_or(0.0));
    if let Some(asked) = asked.filter(|asked| *asked > 0.0) {
        let ratio = (last - first) / asked;
        let unit = [(1e3, "ms"), (1e6, "us"), (1.0 / 60.0, "min"), (1.0 / 3600.0, "h")]
            .into_iter()
            .find(|(factor, _)| (ratio / factor - 1.0).abs() < 0.02);
        // Of ms and us a row is at least one.
        if let Some((_, unit)) = unit.filter(|(factor, _)| *factor < 1.0 || interval >= 0.5) {
            let [duration, asked] = [last - first, asked].map(Number);
            find(
                Severity::Warning,
                format!(
                    "it lasts {duration} s, the experiment that the model suggests {asked} s: the times look as if they were in {unit}"
                ),
                format!("state the unit in the name of the column: 'time [{unit}]'"),
            );
        }
    }
    if first - start_time > 1.5 * interval && experiment.windows.is_empty() {
        let [first, start] = [first, *start_time].map(Number);
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
    let gap =
        time.windows(2).filter(|pair| pair[1] - pair[0] > GAP * interval).map(|pair| (pair[0], pair[1]));
    let gap = gap.max_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)));
    if let Some((from, to)) = gap {
        let [from, to, interval] = [from, to, interval].map(Number);
        find(
            Severity::Note,
            format!("there are no rows from {from} s to {to} s, elsewhere one every {interval} s"),
            "measurements in dense parts count more for it; inputs are linear over the gap".to_owned(),
        );
    }
    findings
}

/// Measured columns that are constant, clipped or mostly missing.
pub(super) fn columns(subject: &Subject<'_>) -> Vec<Finding> {
    let Subject { prefix, experiment, .. } = subject;
    let mut findings = Vec::new();
    for (variable, column) in experiment.outputs() {
        let Ok(values) = experiment.data.column(column) else { continue };
        let name = format!("{prefix}output '{variable}' (column '{column}')");
        let known: Vec<f64> = values.iter().copied().filter(|v| !v.is_nan()).collect();
        let (low, high) =
            known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        if known.len() > 2 && low == high {
            findings.push(Finding::new(
                Severity::Warning,
                name,
                format!("all {} measurements are {}", known.len(), Number(low)),
                "is it the right column? A constant tells little about parameters",
            ));
            continue;
        }
        if known.len() * 10 < values.len() {
            findings.push(Finding::new(
                Severity::Note,
                name.clone(),
                format!("{} of {} rows have a value", known.len(), values.len()),
                "the others are taken as missing",
            ));
        }
        for (limit, what) in [(high, "largest"), (low, "smallest")] {
            if let Some(n) = clipped(&known, limit, high - low) {
                let share = Number((1e3 * n as f64 / known.len() as f64).round() / 10.0);
                findings.push(Finding::new(
                    Severity::Warning,
                    name.clone(),
                    format!(
                        "{share} % of the measurements are exactly {}, its {what} value: clipped?",
                        Number(limit)
                    ),
                    "leave clipped rows empty (NaN), or mask them",
                ));
            }
        }
    }
    findings
}

/// How many values lie at a limit, if it looks as if they were clipped there.
fn clipped(values: &[f64], limit: f64, range: f64) -> Option<usize> {
    let (share, shortest, slope) = CLIPPED;
    let mut n = 0;
    let mut k = 0;
    while k < values.len() {
        let run = values[k..].iter().take_while(|v| **v == limit).count();
        // The last value before the limit may lie next to it.
        let before = values[k.saturating_sub(2)..k].iter().chain([&limit]);
        let steps = before.clone().zip(before.skip(1)).map(|(a, b)| (b - a).abs());
        let entered = steps.fold(0.0, f64::max) > slope * range;
        if run >= shortest && entered {
            n += run;
        }
        k += run.max(1);
    }
    let mut distinct = values.to_vec();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    (n as f64 >= share * values.len() as f64 && n > 0 && distinct.len() >= FEW_VALUES).then_some(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_at_a_limit_are_clipped_where_they_come_there_steeply() {
        let sine: Vec<f64> = (0..200).map(|k| (0.1 * f64::from(k)).sin()).collect();
        let cut: Vec<f64> = sine.iter().map(|v| v.min(0.5)).collect();
        assert_eq!(clipped(&cut, 0.5, 1.5), Some(cut.iter().filter(|v| **v == 0.5).count()));
        assert_eq!(clipped(&sine, 1.0, 2.0), None);
        // a response that settles, as a logger rounds it, and a switch
        let settles: Vec<f64> =
            (0..200).map(|k| (1e3 * (1.0 - (-0.05 * f64::from(k)).exp())).round() / 1e3).collect();
        assert_eq!(clipped(&settles, 1.0, 1.0), None);
        let switch: Vec<f64> = (0..200).map(|k| f64::from(k / 20 % 2)).collect();
        assert_eq!(clipped(&switch, 1.0, 1.0), None);
    }
}
