//! Test of the residuals against the pure error of replicates.

use crate::findings::display_text::digits;
use crate::findings::finding::{Finding, Origin};
use crate::findings::identifier::FindingId;
use crate::problem::residual_layout::ResidualLayout;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use std::fmt;

/// Probability below which a lack of fit is reported as a warning, the usual level of a strict test.
const UNLIKELY: f64 = 0.01;

/// Test of a fit to replicates, which are several measurements of an output at one time. Their differences
/// are pure error, independent of the model. If the model fits, the remaining part of the residuals has the
/// same variance (Draper and Smith, Applied Regression Analysis, 1998, section 2.1). Weights must make the
/// outputs comparable.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct LackOfFit {
    /// Standard deviation of the weighted measurements around the means of their replicates.
    pub pure_error: f64,
    /// Degrees of freedom of the pure error: the number of replicates minus the number of their times.
    pub pure_degrees_of_freedom: f64,
    /// Degrees of freedom of the other part of the residuals.
    pub degrees_of_freedom: f64,
    /// Variance of the other part divided by the variance of the pure error.
    pub f: f64,
    /// Probability of a larger `f` if the model fits.
    pub p: f64,
}

impl LackOfFit {
    /// Compares residuals that have `degrees_of_freedom` with their pure error. Returns `None` if there are
    /// no replicates, if all replicates are equal, or if they leave no degrees of freedom.
    pub(crate) fn new(layout: &ResidualLayout, residuals: &[f64], degrees_of_freedom: f64) -> Option<Self> {
        let (mut pure, mut total, mut n_pure) = (0.0, 0.0, 0);
        for output in &layout.outputs {
            let rows: Vec<usize> = output.noisy_rows().collect();
            let time = |row: &usize| output.times[row - output.range.start];
            for replicates in rows.chunk_by(|a, b| time(a) == time(b)) {
                let of = || replicates.iter().map(|row| residuals[*row]);
                let mean = of().sum::<f64>() / replicates.len() as f64;
                total += of().map(|r| r * r).sum::<f64>();
                pure += of().map(|r| (r - mean) * (r - mean)).sum::<f64>();
                n_pure += replicates.len() - 1;
            }
        }
        let pure_degrees = n_pure as f64;
        let other_degrees = degrees_of_freedom - pure_degrees;
        if n_pure == 0 || pure <= 0.0 || other_degrees <= 0.0 {
            return None;
        }
        let f = (total - pure) / other_degrees / (pure / pure_degrees);
        let p = FisherSnedecor::new(other_degrees, pure_degrees).ok()?.sf(f);
        let pure_error = (pure / pure_degrees).sqrt();
        Some(Self {
            pure_error,
            pure_degrees_of_freedom: pure_degrees,
            degrees_of_freedom: other_degrees,
            f,
            p,
        })
    }

    /// Returns the finding about a lack of fit that is unlikely to be chance.
    pub(crate) fn finding(&self) -> Option<Finding> {
        let meaning = "The model lacks an effect that exceeds the scatter of the replicates";
        let remedy = "Plot the residuals, and look for a missing effect or a wrong input";
        (self.p < UNLIKELY).then(|| {
            Finding::warning(FindingId::LackOfFit, "replicates", format!("{self}. {meaning}"), remedy)
                .of(Origin::Residuals)
        })
    }
}

/// Describes the test.
impl fmt::Display for LackOfFit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [ratio, p, error] = [self.f, self.p, self.pure_error].map(digits);
        let [first, second] =
            [self.degrees_of_freedom, self.pure_degrees_of_freedom].map(|n| digits(n.round()));
        write!(
            f,
            "the lack of fit is F({first}, {second}) = {ratio} (p = {p}), with the pure error {error} of the replicates"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::residual_layout::OutputResiduals;

    fn layout() -> ResidualLayout {
        let output = OutputResiduals {
            experiment: 0,
            output: 0,
            variable: "x".to_owned(),
            column: "x".to_owned(),
            range: 0..6,
            times: [0.0, 0.0, 1.0, 1.0, 2.0, 2.0].into_iter().collect(),
            measured: vec![1.0; 6].into(),
            weights: vec![1.0; 6].into(),
            starts_simulation: false,
            is_noise_known: false,
            is_log: false,
        };
        ResidualLayout { outputs: vec![output], ..ResidualLayout::default() }
    }

    /// Pure error: three pairs at a distance of 2, so that its sum of squares is 6 with 3 degrees of freedom.
    #[test]
    fn lack_of_fit_matches_textbook_values() {
        let r = [0.0, 2.0, -1.0, 1.0, -2.0, 0.0];
        let test = LackOfFit::new(&layout(), &r, 4.0).unwrap();
        assert!((test.pure_error - 2.0_f64.sqrt()).abs() < 1e-15);
        assert_eq!((test.pure_degrees_of_freedom, test.degrees_of_freedom), (3.0, 1.0));
        // The means 1, 0 and -1 leave a sum of squares of 4 with 1 degree of freedom. F(1, 3) is the square of
        // Student's t with 3 degrees of freedom: p = 0.2522 for t = sqrt(2).
        assert!((test.f - 2.0).abs() < 1e-15 && (test.p - 0.2522).abs() < 1e-4, "{test:?}");
        assert!(test.finding().is_none());
        let sentence = test.to_string();
        assert!(sentence.starts_with("the lack of fit is F(1, 3) = 2 (p = 0.2522)"), "{sentence}");
        assert!(LackOfFit::new(&layout(), &[1.0; 6], 4.0).is_none());
    }
}
