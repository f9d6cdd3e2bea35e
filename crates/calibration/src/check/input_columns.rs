//! Checks of the columns that drive inputs: only zeros, long gaps, values outside the range of the model, and
//! degC instead of K.

use super::experiment_subject::ExperimentSubject;
use super::parameters::{GivenRange, beside_the_model};
use super::simulated_outputs::{rounded, rounded_time};
use crate::data::sampling_interval;
use crate::findings::finding::{Finding, Severity};
use crate::findings::identifier::FindingId;
use crate::problem::column_units::declared;
use base::Number;
use fmi::description::{Variability, Variable};

/// Minimum length of a gap in an input, in sampling intervals.
const LONG_GAP: f64 = 3.0;
/// An input with values in less than this fraction of the rows is recorded only when it changes, so gaps are
/// permitted.
const SPARSE: f64 = 0.5;

/// Values beyond the range of the model by less than this part of their range are sensor noise.
const NOISE: f64 = 0.05;

/// Maximum number of levels of a switching input. The note is true for any number; it is of interest for few.
const FEW_LEVELS: usize = 10;

/// Rows of an input that have a value.
struct Rows {
    times: Vec<f64>,
    values: Vec<f64>,
}

/// Returns the findings about all columns that drive inputs. Constants, steps, ramps, pulses, and inputs at a
/// limit of an actuator are accepted.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, .. } = subject;
    let mut findings = Vec::new();
    for (input, column) in experiment.driving_columns() {
        let Some((variable, rows)) = driving(subject, input, column) else { continue };
        let name = format!("{prefix}input '{input}' (column '{column}')");
        let is_interpolated = variable.variability == Variability::Continuous && !experiment.holds(input);
        if let Some((levels, jumps)) = rows.switches().filter(|_| is_interpolated) {
            findings.push(Finding::new(
                Severity::Note,
                FindingId::SwitchingInput,
                name.clone(),
                format!(
                    "the values switch between {levels} levels (jumps: {jumps}). The simulation connects the rows with straight lines, \
                     so each jump takes one row spacing"
                ),
                "Hold the values between the rows if the actuator switches (Hold(column) in Python, hold = true in a problem file)",
            ));
        }
        if let Some(zero) = rows.all_zero(&name, variable) {
            findings.push(zero);
            continue;
        }
        let mut warn = |id, sentence: String, remedy: &str| {
            findings.push(Finding::warning(id, name.clone(), sentence, remedy));
        };
        if let Some((output, _)) = experiment.outputs().find(|(_, compared)| *compared == column) {
            warn(
                FindingId::SharedColumn,
                format!(
                    "the column is also compared with the output '{output}'. One of the two is probably wrong"
                ),
                "Check both column names",
            );
        }
        let beside = rows.extent().and_then(|(lowest, highest)| {
            let noise = NOISE * (highest - lowest);
            let given = GivenRange { lowest: lowest + noise, highest: highest - noise, is_constant: false };
            beside_the_model(variable, given)
        });
        if let Some(beside) = beside {
            let [low, high] = [rows.lowest(), rows.highest()].map(|value| Number(rounded(value)));
            let unit = variable.unit.as_deref().unwrap_or_default();
            let in_unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            warn(
                FindingId::ValueUnlikeModel,
                format!(
                    "the values lie between {low} and {high}{in_unit}, but {beside}. The unit is probably wrong"
                ),
                "Convert the values to the unit of the model, or state their unit in the name of the column",
            );
        }
    }
    findings.extend(gaps(subject));
    findings
}

/// Returns the variable of an input and the rows of its column with a value, if there are at least three.
fn driving<'s>(subject: &ExperimentSubject<'s>, input: &str, column: &str) -> Option<(&'s Variable, Rows)> {
    let data = &subject.experiment.data;
    let rows = data.time().iter().zip(data.column(column).ok()?).filter(|(_, v)| !v.is_nan());
    let (times, values): (Vec<f64>, Vec<f64>) = rows.unzip();
    let variable = declared(subject.description, input)?;
    (values.len() >= 3).then_some((variable, Rows { times, values }))
}

