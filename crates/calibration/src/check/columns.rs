//! Checks of the values of a recording: columns that are constant, clipped, frozen, missing, or hold
//! placeholders.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{range, rounded};
use crate::findings::finding::Finding;
use base::Number;
use std::ops::Range;

/// Fewer different values than these make a column of states, steps or quantised values, for which a pulse,
/// a stop, or to stay at its largest is no sign of anything.
pub(super) const FEW_VALUES: usize = 20;

/// A part of the values that lies exactly at the largest or the smallest one, in runs of at least so many
/// that are entered at a slope of at least this part of the range in one row, is clipped. A response that
/// settles comes to its end slowly.
const CLIPPED: (f64, usize, f64) = (0.05, SHORTEST_CLIPPED, 0.01);
pub(super) const SHORTEST_CLIPPED: usize = 5;

/// End of the finding about such a part.
pub(super) const CLIPPED_DOUBT: &str = ": clipped?";

/// A value that stays for so many rows in a noisy signal, so many times longer than any other, is that of a
/// sensor that stood still.
const FROZEN: (usize, usize) = (10, 4);

/// In a noisy signal more than this part of the bends are followed by one to the other side, less than that
/// part of the steps are none, and the median bend is more than this part of the range: less is the rounding
/// of a file.
const NOISY: (f64, f64, f64) = (0.5, 0.2, 1e-3);

/// Values that loggers write where they have none.
const PLACEHOLDERS: [f64; 12] =
    [99.9, 999.0, 9999.0, 99999.0, 999_999.0, 9999.9, 32767.0, 65535.0, 1e20, 1e30, 1e31, 1e37];

/// A placeholder lies so many ranges of the other values away from them; a value that is none of the usual
/// ones, and stands there several times.
const OUTSIDE: (f64, f64) = (2.0, 10.0);

/// Zeros that stand for none lie at least so many of the largest step between the other values away from
/// them, in runs of no more than so many rows, and are no more than this part of the rows.
const ZEROS: (f64, usize, f64) = (10.0, 3, 0.1);

/// Means may take away this part of the variance of a signal.
const LOST: f64 = 0.1;

/// Measured columns that are constant, clipped, frozen or mostly missing, and those in use that hold
/// placeholders.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, .. } = subject;
    let mut findings = Vec::new();
    for (variable, column) in experiment.outputs() {
        let Ok(values) = experiment.data.column(column) else { continue };
        let name = format!("{prefix}output '{variable}' (column '{column}')");
        let known: Vec<f64> = values.iter().copied().filter(|v| !v.is_nan()).collect();
        let (low, high) =
            known.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        if known.len() > 2 && low == high {
            findings.push(Finding::warning(
                name,
                format!("all {} measurements are {}", known.len(), Number(low)),
                "is it the right column? A constant tells little about parameters",
            ));
            continue;
        }
        if known.len() * 10 < values.len() {
            findings.push(Finding::note(
                name.clone(),
                format!("{} of {} rows have a value", known.len(), values.len()),
                "the others are taken as missing",
            ));
        }
        let mut is_clipped = false;
        for (limit, what) in [(high, "largest"), (low, "smallest")] {
            if let Some(n) = clipped(&known, limit, high - low) {
                is_clipped = true;
                let share = Number((1e3 * n as f64 / known.len() as f64).round() / 10.0);
                findings.push(Finding::warning(
                    name.clone(),
                    format!(
                        "{share} % of the measurements are exactly {}, its {what} value{CLIPPED_DOUBT}",
                        Number(limit)
                    ),
                    "leave clipped rows empty (NaN), or mask them",
                ));
            }
        }
        if let Some(n) = frozen(&known).filter(|_| !is_clipped) {
            let value = known[longest_run(&known).start];
            findings.push(Finding::warning(
                name.clone(),
                format!(
                    "{n} measurements in a row are exactly {}, and the others are noisy: frozen?",
                    Number(value)
                ),
                "leave the rows of a sensor that stood still empty (NaN), or mask them",
            ));
        }
    }
    findings.extend(too_coarse(subject));
    let outputs: Vec<&str> = experiment.outputs().map(|(_, column)| column).collect();
    for (variable, column) in experiment.columns_in_use() {
        let Ok(values) = experiment.data.column(&column) else { continue };
        let is_measured = outputs.contains(&column.as_str());
        let as_given = |value: f64| experiment.data.as_given(&column, value);
        // Loggers write them before anything is converted.
        let (origin, unit) = as_given(0.0);
        let given: Vec<f64>;
        let values = if origin == 0.0 && unit.is_empty() {
            values
        } else {
            given = values.iter().map(|value| as_given(*value).0).collect();
            &given
        };
        let zeros = || zeros(values).filter(|_| is_measured);
        if let Some((value, n, rest)) = placeholder(values, is_measured).or_else(zeros) {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            findings.push(Finding::warning(
                format!("{prefix}'{variable}' (column '{column}')"),
                format!(
                    "{} {}{unit}, the others lie between {} and {}{unit}: a placeholder for a missing value?",
                    if n == 1 { "one value is".to_owned() } else { format!("{n} values are") },
                    Number(value),
                    Number(rounded(rest.0)),
                    Number(rounded(rest.1))
                ),
                "leave such rows empty (NaN), or mask them",
            ));
        }
    }
    findings
}

