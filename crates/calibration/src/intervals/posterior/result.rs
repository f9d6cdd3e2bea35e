//! A sample of the posterior distribution, and its display.

use super::saved::SavedChain;
use crate::findings::display_text::{digits, visible_line};
use crate::fit::one_stage::Fit;
use crate::uncertainty::robust::quantile;
use base::Number;
use dfo::{EnsembleSampler, autocorrelation_time, split_r_hat};
use ode::Stats;
use std::fmt;

/// Largest split R-hat of a converged sample (Gelman et al., Bayesian Data Analysis, 2013: 1.1; Vehtari et
/// al., Bayesian Analysis 16, 2021, recommend less).
const LARGEST_R_HAT: f64 = 1.05;

/// Smallest number of effective draws of a converged sample; Vehtari et al. (2021) recommend 400 for
/// quantiles.
const FEWEST_EFFECTIVE: f64 = 400.0;

/// Posterior distribution of one parameter.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PosteriorParameter {
    /// Index of the parameter, counted from 0.
    pub parameter: usize,
    /// Name of the parameter.
    pub name: String,
    /// Mean of the draws.
    pub mean: f64,
    /// Standard deviation of the draws.
    pub sd: f64,
    /// Median of the draws.
    pub median: f64,
    /// Split R-hat: close to 1 if the walkers agree.
    pub r_hat: f64,
    /// Number of effective draws: the number of draws divided by their autocorrelation time.
    pub effective_draws: f64,
}

/// Sample of the posterior distribution; see [`Calibration::sample`](crate::Calibration::sample). `Display`
/// prints a table.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Posterior {
    /// Sampled parameters, in the order of the fit.
    pub parameters: Vec<PosteriorParameter>,
    /// Draws in the user's units: step by step after the warm-up, walker by walker, parameter by parameter.
    pub draws: Vec<f64>,
    /// Log density of each draw, up to a constant: step by step, walker by walker.
    pub log_densities: Vec<f64>,
    /// Number of walkers.
    pub n_walkers: usize,
    /// Number of steps in the sample.
    pub n_steps: usize,
    /// Number of steps before the sample, which are not a part of it.
    pub n_warmup: usize,
    /// Fraction of accepted moves.
    pub acceptance: f64,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Number of simulated points, including the points of a resumed file.
    pub n_simulations: usize,
    /// Number of failed simulations among them; their density is zero.
    pub n_failed: usize,
    /// True if the computation was interrupted before the last step.
    pub is_interrupted: bool,
    /// Statistics of the simulations since the file was resumed.
    pub stats: Stats,
}

impl Posterior {
    pub(super) fn new(
        fit: &Fit,
        free: &[usize],
        sampler: &EnsembleSampler,
        saved: &SavedChain,
        n_warmup: usize,
    ) -> Self {
        let (n, n_walkers) = (free.len(), sampler.walkers().len());
        let n_warmup = n_warmup.min(saved.n_steps(n_walkers) - 1);
        let draws = saved.draws[n_warmup * n_walkers * n..].to_vec();
        let log_densities = saved.log_densities[n_warmup * n_walkers..].to_vec();
        let n_steps = log_densities.len() / n_walkers;
        let parameter = |(k, i): (usize, &usize)| {
            let chain = |walker: usize| -> Vec<f64> {
                (0..n_steps).map(|step| draws[(step * n_walkers + walker) * n + k]).collect()
            };
            let chains: Vec<Vec<f64>> = (0..n_walkers).map(chain).collect();
            let count = (n_steps * n_walkers) as f64;
            let mean = chains.iter().flatten().sum::<f64>() / count;
            let squares = chains.iter().flatten().map(|x| (x - mean) * (x - mean)).sum::<f64>();
            PosteriorParameter {
                parameter: *i,
                name: fit.names[*i].clone(),
                mean,
                sd: (squares / (count - 1.0)).sqrt(),
                median: quantile(&mut chains.concat(), 0.5),
                r_hat: split_r_hat(&chains),
                effective_draws: count / autocorrelation_time(&chains),
            }
        };
        Self {
            parameters: free.iter().enumerate().map(parameter).collect(),
            draws,
            log_densities,
            n_walkers,
            n_steps,
            n_warmup,
            acceptance: sampler.acceptance(),
            seed: sampler.seed(),
            n_simulations: saved.n_simulations,
            n_failed: saved.n_failed,
            is_interrupted: false,
            stats: Stats::default(),
        }
    }

    /// Returns the interval of a sampled parameter between the quantiles `(1 - level) / 2` and `(1 + level) /
    /// 2`. `k` is its index among the sampled parameters. Returns NaN if the level is not between 0 and 1.
    pub fn interval(&self, k: usize, level: f64) -> (f64, f64) {
        let mut values: Vec<f64> =
            self.draws.iter().skip(k).step_by(self.parameters.len()).copied().collect();
        let mut at = |p: f64| quantile(&mut values, p);
        if level > 0.0 && level < 1.0 {
            (at(0.5 - 0.5 * level), at(0.5 + 0.5 * level))
        } else {
            (f64::NAN, f64::NAN)
        }
    }

    /// Returns true if every R-hat is at most 1.05 and every number of effective draws is at least 400.
    pub fn is_converged(&self) -> bool {
        self.parameters.iter().all(|p| p.r_hat <= LARGEST_R_HAT && p.effective_draws >= FEWEST_EFFECTIVE)
    }
}

impl fmt::Display for Posterior {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = |p: &PosteriorParameter| visible_line(&p.name).into_owned();
        let width = self.parameters.iter().map(|p| shown(p).chars().count()).max().unwrap_or(0).max(9);
        writeln!(
            f,
            "posterior distribution: {} steps of {} walkers after {} steps of warm-up, {} simulations, {} % of moves accepted",
            self.n_steps,
            self.n_walkers,
            self.n_warmup,
            self.n_simulations,
            Number((100.0 * self.acceptance).round())
        )?;
        write!(
            f,
            "{:<width$}  {:>11}  {:>11}  {:>11}  {:>11}  {:>6}  {:>9}",
            "parameter", "mean", "sd", "2.5 %", "97.5 %", "R-hat", "effective"
        )?;
        for (k, p) in self.parameters.iter().enumerate() {
            let (low, high) = self.interval(k, 0.95);
            let [mean, low, high] = [p.mean, low, high].map(|value| five(value).to_string());
            write!(
                f,
                "\n{:<width$}  {mean:>11}  {:>11}  {low:>11}  {high:>11}  {:>6.3}  {:>9.0}",
                shown(p),
                digits(p.sd).to_string(),
                p.r_hat,
                p.effective_draws
            )?;
        }
        if self.n_failed > 0 {
            write!(f, "\n- {} simulations failed; these points have the density zero", self.n_failed)?;
        }
        if self.is_interrupted {
            f.write_str("\n- interrupted before the last step")?;
        }
        if !self.is_converged() {
            write!(
                f,
                "\n- not converged (R-hat above {LARGEST_R_HAT}, or fewer than {FEWEST_EFFECTIVE} effective draws). Sample more steps"
            )?;
        }
        Ok(())
    }
}

/// Rounds a number to five digits.
fn five(value: f64) -> Number {
    Number(format!("{value:.4e}").parse().unwrap_or(value))
}