/// Returns the findings about long gaps in inputs.
pub(super) fn gaps(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let of = |(input, column): (&str, &str)| {
        let (variable, rows) = driving(subject, input, column)?;
        let is_continuous =
            variable.variability == Variability::Continuous && !subject.experiment.holds(input);
        let data = &subject.experiment.data;
        let (sentence, remedy) = rows.gap(data.time(), data.time_unit(), is_continuous)?;
        let name = format!("{}input '{input}' (column '{column}')", subject.prefix);
        Some(Finding::warning(FindingId::InputGap, name, sentence, remedy))
    };
    subject.experiment.driving_columns().filter_map(of).collect()
}

impl Rows {
    fn lowest(&self) -> f64 {
        self.values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn highest(&self) -> f64 {
        self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    fn extent(&self) -> Option<(f64, f64)> {
        let (lowest, highest) = (self.lowest(), self.highest());
        (lowest.is_finite() && highest.is_finite()).then_some((lowest, highest))
    }

    /// Returns the number of levels and of jumps if the input switches: it has two levels, or a few levels
    /// and skips one of them in a jump. A coarsely quantised continuous signal changes only to a neighbouring
    /// level. A jump at a repeated time is already held.
    fn switches(&self) -> Option<(usize, usize)> {
        let mut levels: Vec<f64> = Vec::new();
        for value in &self.values {
            if let Err(at) = levels.binary_search_by(|level| level.total_cmp(value)) {
                levels.insert(at, *value);
                if levels.len() > FEW_LEVELS {
                    return None;
                }
            }
        }
        let level = |k: usize| levels.binary_search_by(|level| level.total_cmp(&self.values[k])).unwrap_or(0);
        let jumps: Vec<usize> = (1..self.values.len())
            .filter(|k| self.times[k - 1] < self.times[*k])
            .map(|k| level(k).abs_diff(level(k - 1)))
            .filter(|distance| *distance > 0)
            .collect();
        let is_switching = levels.len() == 2 || jumps.iter().any(|distance| *distance > 1);
        (is_switching && !jumps.is_empty()).then_some((levels.len(), jumps.len()))
    }

    /// Returns a finding if an input is always zero. It may be intended if the model's own value is also
    /// zero.
    fn all_zero(&self, name: &str, variable: &Variable) -> Option<Finding> {
        let start = match variable.start {
            Some(fmi::Value::Real(start)) => start,
            _ => 0.0,
        };
        let (severity, beside) = match start {
            0.0 => (Severity::Note, ". The input has no effect".to_owned()),
            start => (
                Severity::Warning,
                format!(
                    ", but the start value in the model is {}. The simulation lacks the effect of the input",
                    Number(rounded(start))
                ),
            ),
        };
        self.values.iter().all(|value| *value == 0.0).then(|| {
            let sentence = format!("all {} values are 0{beside}", self.values.len());
            Finding::new(severity, FindingId::ZeroInput, name, sentence, "Check that it is the right column")
        })
    }

    /// Returns the sentence and the remedy for long gaps in the recording. If `is_continuous`, the input
    /// is interpolated linearly there. Otherwise, it keeps its value.
    fn gap(&self, time: &[f64], unit: &str, is_continuous: bool) -> Option<(String, &'static str)> {
        let interval = sampling_interval(&self.times)?;
        let is_sparse = (self.times.len() as f64) < SPARSE * time.len() as f64;
        // The interval and the gap are differences of times.
        let tolerance =
            (LONG_GAP + 1.0) * base::time_tolerance(self.times[0], self.times[self.times.len() - 1]);
        let longest = LONG_GAP * interval;
        let is_gap = |k: &usize| {
            let (from, to) = (self.times[k - 1], self.times[*k]);
            let first_after = time.partition_point(|t| *t <= from);
            let is_between = time.get(first_after).is_some_and(|t| *t < to);
            to - from > longest + tolerance && !is_sparse && is_between
        };
        let of = |k: usize| self.times[k] - self.times[k - 1];
        let gaps: Vec<usize> = (1..self.times.len()).filter(is_gap).collect();
        let largest = gaps.iter().copied().max_by(|a, b| of(*a).total_cmp(&of(*b)))?;
        let [from, to, interval] =
            [self.times[largest - 1], self.times[largest], interval].map(|t| Number(rounded_time(t)));
        let length = |duration: f64| Number(rounded(duration));
        let of_all = match gaps.len() {
            1 => String::new(),
            n => format!(
                ", and {} more such gaps, {} {unit} in total",
                n - 1,
                length(gaps.iter().map(|k| of(*k)).sum())
            ),
        };
        let taken = match is_continuous {
            true => "The simulation uses a straight line there",
            false => "The simulation holds the last value there",
        };
        Some((
            format!(
                "the input has no value from {from} {unit} to {to} {unit} ({} {unit}), elsewhere one every {interval} {unit}{of_all}. {taken}",
                length(of(largest))
            ),
            "Fill the gap with the values of the input, or exclude its time with windows and start_time",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(n: usize, of: impl Fn(usize) -> f64) -> Rows {
        Rows { times: (0..n).map(|k| 0.05 * k as f64).collect(), values: (0..n).map(of).collect() }
    }

    fn sine(k: usize) -> f64 {
        (0.065 * k as f64).sin()
    }

    #[test]
    fn switching_input_has_few_levels_and_jumps() {
        assert_eq!(rows(40, |k| f64::from(u8::from((k / 7).is_multiple_of(2)))).switches(), Some((2, 5)));
        assert_eq!(rows(9, |k| [0.0, 5.0, 20.0][k / 2 * 2 % 3]).switches(), Some((3, 4)));
        // A quantised ramp, a sine and a constant do not switch.
        assert_eq!(rows(40, |k| (k as f64 / 10.0).floor()).switches(), None);
        assert_eq!(rows(40, sine).switches(), None);
        assert_eq!(rows(40, |_| 1.0).switches(), None);
        // The rows are already doubled.
        let doubled =
            Rows { times: vec![0.0, 1.0, 1.0, 2.0, 2.0, 3.0], values: vec![0.0, 0.0, 1.0, 1.0, 0.0, 0.0] };
        assert_eq!(doubled.switches(), None);
    }

    #[test]
    fn input_gap_is_reported_when_the_recording_continues() {
        let all = rows(400, sine);
        let without = |left_out: std::ops::Range<usize>| {
            let kept = || (0..400).filter(|k| !left_out.contains(k));
            Rows { times: kept().map(|k| all.times[k]).collect(), values: kept().map(sine).collect() }
        };
        let reported = without(150..250).gap(&all.times, "s", true).unwrap().0;
        assert!(
            reported.starts_with(
                "the input has no value from 7.45 s to 12.5 s (5.05 s), elsewhere one every 0.05 s. "
            ),
            "{reported}"
        );
        assert!(without(150..152).gap(&all.times, "s", true).is_none());
        assert!(
            without(150..153).gap(&all.times, "s", false).unwrap().0.ends_with("holds the last value there")
        );
        // Both ends of a gap may be equal, but the values between them are still unknown.
        let square = |k: usize| f64::from(u8::from((k / 40).is_multiple_of(2)));
        let kept = || (0..400).filter(|k| !(100..260).contains(k) && !(300..310).contains(k));
        let square =
            Rows { times: kept().map(|k| all.times[k]).collect(), values: kept().map(square).collect() };
        let reported = square.gap(&all.times, "s", true).unwrap().0;
        assert!(
            reported.contains("(8.05 s), elsewhere one every 0.05 s, and 1 more such gaps, 8.6 s in total"),
            "{reported}"
        );
        // The recording itself has no rows in the gap.
        let gap = without(150..250);
        assert!(gap.gap(&gap.times, "s", true).is_none());
        // Every tenth row has a value.
        let tenth = || (0..400).step_by(10);
        let slow =
            Rows { times: tenth().map(|k| all.times[k]).collect(), values: tenth().map(sine).collect() };
        assert!(slow.gap(&all.times, "s", true).is_none());
    }
}
