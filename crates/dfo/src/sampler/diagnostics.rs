//! Convergence of Markov chains: split R-hat and the integrated autocorrelation time.

/// Window of the autocorrelation time, in autocorrelation times (Sokal, Monte Carlo Methods in Statistical
/// Mechanics, 1989).
const WINDOW: f64 = 5.0;

/// Returns the integrated autocorrelation time of several chains of equal length, in steps. The number of
/// effective draws is the number of all draws divided by this time.
///
/// The autocorrelation is averaged over the chains. The sum ends at the first lag that exceeds five times the
/// time (Sokal 1989), as in emcee. Constant chains, and chains shorter than two steps, return the length of a
/// chain.
pub fn autocorrelation_time(chains: &[Vec<f64>]) -> f64 {
    let len = chains.first().map_or(0, Vec::len);
    let n = (chains.len() * len) as f64;
    let mean = chains.iter().flatten().sum::<f64>() / n;
    let at_lag = |lag: usize| -> f64 {
        let of_chain = |chain: &Vec<f64>| -> f64 {
            chain[lag..].iter().zip(chain).map(|(a, b)| (a - mean) * (b - mean)).sum()
        };
        chains.iter().map(of_chain).sum()
    };
    let variance = if len < 2 { 0.0 } else { at_lag(0) };
    if variance.is_nan() || variance <= 0.0 {
        return len as f64;
    }
    let mut time = 1.0;
    for lag in 1..len {
        time += 2.0 * at_lag(lag) / variance;
        if lag as f64 >= WINDOW * time {
            break;
        }
    }
    time.max(1.0)
}

/// Returns split R-hat of several chains of equal length: the root of the ratio of the pooled variance to the
/// variance within half chains (Gelman et al., Bayesian Data Analysis, third edition, 2013, section 11.4). It
/// is close to 1 if the chains have converged; 1.05 is a usual limit. It is NaN for chains shorter than four
/// steps and for constant chains.
pub fn split_r_hat(chains: &[Vec<f64>]) -> f64 {
    let half = chains.first().map_or(0, Vec::len) / 2;
    if half < 2 {
        return f64::NAN;
    }
    let halves: Vec<&[f64]> =
        chains.iter().flat_map(|chain| [&chain[..half], &chain[chain.len() - half..]]).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let variance = |values: &[f64]| {
        let center = mean(values);
        values.iter().map(|v| (v - center).powi(2)).sum::<f64>() / (values.len() as f64 - 1.0)
    };
    let means: Vec<f64> = halves.iter().map(|half| mean(half)).collect();
    let within = mean(&halves.iter().map(|half| variance(half)).collect::<Vec<f64>>());
    let n = half as f64;
    ((n - 1.0) / n + variance(&means) / within).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method_interface::rng::{Purpose, Stream};

    /// Returns chains of a first-order autoregression, whose autocorrelation time is (1 + rho) / (1 - rho).
    fn autoregressions(rho: f64, n: usize) -> Vec<Vec<f64>> {
        let chain = |k: usize| {
            let mut stream = Stream::new(5, Purpose::Sampling, 0, k);
            let mut x = 0.0;
            let draw = |_| {
                x = rho * x + stream.normal(0.0, 1.0);
                x
            };
            (0..n).map(draw).collect()
        };
        (0..10).map(chain).collect()
    }

    #[test]
    fn autocorrelation_time_of_an_autoregression_is_its_closed_form() {
        for rho in [0.0, 0.5, 0.9f64] {
            let (found, expected) =
                (autocorrelation_time(&autoregressions(rho, 20_000)), (1.0 + rho) / (1.0 - rho));
            assert!((found / expected - 1.0).abs() < 0.1, "{rho}: {found} instead of {expected}");
        }
        assert_eq!(autocorrelation_time(&[vec![1.0; 5], vec![1.0; 5]]), 5.0);
    }

    #[test]
    fn r_hat_detects_chains_in_different_places() {
        let mut chains = autoregressions(0.5, 1000);
        assert!((split_r_hat(&chains) - 1.0).abs() < 0.01);
        chains[0].iter_mut().for_each(|x| *x += 5.0);
        assert!(split_r_hat(&chains) > 1.2);
        assert!(split_r_hat(&[vec![0.0; 3]]).is_nan());
    }
}
