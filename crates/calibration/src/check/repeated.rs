//! Measurements that are there more than once: a recording given twice, a column for two outputs.

use super::experiment_subject::ExperimentSubject;
use super::simulated_outputs::range;
use crate::findings::finding::Finding;
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;

/// Fewer equal measurements at equal times may be chance.
const FEWEST_AT_EQUAL_TIMES: usize = 3;
/// Fewer equal measurements at other times may be chance.
const FEWEST_IN_A_ROW: usize = 10;

/// Most digits that values were rounded to; more are all that there are.
const MOST_DIGITS: i32 = 9;
/// Values may differ by this part of their range at most: beyond, they are equal by chance. Round numbers
/// look as if they had been rounded to few digits.
const COARSE: f64 = 1e-3;

/// The digits to which all values of a series were rounded, as a file has them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rounding {
    /// Behind the point.
    decimals: Option<i32>,
    /// Significant ones.
    digits: Option<i32>,
    /// The largest error.
    most: f64,
}

impl Rounding {
    fn of(values: &[f64]) -> Self {
        let fewest = |is_rounded: &dyn Fn(f64, i32) -> bool| {
            let mut digits = 0;
            for value in values.iter().filter(|value| **value != 0.0) {
                while !is_rounded(*value, digits) {
                    digits += 1;
                    if digits > MOST_DIGITS {
                        return None;
                    }
                }
            }
            Some(digits)
        };
        let has_decimals = |value: f64, decimals: i32| {
            let scaled = value * 10f64.powi(decimals);
            (scaled - scaled.round()).abs() <= 4.0 * f64::EPSILON * scaled.abs()
        };
        let has_digits = |value: f64, digits: i32| has_decimals(value, digits - 1 - exponent(value));
        let most = COARSE * range(values);
        Self { decimals: fewest(&has_decimals), digits: fewest(&has_digits), most }
    }

    /// Half a unit of the last digit of a value.
    fn error(&self, value: f64) -> f64 {
        let of_decimals = self.decimals.map_or(0.0, |decimals| 0.5 * 10f64.powi(-decimals));
        let of_digits = match self.digits {
            Some(digits) if value != 0.0 => 0.5 * 10f64.powi(exponent(value) + 1 - digits),
            _ => 0.0,
        };
        f64::max(of_decimals, of_digits).min(self.most).max(4.0 * f64::EPSILON * value.abs())
    }
}

fn exponent(value: f64) -> i32 {
    value.abs().log10().floor() as i32
}

/// A series, and how its values were rounded.
#[derive(Clone, Copy)]
struct Rounded<'a>(&'a [f64], Rounding);

impl<'a> Rounded<'a> {
    fn new(values: &'a [f64]) -> Self {
        Self(values, Rounding::of(values))
    }

    /// True if the values from there on are those of another series, but for the rounding of both.
    fn is_same_from(self, k: usize, other: Rounded<'_>) -> bool {
        self.0[k..].iter().zip(other.0).all(|(a, b)| {
            // The sum of two halves of a digit, as they are stored.
            let most = self.1.error(*a) + other.1.error(*b);
            (a - b).abs() <= most * (1.0 + COARSE)
        })
    }

    fn is_same(self, other: Rounded<'_>) -> bool {
        self.0.len() == other.0.len() && self.is_same_from(0, other)
    }
}

/// Number of measurements that two recordings share: the first of the second are the last of the first, or a
/// part of them. 0 where the first ones are all the same.
fn shared(a: Rounded<'_>, b: Rounded<'_>) -> usize {
    if b.0.len() < FEWEST_IN_A_ROW {
        return 0;
    }
    let first = Rounded(&b.0[..FEWEST_IN_A_ROW], b.1);
    if first.is_same_from(0, Rounded(&[b.0[0]; FEWEST_IN_A_ROW], b.1)) {
        return 0;
    }
    let starts = 0..(a.0.len() + 1).saturating_sub(FEWEST_IN_A_ROW);
    starts.into_iter().find(|k| a.is_same_from(*k, b)).map_or(0, |k| a.0[k..].len().min(b.0.len()))
}