/// Columns in use of which means over intervals have taken a part of the signal away.
fn too_coarse(subject: &ExperimentSubject<'_>) -> Option<Finding> {
    let ExperimentSubject { prefix, experiment, .. } = subject;
    let resampling = experiment.data.resampling()?;
    let lost_of = |column: &str| {
        let full = experiment.data.full_name(column)?;
        resampling.lost.iter().find(|(name, _)| name == full).map(|(_, lost)| *lost)
    };
    let used = experiment.columns_in_use();
    let lost = used.iter().filter_map(|(_, column)| Some((column, lost_of(column)?)));
    let (column, lost) = lost.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, lost)| *lost > LOST)?;
    let interval = Number(resampling.interval);
    Some(Finding::warning(
        format!("{prefix}column '{column}'"),
        format!(
            "means over {interval} s take away {} % of the variance of its signal: it is faster",
            Number(rounded(100.0 * lost))
        ),
        "resample over shorter intervals, or not at all",
    ))
}

/// The longest stretch of equal values.
pub(super) fn longest_run(values: &[f64]) -> Range<usize> {
    let (mut longest, mut start) = (0..0, 0);
    for end in 1..=values.len() {
        if end == values.len() || values[end] != values[start] {
            if end - start > longest.len() {
                longest = start..end;
            }
            start = end;
        }
    }
    longest
}

/// Number of consecutive equal values in a signal that is noisy elsewhere; `None` if it is not frozen. A
/// machine that stands still at zero, before or after it runs, does not count.
pub(super) fn frozen(values: &[f64]) -> Option<usize> {
    let (least, times) = FROZEN;
    let run = longest_run(values);
    let is_rest = values.get(run.start) == Some(&0.0) && (run.start == 0 || run.end == values.len());
    if run.len() < least || is_rest {
        return None;
    }
    let [before, after] = [&values[..run.start], &values[run.end..]];
    let next = longest_run(before).len().max(longest_run(after).len());
    let count = |of: &dyn Fn(&[f64]) -> usize| of(before) + of(after);
    let bends = |v: &[f64]| v.windows(3).map(|w| w[1] - 0.5 * (w[0] + w[2])).collect::<Vec<f64>>();
    let n_turns = count(&|v| bends(v).windows(2).filter(|w| w[0] * w[1] < 0.0).count());
    let mut sizes: Vec<f64> = [before, after].into_iter().flat_map(bends).map(f64::abs).collect();
    sizes.sort_by(f64::total_cmp);
    let usual = sizes.get(sizes.len() / 2).copied().unwrap_or_default();
    let n_still = count(&|v| v.windows(2).filter(|w| w[0] == w[1]).count());
    let n_steps = count(&|v| v.len().saturating_sub(1)) as f64;
    let is_noisy = n_turns as f64 > NOISY.0 * n_steps
        && (n_still as f64) < NOISY.1 * n_steps
        && usual > NOISY.2 * range(values);
    (is_noisy && run.len() >= times * next && n_steps >= least as f64).then_some(run.len())
}

/// A value far outside of the others that stands for none, how often it is there, and the range of the
/// others.
pub(super) fn placeholder(values: &[f64], is_measured: bool) -> Option<(f64, usize, (f64, f64))> {
    let known = || values.iter().copied().filter(|v| !v.is_nan());
    let ends = [known().fold(f64::NEG_INFINITY, f64::max), known().fold(f64::INFINITY, f64::min)];
    ends.into_iter().find_map(|value| {
        let n = known().filter(|v| *v == value).count();
        let rest = || known().filter(|v| *v != value);
        let (low, high) = rest().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let away = (value - high).max(low - value);
        let ranges = away / (high - low);
        let is_usual = PLACEHOLDERS.contains(&value.abs()) && ranges > OUTSIDE.0;
        let is_repeated = is_measured && n > 1 && ranges > OUTSIDE.1 && rest().count() >= FEW_VALUES;
        let is_few = 2 * n < known().count();
        (is_few && high > low && (is_usual || is_repeated)).then_some((value, n, (low, high)))
    })
}

