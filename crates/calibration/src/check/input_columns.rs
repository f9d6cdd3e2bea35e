//! Checks of the columns that drive inputs: all zero, frozen, with a value far off, missing for long, beyond
//! the range of the model or in degC for K.

use super::columns::{FEW_VALUES, frozen, longest_run, n_distinct, placeholder};
use super::experiment_subject::ExperimentSubject;
use super::parameters::{GivenRange, beside_the_model};
use super::simulated_outputs::{range, rounded, rounded_time, size_of_difference};
use crate::data::sampling_interval;
use crate::findings::finding::{Finding, Severity};
use crate::problem::column_units::declared;
use base::Number;
use fmi::description::{Variability, Variable};

/// A value that lies so many ranges of all others away from them, in one row of a signal whose rows follow
/// each other, is none of the signal: an impulse on a signal at rest, or on noise, is meant.
const FAR: f64 = 100.0;

/// Autocorrelation from row to row from which on rows follow each other.
const FOLLOWS: f64 = 0.5;

/// A value that stays for so many rows,
const STAYS: usize = 10;
/// in a signal that else never stays for more than these,
const STAYS_ELSE: usize = 2;
/// and ends by a step so many times as large as nearly all others, stands still.
const LEAPS: f64 = 5.0;

/// So many of the sampling intervals of an input without a value are a gap;
const LONG_GAP: f64 = 3.0;
/// of one with a value in fewer rows than this part of them, which is recorded when it changes, so many are,
const SPARSE: f64 = 0.5;
const LONG_GAP_OF_SPARSE: f64 = 20.0;
/// if its ends differ by this part of the range.
const CHANGE_IN_GAP: f64 = 0.01;

/// Values beyond the range of the model by less than this part of their own range are noise of a sensor.
const NOISE: f64 = 0.05;

/// Rows of an input that have a value.
struct Rows {
    times: Vec<f64>,
    values: Vec<f64>,
}

/// The findings about all columns that drive inputs. Constants, steps, ramps, pulses, and inputs at a limit,
/// which actuators have, are as good as others.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, .. } = subject;
    let mut findings = Vec::new();
    for (input, column) in experiment.driving_columns() {
        let Some((variable, rows)) = driving(subject, input, column) else { continue };
        let name = format!("{prefix}input '{input}' (column '{column}')");
        if let Some(zero) = rows.all_zero(&name, variable) {
            findings.push(zero);
            continue;
        }
        let mut warn = |(sentence, remedy): (String, &str)| {
            findings.push(Finding::warning(name.clone(), sentence, remedy));
        };
        if let Some((output, _)) = experiment.outputs().find(|(_, compared)| *compared == column) {
            warn((
                format!("its column is compared with the output '{output}', too"),
                "is it the right column?",
            ));
        }
        let spike = rows.spike();
        spike.iter().for_each(|found| warn(found.clone()));
        rows.stands_still().into_iter().for_each(&mut warn);
        // One value that is none of the signal is not its unit.
        let given = rows.extent().filter(|_| spike.is_none());
        let beside = given.and_then(|(lowest, highest)| {
            let noise = NOISE * (highest - lowest);
            let given = GivenRange { lowest: lowest + noise, highest: highest - noise, is_constant: false };
            beside_the_model(variable, given)
        });
        if let Some(beside) = beside {
            let [low, high] = [rows.lowest(), rows.highest()].map(|value| Number(rounded(value)));
            let unit = variable.unit.as_deref().unwrap_or_default();
            let in_unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            let remedy = "give it in the unit of the model, or state its unit in the name of the column";
            warn((format!("its values lie between {low} and {high}{in_unit}, {beside}"), remedy));
        }
    }
    findings.extend(gaps(subject));
    findings
}

/// The variable of an input, and the rows of its column that have a value, if they are three at least.
fn driving<'s>(subject: &ExperimentSubject<'s>, input: &str, column: &str) -> Option<(&'s Variable, Rows)> {
    let data = &subject.experiment.data;
    let known = data.time().iter().zip(data.column(column).ok()?).filter(|(_, v)| !v.is_nan());
    let (times, values): (Vec<f64>, Vec<f64>) = known.unzip();
    let variable = declared(subject.description, input)?;
    (values.len() >= 3).then_some((variable, Rows { times, values }))
}

