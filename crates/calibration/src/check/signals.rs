//! Checks of the simulated course of an output against the measured one: wrong sign, frozen,
//! wrapped at a full turn.

use super::columns::{FEW_VALUES, SHORTEST_CLIPPED, longest_run, n_distinct};
use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::{
    Outputs, Place, Series, range, rounded, rounded_time, size, size_of_difference,
};
use crate::findings::finding::Finding;
use crate::problem::column_units::declared;
use base::Number;
use std::f64::consts::TAU;
use std::ops::Range;

/// Of fewer measurements correlations say little.
const FEWEST: usize = 10;

/// Measured and simulated values with a correlation below this go opposite ways.
const OPPOSITE: f64 = -0.5;

/// A measured value that stays for this part of the rows, and so many, while the simulation moves by this
/// part of the range.
const FROZEN: (f64, usize, f64) = (0.05, 10, 0.1);

/// Measurements in steps of more than so many times the RMS of the residuals: rounding to the nearest step
/// has an RMS of the step over the root of 12, so it is a third of their variance and more.
const COARSE: f64 = 2.0;

/// Differences of neighbours show a step if so many, of at most so many steps, are whole ones within this
/// part.
const STEPS: (usize, f64, f64) = (8, 20.0, 0.1);

/// Beginning of the finding about measurements that stay at a limit.
pub(super) const CLIPPED_AT: &str = "it is clipped at";

/// Values within so many turns may be wrapped; their usual step is smaller than this part of a turn.
const WRAPPED: (f64, f64) = (1.02, 0.1);

/// The findings of all outputs, at the result of a fit where there is one.
pub(super) fn findings(subjects: &[ExperimentSubject<'_>], outputs: &Outputs<'_>) -> Vec<Finding> {
    let mut findings = Vec::new();
    for series in outputs.last() {
        let subject = &subjects[series.of.experiment];
        let mut find = |found: Option<(String, &str)>| {
            let finding =
                |(sentence, remedy): (String, &str)| Finding::warning(series.name(subject), sentence, remedy);
            findings.extend(found.map(finding));
        };
        find(wrapped(series, subject));
        if outputs.place() == Place::Fitted {
            find(clipped(series).or_else(|| frozen(series)));
            find(opposite(series));
            find(coarse(series));
        }
    }
    findings
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    size_of_difference(values, std::iter::repeat(mean(values)))
}

fn opposite(series: &Series<'_>) -> Option<(String, &'static str)> {
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    let (of_measured, of_simulated) = (mean(measured), mean(simulated));
    let products = measured.iter().zip(simulated).map(|(m, s)| (m - of_measured) * (s - of_simulated));
    let covariance = products.sum::<f64>() / measured.len() as f64;
    let correlation = covariance / (deviation(measured) * deviation(simulated));
    (measured.len() >= FEWEST && correlation < OPPOSITE).then(|| {
        let sentence = format!(
            "measured and simulated values go opposite ways (correlation {}) at the fitted values",
            Number(rounded(correlation))
        );
        (sentence, "is the sign of the column the model's? Is it the right column?")
    })
}

/// Measurements that are rounded so coarsely that little else is left.
fn coarse(series: &Series<'_>) -> Option<(String, &'static str)> {
    let measured = &series.of.measured;
    let rms = size_of_difference(measured, series.simulated.iter().copied());
    let step = step(measured).filter(|step| *step > COARSE * rms)?;
    let sentence = format!(
        "its measurements come in steps of {}, and its residuals have an RMS of {}: what is left is rounding. Values that are rounded \
         down, not to the nearest step, are {} too small on average",
        Number(rounded(step)),
        Number(rounded(rms)),
        Number(rounded(0.5 * step))
    );
    Some((
        sentence,
        "record more digits; were they rounded down, add half a step, or fit an offset (offset_of)",
    ))
}

/// The smallest step between values of which all are multiples.
fn step(values: &[f64]) -> Option<f64> {
    let (fewest, most, part) = STEPS;
    let least = 1e-9 * range(values);
    let steps = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > least);
    let smallest = steps.clone().fold(f64::INFINITY, f64::min);
    let ratios = steps.map(|step| step / smallest).filter(|ratio| *ratio < most);
    let (n, is_whole) =
        ratios.fold((0, true), |(n, all), ratio| (n + 1, all && (ratio - ratio.round()).abs() < part));
    (n >= fewest && is_whole).then_some(smallest)
}

/// Measurements that stay at their largest or smallest value while the simulation goes beyond it: by more
/// than the residuals elsewhere, and than the step to the next value.
fn clipped(series: &Series<'_>) -> Option<(String, &'static str)> {
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    if n_distinct(measured) < FEW_VALUES {
        return None;
    }
    [(1.0, "largest"), (-1.0, "smallest")].into_iter().find_map(|(sign, what)| {
        let limit = sign * measured.iter().map(|m| sign * m).fold(f64::NEG_INFINITY, f64::max);
        let (mut beyond, mut elsewhere, mut step) = (Vec::new(), Vec::new(), f64::INFINITY);
        let mut from = 0;
        for run in measured.chunk_by(|a, b| a == b) {
            let simulated = &simulated[from..from + run.len()];
            from += run.len();
            if run[0] == limit && run.len() >= SHORTEST_CLIPPED {
                beyond.extend(simulated.iter().map(|s| sign * (s - limit)));
            } else {
                elsewhere.extend(run.iter().zip(simulated).map(|(m, s)| m - s));
                step = if run[0] == limit { step } else { step.min(sign * (limit - run[0])) };
            }
        }
        let most = beyond.iter().copied().fold(0.0, f64::max);
        let usual = size(elsewhere.into_iter()).max(step);
        (!beyond.is_empty() && mean(&beyond) > usual).then(|| {
            let sentence = format!(
                "{CLIPPED_AT} {}: {} measurements are exactly that, its {what} value, and the simulation at the fitted values goes \
                 beyond it by up to {}",
                Number(limit),
                beyond.len(),
                Number(rounded(most))
            );
            (sentence, "leave clipped rows empty (NaN), or mask them")
        })
    })
}