/// Single zeros in a signal that stays far from zero: 0, how many there are, and the range of the others.
fn zeros(values: &[f64]) -> Option<(f64, usize, (f64, f64))> {
    let (far, longest, share) = ZEROS;
    let known: Vec<f64> = values.iter().copied().filter(|v| !v.is_nan()).collect();
    let others: Vec<f64> = known.iter().copied().filter(|v| *v != 0.0).collect();
    let (low, high) =
        others.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let n = known.len() - others.len();
    let runs = known.chunk_by(|a, b| (*a == 0.0) == (*b == 0.0)).filter(|run| run[0] == 0.0);
    let is_single = runs.map(<[f64]>::len).max().is_some_and(|most| most <= longest);
    let step = others.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    let away = low.max(-high);
    let is_few = n as f64 <= share * known.len() as f64 && others.len() >= FEW_VALUES;
    (is_single && is_few && away > far * step && step > 0.0).then_some((0.0, n, (low, high)))
}

/// Number of values at a limit, if they look clipped there.
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
    (n as f64 >= share * values.len() as f64 && n > 0 && n_distinct(values) >= FEW_VALUES).then_some(n)
}

/// Number of values that differ.
pub(super) fn n_distinct(values: &[f64]) -> usize {
    let mut distinct = values.to_vec();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    distinct.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pseudo-random number from -1 to 1.
    fn noise(k: usize) -> f64 {
        2.0 * ((12.9898 * (k as f64 + 1.0)).sin() * 43_758.547).fract().abs() - 1.0
    }

    #[test]
    fn a_noisy_signal_that_stays_is_frozen() {
        let noisy: Vec<f64> = (0..200).map(|k| (0.1 * k as f64).sin() + 0.01 * noise(k)).collect();
        assert_eq!(frozen(&noisy), None);
        let mut still = noisy.clone();
        still[50..70].fill(noisy[50]);
        assert_eq!((frozen(&still), longest_run(&still)), (Some(20), 50..70));
        // before a step of a model that has settled, and at rest
        let smooth: Vec<f64> =
            (0..200).map(|k| if k < 40 { 1.0 } else { (-0.01 * f64::from(k)).exp() }).collect();
        assert_eq!(frozen(&smooth), None);
        let mut rest = noisy.clone();
        rest[..30].fill(0.0);
        assert_eq!(frozen(&rest), None);
        // steps of a converter
        let coarse: Vec<f64> = noisy.iter().map(|v| (5.0 * v).round() / 5.0).collect();
        assert_eq!(frozen(&coarse), None);
    }

    #[test]
    fn placeholders_lie_outside() {
        let noisy: Vec<f64> = (0..200).map(|k| 300.0 + noise(k)).collect();
        assert_eq!(placeholder(&noisy, true), None);
        for value in [9999.0, -999.0, 1e30] {
            let mut with = noisy.clone();
            with[30] = value;
            let (found, n, rest) = placeholder(&with, false).unwrap();
            assert!(found == value && n == 1 && rest.0 > 298.0 && rest.1 < 302.0);
        }
        let mut twice = noisy.clone();
        (twice[30], twice[31]) = (0.0, 0.0);
        assert_eq!(placeholder(&twice, true).map(|found| found.1), Some(2));
        // one outlier is none, nor is a pulse of an input
        twice[31] = 300.0;
        assert_eq!(placeholder(&twice, true), None);
        let pulse: Vec<f64> =
            (0..200).map(|k| if k % 50 == 0 { 100.0 } else { 0.1 * f64::from(k % 2) }).collect();
        assert_eq!(placeholder(&pulse, false), None);
    }

    #[test]
    fn single_zeros_far_from_the_others_are_placeholders() {
        // Temperatures from 18 to 30 with noise of 0.05.
        let mut t: Vec<f64> = (0..200).map(|k| 18.0 + 0.06 * k as f64 + 0.05 * noise(k)).collect();
        assert_eq!(zeros(&t), None);
        (t[30], t[31], t[120]) = (0.0, 0.0, 0.0);
        assert_eq!(placeholder(&t, true), None);
        assert!(zeros(&t).is_some_and(|(value, n, rest)| value == 0.0 && n == 3 && rest.0 > 17.9));
        // A machine that is off for a while, and one that is switched.
        t[30..60].fill(0.0);
        assert_eq!(zeros(&t), None);
        let switched: Vec<f64> =
            (0..200).map(|k| if k % 2 == 0 { 0.0 } else { 5.0 + 0.01 * noise(k) }).collect();
        assert_eq!(zeros(&switched), None);
    }

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
