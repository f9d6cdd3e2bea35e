//! Weights and learning rates for the given numbers of parameters and individuals (tutorial, table 1).

use serde::{Deserialize, Serialize};

/// Weights of the ranks, and learning rates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Weights {
    /// One weight per rank. The first `n_parents` are positive and sum to 1; the others are not positive.
    pub(super) of_rank: Vec<f64>,
    pub(super) n_parents: usize,
    pub(super) c_sigma: f64,
    pub(super) d_sigma: f64,
    pub(super) c_c: f64,
    pub(super) c_1: f64,
    pub(super) c_mu: f64,
    /// Expected length of a vector of `n` standard normal numbers.
    pub(super) chi: f64,
    /// Number of generations between decompositions of the covariance matrix.
    pub(super) interval: u64,
}

/// Relative change of the covariance matrix below which its decomposition is delayed, for at most `n / 2`
/// generations. Therefore an evaluation takes O(n^2) operations.
const UNSEEN: f64 = 0.02;

/// Returns the variance effective selection mass, equation 8.
pub(super) fn effective(weights: &[f64]) -> f64 {
    let (sum, squares) = weights.iter().fold((0.0, 0.0), |(s, q), w| (s + w, q + w * w));
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

impl Weights {
    pub(super) fn new(n: usize, members: usize) -> Self {
        let d = n.max(1) as f64;
        // Equation 49.
        let half = (0.5 * (members as f64 + 1.0)).ln();
        let mut of_rank: Vec<f64> = (1..=members).map(|i| half - (i as f64).ln()).collect();
        let n_parents = (members / 2).max(1);
        let (positive, negative) = of_rank.split_at_mut(n_parents);
        let (mu_eff, mu_eff_minus) = (effective(positive), effective(negative));
        // Equations 55 to 58.
        let c_sigma = (mu_eff + 2.0) / (d + mu_eff + 5.0);
        let d_sigma = 1.0 + 2.0 * (((mu_eff - 1.0) / (d + 1.0)).max(0.0).sqrt() - 1.0).max(0.0) + c_sigma;
        let c_c = (4.0 + mu_eff / d) / (d + 4.0 + 2.0 * mu_eff / d);
        let c_1 = 2.0 / ((d + 1.3).powi(2) + mu_eff);
        let c_mu = (2.0 * (0.25 + mu_eff + 1.0 / mu_eff - 2.0) / ((d + 2.0).powi(2) + mu_eff)).min(1.0 - c_1);
        // Section B.2 uses only the first term, a few generations for many parameters. pycma waits five times
        // as long.
        let tutorial = 1.0 / (10.0 * d * (c_1 + c_mu));
        let interval = tutorial.max((0.5 * d).min(UNSEEN / (c_1 + c_mu))).max(1.0) as u64;
        // Equations 50 to 53.
        let sum: f64 = positive.iter().sum();
        if members == 1 {
            positive[0] = 1.0;
        } else {
            positive.iter_mut().for_each(|w| *w /= sum);
        }
        let sum = -negative.iter().sum::<f64>();
        let largest = (1.0 + c_1 / c_mu)
            .min(1.0 + 2.0 * mu_eff_minus / (mu_eff + 2.0))
            .min((1.0 - c_1 - c_mu) / (d * c_mu));
        negative.iter_mut().for_each(|w| *w *= largest / sum);
        Self {
            of_rank,
            n_parents,
            c_sigma,
            d_sigma,
            c_c,
            c_1,
            c_mu,
            chi: d.sqrt() * (1.0 - 1.0 / (4.0 * d) + 1.0 / (21.0 * d * d)),
            interval,
        }
    }

    pub(super) fn is_sound(&self, members: usize) -> bool {
        self.of_rank.len() == members && (1..=members).contains(&self.n_parents) && self.interval > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_match_the_tutorial() {
        for (n, members) in [(1, 4), (2, 6), (5, 8), (10, 10), (10, 100), (40, 15), (3, 2), (2, 5)] {
            let weights = Weights::new(n, members);
            let (positive, negative) = weights.of_rank.split_at(weights.n_parents);
            assert!((positive.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{n} {members}");
            assert!(positive.iter().all(|w| *w > 0.0) && negative.iter().all(|w| *w <= 0.0));
            assert!(weights.of_rank.windows(2).all(|w| w[0] > w[1]), "{weights:?}");
            // The covariance matrix stays positive definite.
            let kept = 1.0 - weights.c_1 - weights.c_mu * weights.of_rank.iter().sum::<f64>();
            let taken = weights.c_mu * n as f64 * -negative.iter().sum::<f64>();
            assert!(kept > 0.0 && taken <= 1.0 - weights.c_1 - weights.c_mu + 1e-12, "{n} {members}");
        }
        // By hand, for n = 10 and 10 individuals: mu_eff = 3.167, c_sigma = 5.167 / 18.167.
        let weights = Weights::new(10, 10);
        assert!((effective(&weights.of_rank[..5]) - 3.167).abs() < 1e-3);
        assert!((weights.c_sigma - 0.2844).abs() < 1e-4 && (weights.c_1 - 0.01528).abs() < 1e-5);
        assert!((weights.chi - 3.0847).abs() < 1e-3 && weights.interval == 1);
        let interval = |n, members| Weights::new(n, members).interval;
        assert_eq!([interval(100, 17), interval(1000, 24), interval(40, 10_000)], [22, 500, 1]);
    }
}