/// Outputs of several experiments with the same measurements, or of one with the same times and the same
/// measurements. Windows that do not overlap are others.
pub(super) fn findings(calibration: &Calibration, subjects: &[ExperimentSubject<'_>]) -> Vec<Finding> {
    let outputs = &calibration.residual_layout().outputs;
    let rounded: Vec<(Rounded<'_>, Rounded<'_>)> =
        outputs.iter().map(|o| (Rounded::new(&o.times), Rounded::new(&o.measured))).collect();
    let is_same = |a: usize, b: usize| {
        let ((times, measured), (other_times, other_measured)) = (rounded[a], rounded[b]);
        times.is_same(other_times) && measured.is_same(other_measured)
    };
    let n_shared = |a: usize, b: usize| match is_same(a, b) {
        true => outputs[b].measured.len(),
        false if outputs[a].experiment == outputs[b].experiment => 0,
        false => shared(rounded[a].1, rounded[b].1).max(shared(rounded[b].1, rounded[a].1)),
    };
    let varies = |a: &OutputResiduals| a.measured.iter().any(|m| *m != a.measured[0]);
    let mut findings: Vec<Finding> = Vec::new();
    let names = calibration.problem().experiment_names();
    for (k, b) in outputs.iter().enumerate() {
        if b.measured.len() < FEWEST_AT_EQUAL_TIMES || !varies(b) {
            continue;
        }
        let is_twice = |i: &usize| {
            let a = &outputs[*i];
            (a.experiment == b.experiment) == (a.variable != b.variable) && n_shared(*i, k) > 0
        };
        let Some(i) = (0..k).find(is_twice) else { continue };
        let (a, n) = (&outputs[i], n_shared(i, k));
        let (subject, sentence, remedy) = match a.experiment == b.experiment {
            true => (
                format!("{}outputs '{}' and '{}'", subjects[b.experiment].prefix, a.variable, b.variable),
                format!("both have the same {n} measurements (columns '{}' and '{}')", a.column, b.column),
                "give each output its own column",
            ),
            false => (
                format!("experiments {} and {}", names[a.experiment], names[b.experiment]),
                format!(
                    "output '{}' has the same {n} measurements{} in both: they count twice, and standard errors are too small",
                    b.variable,
                    if is_same(i, k) { " at the same times" } else { "" }
                ),
                "leave one of them out, or name the right file",
            ),
        };
        // Of a recording with several outputs the first says it.
        if findings.iter().all(|known| known.subject != subject) {
            findings.push(Finding::warning(subject, sentence, remedy));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of several sizes.
    fn values(n: usize, shift: f64) -> Vec<f64> {
        (0..n).map(|k| 1e-2 + 30.0 * (0.2 * k as f64 + shift).sin().powi(4)).collect()
    }

    fn printed(values: &[f64], print: impl Fn(&f64) -> String) -> Vec<f64> {
        values.iter().map(|value| print(value).parse().unwrap()).collect()
    }

    #[test]
    fn the_digits_of_a_file_are_found() {
        let exact = values(100, 0.0);
        let of_exact = Rounding::of(&exact);
        assert_eq!((of_exact.decimals, of_exact.digits), (None, None));
        let six = printed(&exact, |v| format!("{v:.5e}"));
        assert_eq!(Rounding::of(&six).digits, Some(6));
        assert_eq!(Rounding::of(&printed(&exact, |v| format!("{v:.4}"))).decimals, Some(4));
        let coarse = Rounding::of(&printed(&exact, |v| format!("{v:.0}")));
        assert!(coarse.decimals == Some(0) && coarse.error(12.0) < 0.04);
    }

    #[test]
    fn a_recording_is_the_same_in_fewer_digits() {
        let exact = values(100, 0.0);
        let six = printed(&exact, |v| format!("{v:.5e}"));
        let three = printed(&exact, |v| format!("{v:.3}"));
        for (a, b) in [(&exact, &six), (&six, &exact), (&six, &three), (&exact, &three), (&exact, &exact)] {
            assert!(Rounded::new(a).is_same(Rounded::new(b)));
            assert_eq!(shared(Rounded::new(a), Rounded::new(&b[40..])), 60);
        }
        // another recording, with and without noise of some digits
        let other = values(100, 1e-3);
        let noisy: Vec<f64> = exact.iter().enumerate().map(|(k, v)| v + 0.02 * (k as f64).sin()).collect();
        for other in [&other, &noisy, &printed(&noisy, |v| format!("{v:.5e}"))] {
            assert_eq!(shared(Rounded::new(&six), Rounded::new(other)), 0);
            assert_eq!(shared(Rounded::new(other), Rounded::new(&three)), 0);
        }
    }
}
