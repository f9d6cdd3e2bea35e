//! Checks of the values of a recording: constant columns, and placeholders.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::rounded;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use base::Number;

/// Values that loggers write when they have no measurement.
const PLACEHOLDERS: [f64; 12] =
    [99.9, 999.0, 9999.0, 99999.0, 999_999.0, 9999.9, 32767.0, 65535.0, 1e20, 1e30, 1e31, 1e37];

/// Minimum distance of a placeholder from the other values, as a multiple of their range.
const OUTSIDE: f64 = 2.0;

/// Returns findings about constant measured columns, and used columns with placeholders.
pub(super) fn findings(subject: &ExperimentSubject<'_>) -> Vec<Finding> {
    let ExperimentSubject { prefix, experiment, .. } = subject;
    let mut findings = Vec::new();
    for (variable, column) in experiment.outputs() {
        let Ok(values) = experiment.data.column(column) else { continue };
        let present = || values.iter().copied().filter(|v| !v.is_nan());
        let (n, (low, high)) = (present().count(), extent(present()));
        if n > 2 && low == high {
            findings.push(Finding::warning(
                FindingId::ConstantColumn,
                format!("{prefix}output '{variable}' (column '{column}')"),
                format!(
                    "all {n} measurements are {}. A constant contains little information about parameters",
                    Number(low)
                ),
                "Check that it is the right column",
            ));
        }
    }
    for (variable, column) in experiment.columns_in_use() {
        let Ok(values) = experiment.data.column(&column) else { continue };
        // Loggers write placeholders before any conversion.
        let given: Vec<f64> = values.iter().map(|v| experiment.data.as_given(&column, *v).0).collect();
        if let Some((value, n, rest)) = placeholder(&given) {
            let unit = experiment.data.as_given(&column, 0.0).1;
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            findings.push(Finding::warning(
                FindingId::Placeholder,
                format!("{prefix}'{variable}' (column '{column}')"),
                format!(
                    "{} {}{unit}, the others lie between {} and {}{unit}. A placeholder for a missing value counts as a measurement",
                    if n == 1 { "one value is".to_owned() } else { format!("{n} values are") },
                    Number(value),
                    Number(rounded(rest.0)),
                    Number(rounded(rest.1))
                ),
                "Leave such cells empty (NaN), or mask their rows",
            ));
        }
    }
    findings
}

/// Returns the smallest and the largest value.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)))
}

/// Returns a placeholder value far outside the other values, its count, and the range of the other values.
fn placeholder(values: &[f64]) -> Option<(f64, usize, (f64, f64))> {
    let present = || values.iter().copied().filter(|v| !v.is_nan());
    let (lowest, highest) = extent(present());
    [highest, lowest].into_iter().filter(|value| PLACEHOLDERS.contains(&value.abs())).find_map(|value| {
        let n = present().filter(|v| *v == value).count();
        let (low, high) = extent(present().filter(|v| *v != value));
        let is_outside = (value - high).max(low - value) > OUTSIDE * (high - low);
        (2 * n < present().count() && high > low && is_outside).then_some((value, n, (low, high)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_are_detected_outside_the_other_values() {
        let noisy: Vec<f64> = (0..200).map(|k| 300.0 + f64::from(k % 7) / 7.0).collect();
        assert_eq!(placeholder(&noisy), None);
        for value in [9999.0, -999.0, 1e30] {
            let mut with = noisy.clone();
            with[30] = value;
            assert_eq!(placeholder(&with), Some((value, 1, (300.0, 300.0 + 6.0 / 7.0))));
        }
        // The signal itself reaches this value.
        assert_eq!(placeholder(&(0..1000).map(f64::from).collect::<Vec<f64>>()), None);
    }
}
