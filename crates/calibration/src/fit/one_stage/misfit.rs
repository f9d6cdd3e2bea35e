//! Outputs that the simulation of a fit reproduces worse than a constant would.

use crate::cost::residual::sum_of_squares;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::findings::shown_text::digits;
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;

/// Residuals that are larger than the deviation of the measurements by this factor are worse than a constant;
const WORSE: f64 = 1.1;
/// and by so many standard deviations of the sum of their squares, more than chance.
const DEVIATIONS: f64 = 4.0;
/// The probability below which it is no chance.
const CHANCE: f64 = 1e-3;

/// Residuals below this part of the size of the measurements are rounding.
const ROUNDING: f64 = 1e-10;

/// An output whose residuals make up less than this part of the cost has not decided the fit.
const SHARE: f64 = 0.1;

/// Sums over measurements `y` and differences `d`, simulated minus measured.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    n: f64,
    mean: f64,
    /// Sum of `(y - mean)^2`.
    about_mean: f64,
    /// Sum of `d^2`.
    differences: f64,
}

impl Sums {
    fn of(output: &OutputResiduals, residuals: &[f64]) -> Self {
        let rows = residuals[output.range.clone()].iter().zip(&output.weights).zip(&output.measured);
        rows.filter(|((_, w), _)| **w > 0.0).fold(Self::default(), |sums, ((r, w), y)| {
            sums.with(Self { n: 1.0, mean: *y, about_mean: 0.0, differences: (r / w).powi(2) })
        })
    }

    /// Those of both together (Chan, Golub and LeVeque, Am. Stat. 37, 1983, equation 1.5).
    fn with(self, other: Self) -> Self {
        let n = self.n + other.n;
        if n == 0.0 {
            return self;
        }
        let apart = other.mean - self.mean;
        Self {
            n,
            mean: self.mean + apart * other.n / n,
            about_mean: self.about_mean + other.about_mean + apart * apart * self.n * other.n / n,
            differences: self.differences + other.differences,
        }
    }

    /// True if the mean is a better simulation of measurements that vary.
    fn is_worse_than_a_constant(self) -> bool {
        let is_rounding = self.differences <= (ROUNDING * self.mean).powi(2) * self.n;
        self.about_mean > 0.0 && !is_rounding && self.differences > WORSE * WORSE * self.about_mean
    }

    /// True if it is by more than chance. Where there is nothing but noise about a right simulation, the
    /// ratio of the sums is 1 + chi2(1) / chi2(n - 1). That exceeds r with a probability below the one of 1 +
    /// chi2(2) / chi2(n - 1), which is r^(-(n - 1) / 2): few rows are often far from their mean together.
    fn is_no_chance(self) -> bool {
        let ratio = self.differences / self.about_mean;
        ratio > 1.0 + DEVIATIONS * (2.0 / self.n).sqrt() && ratio.powf(0.5 - 0.5 * self.n) < CHANCE
    }
}

/// Outputs that are worse than a constant, by the residuals of a fit. Errors where that is so over all
/// experiments (a recording at rest has little that a simulation could explain), no chance in so few rows,
/// and the output counts in the cost.
pub(super) fn findings(calibration: &Calibration, residuals: &[f64]) -> Vec<Finding> {
    let layout = calibration.residual_layout();
    let names = calibration.problem().experiment_names();
    let cost = sum_of_squares(&residuals[..layout.n_measurements()]);
    let finding = |output: &OutputResiduals| {
        let own = Sums::of(output, residuals);
        if !own.is_worse_than_a_constant() {
            return None;
        }
        let same = || layout.outputs.iter().filter(|other| other.variable == output.variable);
        let all = same().map(|other| Sums::of(other, residuals)).fold(Sums::default(), Sums::with);
        let share = same().map(|other| sum_of_squares(&residuals[other.range.clone()])).sum::<f64>() / cost;
        let is_no_chance = all.is_worse_than_a_constant() && all.is_no_chance();
        let severity = match is_no_chance && share >= SHARE {
            true => Severity::Error,
            false => Severity::Warning,
        };
        let prefix = if names.len() == 1 { "" } else { &format!("{}: ", names[output.experiment]) };
        let sentence = format!(
            "the fit is worse than a constant: its residuals have an RMS of {}, the measurements a standard deviation of {}{}",
            digits((own.differences / own.n).sqrt()),
            digits((own.about_mean / own.n).sqrt()),
            match own.is_no_chance() {
                true => String::new(),
                false => format!("; in {} rows that may be chance", own.n),
            }
        );
        let subject = format!("{prefix}output '{}' (column '{}')", output.variable, output.column);
        let remedy = "is it the right column, in the right unit, with the initial state of this recording? If so, other start values, or \
                      search=\"global\", may lead to a better minimum";
        Some(Finding::new(severity, subject, sentence, remedy).of(Origin::Residuals))
    };
    layout.outputs.iter().filter_map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1, 2, 3, 4 about the mean 2.5: 5.
    #[test]
    fn sums_are_those_of_all_values() {
        let one = |y: f64, d: f64| Sums { n: 1.0, mean: y, about_mean: 0.0, differences: d * d };
        let [a, b] = [one(1.0, 0.5).with(one(2.0, 0.5)), one(3.0, 1.0).with(one(4.0, 2.0))];
        let all = a.with(b);
        assert_eq!((all.n, all.mean, all.about_mean, all.differences), (4.0, 2.5, 5.0, 5.5));
        assert!(!all.is_worse_than_a_constant());
        // Four values with twice the deviation: by chance, perhaps.
        let few = Sums { differences: 20.0, ..all };
        assert!(few.is_worse_than_a_constant() && !few.is_no_chance());
        // 40 times as many, far off, but as it may be by rounding.
        let many = Sums { n: 160.0, about_mean: 200.0, differences: 1600.0, ..all };
        assert!(many.is_worse_than_a_constant() && many.is_no_chance());
        assert!(!Sums { mean: 1e12, ..many }.is_worse_than_a_constant());
        assert!(!Sums { about_mean: 0.0, ..many }.is_worse_than_a_constant());
    }
}