/// A measured value that stays while the simulation goes on.
fn frozen(series: &Series<'_>) -> Option<(String, &'static str)> {
    let (measured, simulated, times) = (&series.of.measured, &series.simulated, &series.of.times);
    let (share, least, moves) = FROZEN;
    let Range { start, end } = longest_run(measured);
    let moved = range(&simulated[start..end]);
    let is_long = end - start >= least && (end - start) as f64 >= share * measured.len() as f64;
    (is_long && range(measured) > 0.0 && moved > moves * range(measured)).then(|| {
        let sentence = format!(
            "it is exactly {} from {} s to {} s, where the simulation at the fitted values moves by {}: frozen?",
            Number(measured[start]),
            Number(rounded_time(times[start])),
            Number(rounded_time(times[end - 1])),
            Number(rounded(moved))
        );
        (sentence, "leave the rows of a sensor that stood still empty (NaN), or mask them")
    })
}

/// Angles of which the measured or the simulated ones, but not both, jump by a turn.
pub(super) fn wrapped(
    series: &Series<'_>,
    subject: &ExperimentSubject<'_>,
) -> Option<(String, &'static str)> {
    let unit = declared(subject.description, &series.of.variable).and_then(|v| v.unit.as_deref());
    let may_be_angle = unit.is_none_or(|unit| {
        matches!(unit, "" | "1" | "-") || matches!(unit, "rad" | "deg" | "degree" | "degrees" | "°")
    });
    if !may_be_angle {
        return None;
    }
    let (measured, simulated) = (&series.of.measured, &series.simulated);
    for (turn, name) in [(TAU, "2 pi"), (360.0, "360")] {
        for (jumping, other, which) in
            [(measured.as_ref(), &simulated[..], "measured"), (simulated, measured, "simulated")]
        {
            let rows = jumps(jumping, turn);
            let alone: Vec<usize> =
                rows.into_iter().filter(|k| (other[k + 1] - other[*k]).abs() < 0.5 * turn).collect();
            let Some(first) = alone.first() else { continue };
            let sentence = format!(
                "the {which} values jump by {name} ({}, first at {} s), and the {} ones do not: angles within one turn beside angles that \
                 go on",
                match alone.len() {
                    1 => "once".to_owned(),
                    n => format!("{n} times"),
                },
                Number(rounded_time(series.of.times[first + 1])),
                if which == "measured" { "simulated" } else { "measured" }
            );
            return Some((sentence, "unwrap the column (numpy.unwrap), or take another output of the model"));
        }
    }
    None
}

/// Where values that lie within one turn jump by a turn, up to their step before and after.
fn jumps(values: &[f64], turn: f64) -> Vec<usize> {
    let (within, small) = WRAPPED;
    let steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sizes: Vec<f64> = steps.iter().map(|step| step.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let usual = sizes.get(sizes.len() / 2).copied().unwrap_or(f64::INFINITY);
    if range(values) > within * turn || usual > small * turn {
        return Vec::new();
    }
    let beside = |k: usize| {
        let near = [k.checked_sub(1), Some(k + 1)].into_iter().flatten().filter_map(|k| steps.get(k));
        near.map(|step| step.abs()).filter(|step| *step < 0.5 * turn).fold(usual, f64::max)
    };
    // Beside spikes the steps are large, too.
    let is_jump =
        |k: &usize| (steps[*k].abs() - turn).abs() <= (3.0 * beside(*k) + 0.01 * turn).min(0.25 * turn);
    (0..steps.len()).filter(is_jump).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_a_coarse_sensor_come_in_steps() {
        let smooth: Vec<f64> = (0..200)
            .map(|k| 30.0 * (-0.01 * f64::from(k)).exp() + 0.2 * (7.1 * f64::from(k)).sin())
            .collect();
        assert_eq!(step(&smooth), None);
        // Whole km/h in m/s, and as a file with two digits has them.
        let cut: Vec<f64> = smooth.iter().map(|v| (3.6 * v).floor() / 3.6).collect();
        assert!((step(&cut).unwrap() - 1.0 / 3.6).abs() < 1e-9);
        let written: Vec<f64> = cut.iter().map(|v| (100.0 * v).round() / 100.0).collect();
        assert!((step(&written).unwrap() - 0.275).abs() < 0.01);
        assert_eq!(step(&[1.0, 2.0, 3.0, 5.0]), None);
    }

    #[test]
    fn only_angles_within_a_turn_jump() {
        let turning: Vec<f64> = (0..200).map(|k| 0.1 * f64::from(k)).collect();
        let wrapped: Vec<f64> = turning.iter().map(|v| v.rem_euclid(TAU)).collect();
        assert_eq!(jumps(&wrapped, TAU).len(), 3);
        assert!(jumps(&turning, TAU).is_empty());
        let degrees: Vec<f64> = wrapped.iter().map(|v| v.to_degrees()).collect();
        assert_eq!((jumps(&degrees, 360.0).len(), jumps(&degrees, TAU).len()), (3, 0));
        // a step of the signal, which is no turn
        let step: Vec<f64> = (0..200).map(|k| if k < 100 { 0.0 } else { 5.0 }).collect();
        assert!(jumps(&step, TAU).is_empty());
        let spikes: Vec<f64> =
            (0..200).map(|k| if k % 9 == 4 { 3.0 } else { 0.001 * f64::from(k) }).collect();
        assert!(jumps(&spikes, TAU).is_empty());
    }
}
