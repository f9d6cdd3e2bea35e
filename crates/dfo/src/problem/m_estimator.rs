//! M-estimators. Near the solution of a fit with a robust loss, its equations are the equations of linear
//! least squares with modified residuals.

use super::loss::RobustLoss;

/// Median of the absolute value of a standard normal number.
const MEDIAN_DEVIATION: f64 = 0.674_489_750_196_081_7;

/// Slope of the mean score of identically distributed residuals, and the correction of their variance.
///
/// The covariance of the parameters is `c mean psi^2 / l^2 (J'J)^-1` with the scores `psi(r)`
/// ([`RobustLoss::score`]), their mean slope l, and the correction c (Huber, Robust Statistics, 1981, section
/// 7.6). It equals the covariance of linear least squares with the residuals `psi / l`, whose variance is
/// multiplied by c.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanScore {
    /// Slope l of the mean score; positive.
    pub slope: f64,
    /// Huber's correction for small samples of N residuals and p parameters: the square of
    /// `1 + p/N var(psi') / l^2`.
    pub correction: f64,
}

impl RobustLoss {
    /// Returns half the derivative of the contribution of a residual.
    pub fn score(&self, r: f64) -> f64 {
        self.transform(r) * self.slope(r)
    }

    /// Returns the slope of the score over `width` to both sides of a residual.
    pub fn score_slope(&self, r: f64, width: f64) -> f64 {
        (self.score(r + width) - self.score(r - width)) / (2.0 * width)
    }

    /// Returns the mean score of residuals from which a fit has determined `p_by_n` parameters per residual.
    /// `None` if all residuals are zero or one is not finite.
    ///
    /// The slope is a central difference over the bandwidth of a density estimate (Silverman, Density
    /// Estimation, 1986, section 3.4: `0.9 s N^(-1/5)`). If the loss is narrow relative to the noise, the
    /// slopes at the few residuals within its scale would be much too steep.
    pub fn mean_score(&self, residuals: &[f64], p_by_n: f64) -> Option<MeanScore> {
        let n = residuals.len() as f64;
        let of = |values: &dyn Fn(f64) -> f64| residuals.iter().map(|r| values(*r)).sum::<f64>() / n;
        let mean_square = of(&|r| r * r);
        if !(mean_square > 0.0 && mean_square.is_finite()) {
            return None;
        }
        if self.is_linear() {
            return Some(MeanScore { slope: 1.0, correction: 1.0 });
        }
        let mut sorted = residuals.to_vec();
        let middle = median(&mut sorted);
        sorted.iter_mut().for_each(|r| *r = (*r - middle).abs());
        let spread = (median(&mut sorted) / MEDIAN_DEVIATION).max(1e-6 * mean_square.sqrt());
        let width = 0.9 * spread * n.powf(-0.2);
        let mean_of_all = of(&|r| self.score_slope(r, width));
        // The mean slope of a loss that decreases far from zero may not be positive. The mean slope of normal
        // residuals (Stein's identity) is positive.
        let least = of(&|r| self.score(r) * r) / mean_square;
        let slope = self.mean_slope(residuals, width, p_by_n).max(least);
        let variance = of(&|r| (self.score_slope(r, width) - mean_of_all).powi(2));
        Some(MeanScore { slope, correction: (1.0 + p_by_n * variance / (slope * slope)).powi(2) })
    }

    /// Returns the mean slope of the score without the residuals nearest to zero. The number of omitted
    /// residuals is the number of parameters. With a narrow loss, a fit passes almost exactly through this
    /// number of measurements. Their residuals do not show how many of the other residuals are near zero
    /// (Schrader and McKean in Dodge, ed., Statistical Data Analysis Based on the L1 Norm, 1987).
    fn mean_slope(&self, residuals: &[f64], width: f64, p_by_n: f64) -> f64 {
        let mut sorted = residuals.to_vec();
        sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        let n_fitted = (p_by_n * sorted.len() as f64).round() as usize;
        let others = sorted.get(n_fitted..).filter(|others| !others.is_empty()).unwrap_or(&sorted);
        others.iter().map(|r| self.score_slope(*r, width)).sum::<f64>() / others.len() as f64
    }
}

/// Sorts the values and returns their median.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::loss::Loss;

    /// Returns evenly spaced values between -2 and 2, and two outliers.
    fn residuals() -> Vec<f64> {
        let mut r: Vec<f64> = (0..98).map(|k| ((f64::from(k) + 0.5) / 98.0 - 0.5) * 4.0).collect();
        r.extend([50.0, -50.0]);
        r
    }

    fn loss(kind: Loss, scale: f64) -> RobustLoss {
        RobustLoss::new(kind, scale).unwrap()
    }

    #[test]
    fn mean_score_matches_least_squares_when_loss_is_wide() {
        for kind in [Loss::Linear, Loss::Huber, Loss::SoftL1, Loss::Cauchy] {
            let MeanScore { slope, correction } = loss(kind, 1e6).mean_score(&residuals(), 0.02).unwrap();
            assert!((slope - 1.0).abs() < 1e-6 && (correction - 1.0).abs() < 1e-6, "{kind:?}");
        }
    }

    #[test]
    fn mean_score_counts_residuals_within_narrow_loss() {
        // For Huber's loss with scale 1, half of the residuals are within the scale: mean psi' = 0.49 for all
        // without smoothing.
        let MeanScore { slope, correction } = loss(Loss::Huber, 1.0).mean_score(&residuals(), 0.02).unwrap();
        assert!((slope - 0.49).abs() < 0.02, "{slope}");
        // Over the bandwidth 0.9 * 1 / 0.6745 * 100^(-1/5) = 0.53 it decreases from 1 at 0.47 to 0 at 1.53:
        // mean square (0.47 + 1.06 / 3) 0.49.
        let expected = (1.0 + 0.02 * ((0.47 + 1.06 / 3.0) * 0.49 - 0.49 * 0.49) / (0.49 * 0.49_f64)).powi(2);
        assert!((correction - expected).abs() < 2e-3, "{correction}");
    }

    #[test]
    fn mean_slope_excludes_residuals_fitted_to_zero() {
        let (narrow, r) = (loss(Loss::Huber, 0.01), residuals());
        let with_fitted: Vec<f64> = [0.0, 0.0].into_iter().chain(r.iter().copied()).collect();
        assert_eq!(narrow.mean_slope(&with_fitted, 0.5, 2.0 / 102.0), narrow.mean_slope(&r, 0.5, 0.0));
    }

    #[test]
    fn zero_or_nonfinite_residuals_have_no_mean_score() {
        let huber = loss(Loss::Huber, 1.0);
        assert_eq!([&[][..], &[0.0, 0.0], &[1.0, f64::NAN]].map(|r| huber.mean_score(r, 0.1)), [None; 3]);
    }
}
