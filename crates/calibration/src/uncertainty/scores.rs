//! Scores of the residuals in the equations that a fit solves, for least squares, robust losses and the
//! likelihood: near its solution all of them are linear least squares with other residuals and rows.

use crate::problem::objective::NamedCost;
use crate::problem::residual_layout::ResidualLayout;
use crate::uncertainty::group::Group;
use crate::uncertainty::p_values::{MEDIAN_DEVIATION, median};
use dfo::RobustLoss;
use nalgebra::DVector;

/// Form of the cost that a fit minimises, as a function of the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Criterion {
    /// The sum of what they count.
    Loss(RobustLoss),
    /// The likelihood with an unknown standard deviation for each output, see
    /// [`NamedCost`](crate::NamedCost).
    Likelihood,
}

impl Default for Criterion {
    fn default() -> Self {
        Self::Loss(RobustLoss::default())
    }
}

impl Criterion {
    /// True without a loss.
    pub(crate) fn is_sum_of_squares(self) -> bool {
        matches!(self, Self::Loss(loss) if loss.is_linear())
    }

    /// The cost of plain residuals.
    pub(crate) fn cost(self, layout: &ResidualLayout, residuals: &[f64]) -> f64 {
        match self {
            Self::Loss(loss) => {
                let (measured, priors) = residuals.split_at(layout.n_measurements());
                let counted = measured.iter().map(|r| loss.transform(*r));
                counted.chain(priors.iter().copied()).fold(0.0, |sum, r| sum + r * r)
            }
            Self::Likelihood => NamedCost::Likelihood.cost(layout, residuals),
        }
    }
}

/// The residuals of a problem of linear least squares with the same solution and the same curvature as the
/// fit's: with the scores `psi(r)` (half the derivative of what a residual counts) and their mean slope `l`
/// over an output, its residuals are `psi / sqrt(l)` and its rows those of the Jacobian times `sqrt(l)`.
pub(crate) struct Working {
    pub(crate) residuals: Vec<f64>,
    /// `sqrt(l)` of each residual.
    pub(crate) roots: Vec<f64>,
    /// Factor of the variance of each residual: Huber's correction for small samples.
    pub(crate) corrections: Vec<f64>,
}

impl Working {
    /// For an M-estimator with these losses the covariance `mean psi^2 / (mean psi')^2 (J'J)^-1` comes out,
    /// times the square of `1 + p/N var(psi') / (mean psi')^2` (Huber, Robust Statistics, 1981, section 7.6),
    /// p parameters and N residuals. The slope of the mean score is taken over the bandwidth of a density
    /// estimate (Silverman, Density Estimation, 1986, section 3.4: `0.9 s N^(-1/5)`) to both sides: where the
    /// loss is narrow against the noise, slopes at the few residuals that lie within are much too steep. With
    /// the likelihood an output counts by the inverse of its variance, which is Fisher's information. Priors
    /// have no loss.
    pub(crate) fn new(criterion: Criterion, plain: &[f64], groups: &[Group], p: usize) -> Self {
        let n = plain.len();
        let mut own = Self { residuals: plain.to_vec(), roots: vec![1.0; n], corrections: vec![1.0; n] };
        for group in groups {
            let rows: Vec<usize> = group.rows().collect();
            let squares: f64 = rows.iter().map(|i| plain[*i] * plain[*i]).sum();
            if squares == 0.0 || !squares.is_finite() {
                continue;
            }
            match criterion {
                Criterion::Loss(loss) if loss.is_linear() => {}
                Criterion::Loss(loss) => own.count_robustly(loss, &rows, p as f64 / n as f64),
                Criterion::Likelihood => {
                    let root = (rows.len() as f64 / squares).sqrt();
                    for &i in &rows {
                        (own.roots[i], own.residuals[i]) = (root, plain[i] * root);
                    }
                }
            }
        }
        own
    }

    /// Variance of the plain residuals of each output over that of the working ones.
    pub(crate) fn plain_over_working(
        &self,
        layout: &ResidualLayout,
        plain: &[f64],
        groups: &[Group],
    ) -> Vec<f64> {
        let mut ratios = vec![1.0; layout.outputs.len()];
        for group in groups {
            let sum = |of: &[f64]| group.rows().map(|i| of[i] * of[i]).sum::<f64>();
            let correction = group.rows().next().map_or(1.0, |i| self.corrections[i]);
            let ratio = sum(plain) / (sum(&self.residuals) * correction);
            if ratio > 0.0 && ratio.is_finite() {
                group.outputs.iter().for_each(|k| ratios[*k] = ratio);
            }
        }
        ratios
    }

    /// Weighs a change of the residuals as the rows of the Jacobian.
    pub(crate) fn weigh(&self, change: &mut DVector<f64>) {
        change.iter_mut().zip(&self.roots).for_each(|(change, root)| *change *= root);
    }

    /// The change, weighed.
    pub(crate) fn weighed(&self, change: &DVector<f64>) -> DVector<f64> {
        let mut own = change.clone();
        self.weigh(&mut own);
        own
    }

