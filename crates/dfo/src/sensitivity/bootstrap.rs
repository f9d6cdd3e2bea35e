//! Confidence intervals by the bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap, 1993,
//! section 13.3). As in SALib, the interval is the estimate plus or minus the normal quantile times the
//! standard deviation of the estimates from resampled rows.

use crate::method_interface::rng::{Purpose, Stream};
use statrs::distribution::{ContinuousCDF, Normal};

/// Generation of the random numbers of resampling. The designs use other generations.
const GENERATION: u64 = 4;

/// Resampling of rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bootstrap {
    pub(super) level: f64,
    pub(super) n_resamples: usize,
    pub(super) seed: u64,
}

impl Bootstrap {
    /// Returns the half widths of the confidence intervals of `n` quantities, which `estimate` computes from
    /// the indices of resampled rows. Estimates that are not finite are left out.
    pub(super) fn half_widths(
        &self,
        n_rows: usize,
        n: usize,
        estimate: impl Fn(&[usize], &mut [f64]),
    ) -> Vec<f64> {
        let mut rows = vec![0; n_rows];
        let mut estimates = vec![0.0; n];
        let mut spreads = vec![Spread::default(); n];
        for resample in 0..self.n_resamples {
            let mut stream = Stream::new(self.seed, Purpose::Sampling, GENERATION, resample);
            rows.iter_mut().for_each(|row| *row = stream.below(n_rows));
            estimate(&rows, &mut estimates);
            spreads.iter_mut().zip(&estimates).for_each(|(spread, value)| spread.add(*value));
        }
        let quantile = Normal::standard().inverse_cdf(0.5 + 0.5 * self.level);
        spreads.iter().map(|spread| quantile * spread.deviation()).collect()
    }
}

/// Mean and sum of squares about it (Welford, Technometrics 4, 1962).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Spread {
    n: f64,
    pub(super) mean: f64,
    squares: f64,
}

impl Spread {
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut spread = Self::default();
        values.for_each(|value| spread.add(value));
        spread
    }

    fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.n += 1.0;
            let before = value - self.mean;
            self.mean += before / self.n;
            self.squares += before * (value - self.mean);
        }
    }

    /// Returns the standard deviation of the population; NaN for fewer than two values.
    pub(super) fn deviation(&self) -> f64 {
        if self.n < 2.0 { f64::NAN } else { (self.squares / (self.n - 1.0)).sqrt() }
    }
}
