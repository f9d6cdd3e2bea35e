//! Scores of the residuals in the equations that a fit solves, for least squares, robust losses and the
//! likelihood. Near the solution, each of these is a linear least-squares problem with other residuals and
//! rows.

use crate::problem::objective::{NamedCost, likelihood_variances};
use crate::problem::residual_layout::ResidualLayout;
use crate::uncertainty::group::Group;
use dfo::{MeanScore, RobustLoss};
use nalgebra::DVector;

/// Cost that a fit minimises, as a function of the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Criterion {
    /// Sum of squared residuals with a loss.
    Loss(RobustLoss),
    /// Likelihood with an unknown standard deviation for each output; see [`NamedCost`](crate::NamedCost).
    Likelihood,
}

impl Default for Criterion {
    fn default() -> Self {
        Self::Loss(RobustLoss::default())
    }
}

impl Criterion {
    /// True if there is no loss.
    pub(crate) fn is_sum_of_squares(self) -> bool {
        matches!(self, Self::Loss(loss) if loss.is_linear())
    }

    /// Returns the cost of plain residuals.
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

/// Residuals of a linear least-squares problem with the same solution and curvature as the fit. The scores
/// `psi(r)` are half the derivative of the cost of a residual, and `l` is their mean slope over an output.
/// The working residuals are `psi / sqrt(l)`, and the working rows are the rows of the Jacobian times
/// `sqrt(l)`.
pub(crate) struct Working {
    pub(crate) residuals: Vec<f64>,
    /// `sqrt(l)` for each residual.
    pub(crate) roots: Vec<f64>,
    /// Factor of the variance of each residual: Huber's correction for small samples.
    pub(crate) corrections: Vec<f64>,
}

impl Working {
    /// Computes the working residuals for p parameters and N residuals. With a loss, they lead to the
    /// covariance of an M-estimator, see [`MeanScore`]. With the likelihood, an output is weighted with the
    /// inverse of its variance, which gives Fisher's information. Priors have no loss.
    pub(crate) fn new(
        criterion: Criterion,
        layout: &ResidualLayout,
        plain: &[f64],
        groups: &[Group],
        p: usize,
    ) -> Self {
        let n = plain.len();
        let mut working = Self { residuals: plain.to_vec(), roots: vec![1.0; n], corrections: vec![1.0; n] };
        for group in groups {
            let rows: Vec<usize> = group.rows().collect();
            let squares: f64 = rows.iter().map(|i| plain[*i] * plain[*i]).sum();
            if squares == 0.0 || !squares.is_finite() {
                continue;
            }
            match criterion {
                Criterion::Loss(loss) if loss.is_linear() => {}
                Criterion::Loss(loss) => working.count_robustly(loss, &rows, p as f64 / n as f64),
                Criterion::Likelihood => {
                    let variances = likelihood_variances(layout, plain);
                    let variance = group.outputs.first().and_then(|k| variances.get(*k));
                    let variance = variance.map_or(squares / rows.len() as f64, |(variance, _)| *variance);
                    let root = variance.sqrt().recip();
                    for &i in &rows {
                        (working.roots[i], working.residuals[i]) = (root, plain[i] * root);
                    }
                }
            }
        }
        working
    }

    /// Returns the variance of the plain residuals divided by the variance of the working residuals, for each
    /// output.
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

    /// Weights a change of the residuals like the rows of the Jacobian.
    pub(crate) fn weigh(&self, change: &mut DVector<f64>) {
        change.iter_mut().zip(&self.roots).for_each(|(change, root)| *change *= root);
    }

    /// Returns the weighted change.
    pub(crate) fn weighed(&self, change: &DVector<f64>) -> DVector<f64> {
        let mut weighed = change.clone();
        self.weigh(&mut weighed);
        weighed
    }

    fn count_robustly(&mut self, loss: RobustLoss, rows: &[usize], p_by_n: f64) {
        let plain: Vec<f64> = rows.iter().map(|i| self.residuals[*i]).collect();
        let Some(MeanScore { slope, correction }) = loss.mean_score(&plain, p_by_n) else { return };
        for (&i, plain) in rows.iter().zip(plain) {
            self.residuals[i] = loss.score(plain) / slope.sqrt();
            (self.roots[i], self.corrections[i]) = (slope.sqrt(), correction);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dfo::Loss;

    #[test]
    fn working_residuals_match_least_squares_and_m_estimator() {
        // Quantiles of the normal distribution, and two outliers.
        let mut r: Vec<f64> = (0..98).map(|k| ((f64::from(k) + 0.5) / 98.0 - 0.5) * 4.0).collect();
        r.extend([50.0, -50.0]);
        let groups =
            [Group { outputs: vec![0], series: std::iter::once(0..100).collect(), ..Group::default() }];
        let with = |kind, scale| {
            let criterion = Criterion::Loss(RobustLoss::new(kind, scale).unwrap());
            Working::new(criterion, &ResidualLayout::default(), &r, &groups, 2)
        };
        for kind in [Loss::Linear, Loss::Huber, Loss::SoftL1, Loss::Cauchy] {
            let working = with(kind, 1e6);
            assert!(
                working.residuals.iter().zip(&r).all(|(w, r)| (w - r).abs() < 1e-6 * r.abs()),
                "{kind:?}"
            );
            assert!(working.roots.iter().chain(&working.corrections).all(|one| (one - 1.0).abs() < 1e-6));
        }
        // With Huber's loss at scale 1, half the residuals are within the scale: mean psi' = 0.49
        // for all but the smoothing.
        let working = with(Loss::Huber, 1.0);
        let slope = working.roots[0] * working.roots[0];
        assert!((slope - 0.49).abs() < 0.02, "{slope}");
        // Over the bandwidth 0.9 * 1 / 0.6745 * 100^(-1/5) = 0.53, the slope falls from 1 at 0.47
        // to 0 at 1.53: mean square (0.47 + 1.06 / 3) 0.49.
        let expected = (1.0 + 0.02 * ((0.47 + 1.06 / 3.0) * 0.49 - 0.49 * 0.49) / (0.49 * 0.49_f64)).powi(2);
        assert!((working.corrections[0] - expected).abs() < 2e-3, "{}", working.corrections[0]);
        assert!((working.residuals[98] * working.roots[98] - 1.0).abs() < 1e-12);
        let likelihood = Working::new(Criterion::Likelihood, &ResidualLayout::default(), &r, &groups, 2);
        let squares: f64 = likelihood.residuals.iter().map(|r| r * r).sum();
        assert!((squares - 100.0).abs() < 1e-9);
    }
}