/// Those of them about inputs without a value for long.
pub(super) fn gaps(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let of = |(input, column): (&str, &str)| {
        let (variable, rows) = driving(subject, input, column)?;
        let is_continuous = variable.variability == Variability::Continuous;
        let (sentence, remedy) = rows.gap(subject.experiment.data.time(), is_continuous)?;
        let name = format!("{}input '{input}' (column '{column}')", subject.prefix);
        Some(Finding::warning(name, sentence, remedy))
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

    /// An input that is zero throughout: it may be meant where that is the value of the model, too.
    fn all_zero(&self, name: &str, variable: &Variable) -> Option<Finding> {
        let own = match variable.start {
            Some(fmi::Value::Real(own)) => own,
            _ => 0.0,
        };
        let (severity, beside) = match own {
            0.0 => (Severity::Note, ": it drives nothing".to_owned()),
            own => (Severity::Warning, format!(", the model's own is {}", Number(rounded(own)))),
        };
        self.values.iter().all(|value| *value == 0.0).then(|| {
            let sentence = format!("all {} values are 0{beside}", self.values.len());
            Finding::new(severity, name, sentence, "is it the right column?")
        })
    }

    /// A value in one row, far off all others.
    fn spike(&self) -> Option<(String, &'static str)> {
        let middle = self.values.iter().sum::<f64>() / self.values.len() as f64;
        let off = |value: f64| (value - middle).abs();
        let at =
            (0..self.values.len()).max_by(|a, b| off(self.values[*a]).total_cmp(&off(self.values[*b])))?;
        let rest: Vec<f64> = [&self.values[..at], &self.values[at + 1..]].concat();
        let others = range(&rest);
        let value = self.values[at];
        let nearest = rest.iter().map(|other| (value - other).abs()).fold(f64::INFINITY, f64::min);
        let is_far = placeholder(&self.values, false).is_none()
            && others > 0.0
            && nearest > FAR * others
            && n_distinct(&rest) >= FEW_VALUES;
        (is_far && follows(&rest)).then(|| {
            let [low, high] = [f64::min, f64::max].map(|end| rest.iter().copied().reduce(end).unwrap_or(0.0));
            let [low, high] = [low, high].map(|value| Number(rounded(value)));
            let (value, time) = (Number(value), Number(rounded_time(self.times[at])));
            (
                format!("it is {value} in one row, at {time} s, the others lie between {low} and {high}"),
                "leave such rows empty (NaN), or mask them",
            )
        })
    }

    /// A value that stays in a signal that else moves: of noise, or until it leaps to where the signal went.
    /// None that actuators have: zero, and the limits.
    fn stands_still(&self) -> Option<(String, &'static str)> {
        let (values, run) = (&self.values, longest_run(&self.values));
        if [0.0, self.lowest(), self.highest()].contains(values.get(run.start)?) {
            return None;
        }
        let leaps = || {
            let next = longest_run(&values[..run.start]).len().max(longest_run(&values[run.end..]).len());
            let step = |k: usize| (values[k] - values[k - 1]).abs();
            let others = (1..values.len()).filter(|k| *k < run.start || *k > run.end).map(step);
            let mut others: Vec<f64> = others.collect();
            others.sort_by(f64::total_cmp);
            let usual = others.get(others.len() * 95 / 100).copied().unwrap_or(f64::INFINITY);
            let began = if run.start > 0 { step(run.start) } else { 0.0 };
            let is_end = run.start == 0 || run.end == values.len();
            run.len() >= STAYS
                && next <= STAYS_ELSE
                && !is_end
                && n_distinct(values) >= FEW_VALUES
                && step(run.end) > LEAPS * usual
                && began <= usual
        };
        (frozen(values).is_some() || leaps()).then(|| {
            let [from, to] = [run.start, run.end - 1].map(|k| Number(rounded_time(self.times[k])));
            (
                format!(
                    "it is exactly {} from {from} s to {to} s, {} rows, and moves else: frozen?",
                    Number(values[run.start]),
                    run.len()
                ),
                "leave the rows of a sensor that stood still out: their inputs are not known",
            )
        })
    }

    /// Rows of the recording without a value, for long. `is_continuous`: the input is linear there, others
    /// keep their value.
    fn gap(&self, time: &[f64], is_continuous: bool) -> Option<(String, &'static str)> {
        let interval = sampling_interval(&self.times)?;
        let is_sparse = (self.times.len() as f64) < SPARSE * time.len() as f64;
        let long = if is_sparse { LONG_GAP_OF_SPARSE } else { LONG_GAP };
        // The interval and the gap are differences of times.
        let tolerance = (long + 1.0) * base::time_tolerance(self.times[0], self.times[self.times.len() - 1]);
        let longest = long * interval;
        let least = CHANGE_IN_GAP * range(&self.values);
        let is_gap = |k: &usize| {
            let (from, to) = (self.times[k - 1], self.times[*k]);
            let first_after = time.partition_point(|t| *t <= from);
            let is_between = time.get(first_after).is_some_and(|t| *t < to);
            let is_change = !is_sparse || (self.values[*k] - self.values[k - 1]).abs() > least;
            to - from > longest + tolerance && is_change && is_between
        };
        let of = |k: usize| self.times[k] - self.times[k - 1];
        let gaps: Vec<usize> = (1..self.times.len()).filter(is_gap).collect();
        let largest = gaps.iter().copied().max_by(|a, b| of(*a).total_cmp(&of(*b)))?;
        let [from, to, interval] =
            [self.times[largest - 1], self.times[largest], interval].map(|t| Number(rounded_time(t)));
        let length = |seconds: f64| Number(rounded(seconds));
        let of_all = match gaps.len() {
            1 => String::new(),
            n => format!(
                ", and in {} more such gaps, {} s in all",
                n - 1,
                length(gaps.iter().map(|k| of(*k)).sum())
            ),
        };
        let taken = match is_continuous {
            true => "it is taken as a straight line from value to value there, which nobody measured",
            false => "its last value is held there, which nobody measured",
        };
        Some((
            format!(
                "it has no value from {from} s to {to} s ({} s), elsewhere one every {interval} s{of_all}: {taken}",
                length(of(largest))
            ),
            "fill the gap with what the input was, or leave its time out with windows and a start_time",
        ))
    }
}

/// True if a value tells the next one: steps from row to row are smaller than those of independent rows,
/// whose mean square is twice the variance.
fn follows(values: &[f64]) -> bool {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let steps = size_of_difference(&values[1..], values[..values.len() - 1].iter().copied());
    let deviation = size_of_difference(values, std::iter::repeat(mean));
    steps * steps < 2.0 * (1.0 - FOLLOWS) * deviation * deviation
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pseudo-random number from -1 to 1.
    fn noise(k: usize) -> f64 {
        2.0 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract().abs() - 1.0
    }

    fn rows(n: usize, of: impl Fn(usize) -> f64) -> Rows {
        Rows { times: (0..n).map(|k| 0.05 * k as f64).collect(), values: (0..n).map(of).collect() }
    }

    fn sine(k: usize) -> f64 {
        (0.065 * k as f64).sin()
    }

    /// Nothing is said of a signal.
    fn is_sound(rows: &Rows) -> bool {
        rows.spike().is_none() && rows.stands_still().is_none() && rows.gap(&rows.times, true).is_none()
    }

    #[test]
    fn a_value_far_off_all_others_is_a_spike() {
        let spike = rows(400, |k| if k == 200 { 1e4 } else { sine(k) });
        let said = spike.spike().unwrap().0;
        assert!(
            said.starts_with("it is 10000 in one row, at 10 s, the others lie between -1 and 1"),
            "{said}"
        );
        // impulses on noise or at rest, pulses, a step
        assert!(is_sound(&rows(400, |k| if k == 200 { 1e4 } else { noise(k) })));
        assert!(is_sound(&rows(400, |k| if k == 200 { 1e4 } else { 0.0 })));
        assert!(is_sound(&rows(400, |k| if k % 50 == 0 { 1e4 } else { sine(k) })));
        assert!(is_sound(&rows(400, |k| if k > 200 { 1e4 } else { sine(k) })));
    }

    #[test]
    fn a_signal_that_stays_and_leaps_is_frozen() {
        let frozen = rows(400, |k| if (100..300).contains(&k) { sine(100) } else { sine(k) });
        let said = frozen.stands_still().unwrap().0;
        assert!(said.contains("from 5 s to 14.95 s, 200 rows"), "{said}");
        let noisy = rows(400, |k| if (100..130).contains(&k) { 0.3 } else { sine(k) + 0.05 * noise(k) });
        assert!(noisy.stands_still().is_some());
    }

    #[test]
    fn usual_inputs_are_sound() {
        let sound: [&dyn Fn(usize) -> f64; 16] = [
            &sine,
            &|_| 3.0,
            &|k| f64::from(k > 100),
            &|k| f64::from(u8::from(k / 37 % 2 == 0)),
            &|k| k as f64,
            &|k| (k as f64).min(200.0),
            &|k| (k as f64 - 100.0).clamp(0.0, 150.0),
            &|k| sine(k).clamp(-0.5, 0.7),
            &|k| sine(k).max(0.0),
            &|k| if k < 200 { sine(k) } else { 0.0 },
            &|k| if k < 200 { 1.0 } else { 1.0 + sine(k - 200) },
            &|k| (5.0 * sine(k)).round(),
            &|k| sine(k) + 0.1 * noise(k),
            // a controller at its limit, and one that rests
            &|k| (sine(k) + 0.1 * noise(k)).min(0.5),
            &|k| if (100..300).contains(&k) { 0.0 } else { sine(k) + 0.1 * noise(k) },
            // steps at random, each held
            &|k| noise(k / 20),
        ];
        for (which, of) in sound.into_iter().enumerate() {
            assert!(is_sound(&rows(400, of)), "{which}");
        }
        // a sine that a switch takes to a level and back
        assert!(is_sound(&rows(400, |k| if (100..300).contains(&k) { 2.0 } else { sine(k) })));
    }

    #[test]
    fn a_gap_of_an_input_is_one_where_the_recording_goes_on() {
        let all = rows(400, sine);
        let without = |left_out: std::ops::Range<usize>| {
            let kept = || (0..400).filter(|k| !left_out.contains(k));
            Rows { times: kept().map(|k| all.times[k]).collect(), values: kept().map(sine).collect() }
        };
        let said = without(150..250).gap(&all.times, true).unwrap().0;
        assert!(
            said.starts_with("it has no value from 7.45 s to 12.5 s (5.05 s), elsewhere one every 0.05 s: "),
            "{said}"
        );
        assert!(without(150..152).gap(&all.times, true).is_none());
        assert!(
            without(150..153)
                .gap(&all.times, false)
                .unwrap()
                .0
                .ends_with("held there, which nobody measured")
        );
        // Its ends may be equal: what it was between them is as little known.
        let square = |k: usize| f64::from(u8::from((k / 40).is_multiple_of(2)));
        let kept = || (0..400).filter(|k| !(100..260).contains(k) && !(300..310).contains(k));
        let square =
            Rows { times: kept().map(|k| all.times[k]).collect(), values: kept().map(square).collect() };
        let said = square.gap(&all.times, true).unwrap().0;
        assert!(
            said.contains("(8.05 s), elsewhere one every 0.05 s, and in 1 more such gaps, 8.6 s in all"),
            "{said}"
        );
        // The recording itself has no rows there: that is said of its times.
        let gap = without(150..250);
        assert!(gap.gap(&gap.times, true).is_none());
        // every tenth row has a value
        let tenth = || (0..400).step_by(10);
        let slow =
            Rows { times: tenth().map(|k| all.times[k]).collect(), values: tenth().map(sine).collect() };
        assert!(slow.gap(&all.times, true).is_none());
    }
}
