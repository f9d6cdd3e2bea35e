//! Outputs that the fit reproduces worse than a constant would.

use crate::cost::residual::sum_of_squares;
use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Origin, Severity};
use crate::findings::identifier::FindingId;
use crate::loaded::calibration::Calibration;
use crate::problem::residual_layout::OutputResiduals;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Minimum ratio of residuals to the deviation of the measurements for a fit worse than a constant.
const WORSE: f64 = 1.1;
/// Minimum excess of the sum of squares, in standard deviations, for a significant result.
const DEVIATIONS: f64 = 4.0;
/// Significance level.
const CHANCE: f64 = 1e-3;

/// Residuals below this part of the size of the measurements are due to rounding.
const ROUNDING: f64 = 1e-10;

/// An output whose residuals contribute less than this part of the cost does not determine the fit.
const SHARE: f64 = 0.1;

/// Sums over measurements `y` and differences `d` (simulated minus measured).
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

    /// Combines the sums of two sets (Chan, Golub and LeVeque, Am. Stat. 37, 1983, equation 1.5).
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

    /// True if the measurements vary and their mean is a better simulation.
    fn is_worse_than_a_constant(self) -> bool {
        let is_rounding = self.differences <= (ROUNDING * self.mean).powi(2) * self.n;
        self.about_mean > 0.0 && !is_rounding && self.differences > WORSE * WORSE * self.about_mean
    }

    /// Returns an upper bound of the probability that the mean is this much better by chance. If a correct
    /// simulation differs from the measurements only by noise, the ratio of the sums is `1 + chi2(1) /
    /// chi2(n - 1)`. The probability that it exceeds r is below the probability for `1 + chi2(2) / chi2(n -
    /// 1)`, which is `r^(-(n - 1) / 2)`. A few rows are often all far from their mean.
    fn chance(self) -> f64 {
        self.ratio().powf(0.5 - 0.5 * self.n).min(1.0)
    }

    fn ratio(self) -> f64 {
        self.differences / self.about_mean
    }

    /// True if the misfit is significant.
    fn is_no_chance(self) -> bool {
        self.ratio() > 1.0 + DEVIATIONS * (2.0 / self.n).sqrt() && self.chance() < CHANCE
    }
}

/// True if several outputs vary and all of these are significantly worse than a constant. Their probabilities
/// are combined by Fisher's method (Statistical Methods for Research Workers, 1932, section 21.1).
fn are_all_worse(outputs: &[Sums]) -> bool {
    let varying = || outputs.iter().filter(|sums| sums.about_mean > 0.0);
    let statistic = varying().map(|sums| -2.0 * sums.chance().ln()).sum::<f64>();
    let n = varying().count();
    let chance = ChiSquared::new(2.0 * n as f64).map_or(1.0, |of| of.sf(statistic));
    n > 1 && varying().all(|sums| sums.is_worse_than_a_constant()) && chance < CHANCE
}