    fn count_robustly(&mut self, loss: RobustLoss, rows: &[usize], p_by_n: f64) {
        let n = rows.len() as f64;
        let of =
            |values: &dyn Fn(f64) -> f64| rows.iter().map(|i| values(self.residuals[*i])).sum::<f64>() / n;
        let mut sorted: Vec<f64> = rows.iter().map(|i| self.residuals[*i]).collect();
        let middle = median(&mut sorted);
        sorted.iter_mut().for_each(|r| *r = (*r - middle).abs());
        let mean_square = of(&|r| r * r);
        let spread = (median(&mut sorted) / MEDIAN_DEVIATION).max(1e-6 * mean_square.sqrt());
        let width = 0.9 * spread * n.powf(-0.2);
        let mean_of_all = of(&|r| slope(loss, r, width));
        let mean = mean_slope(loss, rows.iter().map(|i| self.residuals[*i]), width, p_by_n);
        // A loss that falls far from zero may have no mean slope; that of normal residuals (Stein's identity) is above zero.
        let least = of(&|r| score(loss, r) * r) / mean_square;
        let variance = of(&|r| (slope(loss, r, width) - mean_of_all).powi(2));
        let mean = mean.max(least);
        let correction = (1.0 + p_by_n * variance / (mean * mean)).powi(2);
        for &i in rows {
            self.residuals[i] = score(loss, self.residuals[i]) / mean.sqrt();
            (self.roots[i], self.corrections[i]) = (mean.sqrt(), correction);
        }
    }
}

/// The mean slope of the score, without as many of the residuals next to zero as there are parameters: with a
/// narrow loss a fit goes through so many measurements, nearly, and these say nothing of how many residuals
/// of others lie there (Schrader and McKean in Dodge, ed., Statistical Data Analysis Based on the L1 Norm,
/// 1987).
fn mean_slope(loss: RobustLoss, residuals: impl Iterator<Item = f64>, width: f64, p_by_n: f64) -> f64 {
    let mut sorted: Vec<f64> = residuals.collect();
    sorted.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let n_fitted = (p_by_n * sorted.len() as f64).round() as usize;
    let others = sorted.get(n_fitted..).filter(|others| !others.is_empty()).unwrap_or(&sorted);
    others.iter().map(|r| slope(loss, *r, width)).sum::<f64>() / others.len() as f64
}

/// Half the derivative of what a residual counts.
fn score(loss: RobustLoss, r: f64) -> f64 {
    loss.transform(r) * loss.slope(r)
}

/// The slope of the score over a width to both sides.
fn slope(loss: RobustLoss, r: f64, width: f64) -> f64 {
    (score(loss, r + width) - score(loss, r - width)) / (2.0 * width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dfo::Loss;

    #[test]
    fn a_wide_loss_is_least_squares_and_a_narrow_one_that_of_an_m_estimator() {
        // Quantiles of the normal distribution, and two outliers.
        let mut r: Vec<f64> = (0..98).map(|k| ((f64::from(k) + 0.5) / 98.0 - 0.5) * 4.0).collect();
        r.extend([50.0, -50.0]);
        let groups = [Group { outputs: vec![0], series: vec![0..100], starts: Vec::new() }];
        let with = |kind, scale| {
            let criterion = Criterion::Loss(RobustLoss::new(kind, scale).unwrap());
            Working::new(criterion, &r, &groups, 2)
        };
        for kind in [Loss::Linear, Loss::Huber, Loss::SoftL1, Loss::Cauchy] {
            let working = with(kind, 1e6);
            assert!(
                working.residuals.iter().zip(&r).all(|(w, r)| (w - r).abs() < 1e-6 * r.abs()),
                "{kind:?}"
            );
            assert!(working.roots.iter().chain(&working.corrections).all(|one| (one - 1.0).abs() < 1e-6));
        }
        // Of Huber's loss with the scale 1 half the residuals lie within: mean psi' = 0.49 for all but the smoothing.
        let working = with(Loss::Huber, 1.0);
        let slope = working.roots[0] * working.roots[0];
        assert!((slope - 0.49).abs() < 0.02, "{slope}");
        // Over the bandwidth 0.9 * 1 / 0.6745 * 100^(-1/5) = 0.53 it falls from 1 at 0.47 to 0 at 1.53: mean square (0.47 + 1.06 / 3) 0.49.
        let expected = (1.0 + 0.02 * ((0.47 + 1.06 / 3.0) * 0.49 - 0.49 * 0.49) / (0.49 * 0.49_f64)).powi(2);
        assert!((working.corrections[0] - expected).abs() < 2e-3, "{}", working.corrections[0]);
        assert!((working.residuals[98] * working.roots[98] - 1.0).abs() < 1e-12);
        // Two residuals that a fit of two parameters has made zero say nothing of the density there.
        let narrow = RobustLoss::new(Loss::Huber, 0.01).unwrap();
        let exact = mean_slope(narrow, [0.0, 0.0].into_iter().chain(r.iter().copied()), 0.5, 2.0 / 102.0);
        assert_eq!(exact, mean_slope(narrow, r.iter().copied(), 0.5, 0.0));
        let likelihood = Working::new(Criterion::Likelihood, &r, &groups, 2);
        let squares: f64 = likelihood.residuals.iter().map(|r| r * r).sum();
        assert!((squares - 100.0).abs() < 1e-9);
    }
}