/// Returns findings about outputs that are worse than a constant, from the residuals of a fit. A finding is
/// an error if the misfit over all experiments is significant and the output contributes to the cost. A
/// single experiment is not sufficient, because a recording at rest contains little to explain. All findings
/// are errors if the misfit of all outputs together is significant.
pub(super) fn findings(calibration: &Calibration, residuals: &[f64]) -> Vec<Finding> {
    let layout = calibration.residual_layout();
    let names = calibration.problem().experiment_names();
    let cost = sum_of_squares(&residuals[..layout.n_measurements()]);
    // Sums of each variable over all experiments.
    let mut of_variables: Vec<(&str, Sums)> = Vec::new();
    for output in &layout.outputs {
        let sums_of_output = Sums::of(output, residuals);
        match of_variables.iter_mut().find(|(variable, _)| *variable == output.variable) {
            Some((_, sums)) => *sums = sums.with(sums_of_output),
            None => of_variables.push((&output.variable, sums_of_output)),
        }
    }
    let sums: Vec<Sums> = of_variables.iter().map(|(_, sums)| *sums).collect();
    let n_outputs = sums.iter().filter(|sums| sums.about_mean > 0.0).count();
    let are_all_worse = are_all_worse(&sums);
    let finding = |output: &OutputResiduals| {
        let sums_of_output = Sums::of(output, residuals);
        if !sums_of_output.is_worse_than_a_constant() {
            return None;
        }
        let all = of_variables.iter().find(|(variable, _)| *variable == output.variable)?.1;
        let same = layout.outputs.iter().filter(|other| other.variable == output.variable);
        let share = same.map(|other| sum_of_squares(&residuals[other.range.clone()])).sum::<f64>() / cost;
        let is_no_chance = all.is_worse_than_a_constant() && all.is_no_chance();
        let severity = match are_all_worse || is_no_chance && share >= SHARE {
            true => Severity::Error,
            false => Severity::Warning,
        };
        let prefix = if names.len() == 1 { "" } else { &format!("{}: ", names[output.experiment]) };
        let sentence = format!(
            "the fit is worse than a constant: its residuals have an RMS of {}, the measurements a standard deviation of {}. {}",
            digits((sums_of_output.differences / sums_of_output.n).sqrt()),
            digits((sums_of_output.about_mean / sums_of_output.n).sqrt()),
            match (sums_of_output.is_no_chance(), are_all_worse, severity) {
                (true, _, Severity::Error) => "The fitted values are unusable".to_owned(),
                (true, ..) =>
                    "The output contributes little to the cost, or is reproduced in other recordings"
                        .to_owned(),
                (false, true, _) => format!(
                    "In {} rows this may be chance, but for {n_outputs} outputs together it is not",
                    sums_of_output.n
                ),
                (false, false, _) => format!("In {} rows this may be chance", sums_of_output.n),
            }
        );
        let subject = format!("{prefix}output '{}' (column '{}')", output.variable, output.column);
        let remedy = "Check the column, its unit and sign, and the initial state. If they are right, try other start values or \
                      search=\"global\"";
        Some(
            Finding::new(severity, FindingId::WorseThanConstant, subject, sentence, remedy)
                .of(Origin::Residuals),
        )
    };
    layout.outputs.iter().filter_map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values 1, 2, 3, 4 have the sum of squares 5 about their mean 2.5.
    #[test]
    fn sums_combine_to_the_sums_of_all_values() {
        let one = |y: f64, d: f64| Sums { n: 1.0, mean: y, about_mean: 0.0, differences: d * d };
        let [a, b] = [one(1.0, 0.5).with(one(2.0, 0.5)), one(3.0, 1.0).with(one(4.0, 2.0))];
        let all = a.with(b);
        assert_eq!((all.n, all.mean, all.about_mean, all.differences), (4.0, 2.5, 5.0, 5.5));
        assert!(!all.is_worse_than_a_constant());
        // Four values with twice the deviation may occur by chance.
        let few = Sums { differences: 20.0, ..all };
        assert!(few.is_worse_than_a_constant() && !few.is_no_chance());
        // A set with 40 times as many values is significant unless the misfit may be due to rounding.
        let many = Sums { n: 160.0, about_mean: 200.0, differences: 1600.0, ..all };
        assert!(many.is_worse_than_a_constant() && many.is_no_chance());
        assert!(!Sums { mean: 1e12, ..many }.is_worse_than_a_constant());
        assert!(!Sums { about_mean: 0.0, ..many }.is_worse_than_a_constant());
    }

    /// Alpha-pinene from a start at zero: the sums of squares of five outputs with eight rows each are 3.6,
    /// 1.5, 141, 74 and 3.9 times the sums about their means.
    #[test]
    fn misfit_is_combined_when_all_outputs_are_worse_than_a_constant() {
        let sums = |ratio: f64| Sums { n: 8.0, mean: 1.0, about_mean: 1.0, differences: ratio };
        let all = [3.6, 1.5, 141.0, 74.0, 3.9].map(sums);
        assert!(!all[0].is_no_chance() && are_all_worse(&all));
        // The first set contains a reproduced output. The misfits of the second set may both be due to
        // chance: their probabilities are 0.33 and 0.2, or 0.25 by Fisher's method.
        assert!(!are_all_worse(&[sums(0.1), all[2]]));
        assert!(!are_all_worse(&[sums(1.37), sums(1.58)]));
        // A constant output does not count, and a single output has a separate test.
        let constant = Sums { about_mean: 0.0, ..all[0] };
        assert!(are_all_worse(&[constant, all[2], all[3]]) && !are_all_worse(&[constant, all[2]]));
        let clear = Sums { n: 100.0, ..sums(1.3) };
        assert!(!are_all_worse(&[clear]) && !clear.is_no_chance() && clear.chance() < CHANCE);
    }
}
