//! Differential evolution Markov chain Monte Carlo with two half ensembles.

use crate::error::Error;
use crate::method_interface::rng::{Purpose, Stream, draw_seed};
use serde::{Deserialize, Serialize};

/// Factor of a difference of two walkers, relative to `2.38 / sqrt(2 n)`: uniform in this range.
const FACTORS: (f64, f64) = (0.5, 1.1);

/// Probability of a factor of exactly 1, which moves a walker from one mode to another (ter Braak 2006).
const JUMPS: f64 = 0.1;

/// Samples a probability density with an ensemble of walkers (ask/tell).
///
/// In each step, the walkers are divided at random into two halves. The walkers of one half move by `gamma
/// (x_a - x_b)`, where `a` and `b` are two walkers of the other half. A move is accepted with the probability
/// `min(1, p(new) / p(old))`. Then the other half moves. The points of one half are independent of each
/// other, so they can be evaluated in parallel.
///
/// The move follows ter Braak (Statistics and Computing 16, 2006). The two halves come from
/// Foreman-Mackey, Hogg, Lang and Goodman (PASP 125, 2013). Affine maps of the parameters do not change the
/// efficiency. Gamma is `2.38 / sqrt(2 n)`, times a random factor between 0.5 and 1.1; in one move of ten it
/// is 1. On normal densities with 2 to 20 parameters, a curved and a bimodal density, this needs 1.7 to 170
/// times fewer evaluations per effective draw than the stretch move (`benches/posterior.md`).
///
/// ```
/// // Standard normal density in two dimensions.
/// let density = |x: &[f64]| -0.5 * x.iter().map(|v| v * v).sum::<f64>();
/// let walkers: Vec<Vec<f64>> = (0..8).map(|k| vec![f64::from(k % 3) - 1.0, f64::from(k) / 8.0]).collect();
/// let known: Vec<f64> = walkers.iter().map(|x| density(x)).collect();
/// let bounds = (vec![f64::NEG_INFINITY; 2], vec![f64::INFINITY; 2]);
/// let mut sampler = dfo::EnsembleSampler::new(&walkers, &known, bounds, Some(1))?;
/// for _ in 0..2 * 500 {
///     let answers: Vec<f64> = sampler.ask().iter().map(|x| density(x)).collect();
///     sampler.tell(&answers)?;
/// }
/// assert_eq!(sampler.n_steps(), 500);
/// # Ok::<(), dfo::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EnsembleSampler {
    seed: u64,
    lower: Vec<f64>,
    upper: Vec<f64>,
    walkers: Vec<Vec<f64>>,
    log_densities: Vec<f64>,
    /// Number of completed moves of a half; two are one step.
    n_moves: u64,
    n_accepted: u64,
    /// Walkers that wait for an answer, and their proposed points.
    proposals: Vec<(usize, Vec<f64>)>,
}

impl EnsembleSampler {
    /// Creates a sampler from walkers with known log densities. `bounds`: lower and upper bounds; the density
    /// outside is zero. Without a seed, it draws one; see [`seed`](Self::seed).
    ///
    /// The walkers should be spread over the region of interest, in all directions. At least `2 (n + 1)`
    /// walkers are required for `n` parameters.
    ///
    /// # Errors
    /// Returns an error if there are too few walkers, if lengths differ, or if a walker has no finite log
    /// density.
    pub fn new(
        walkers: &[Vec<f64>],
        log_densities: &[f64],
        bounds: (Vec<f64>, Vec<f64>),
        seed: Option<u64>,
    ) -> Result<Self, Error> {
        let (lower, upper) = bounds;
        let n = lower.len();
        let least = 2 * (n + 1);
        if walkers.len() < least {
            let range = "at least 2 (n + 1) for n parameters";
            return Err(Error::Option { name: "walkers", value: walkers.len() as f64, range });
        }
        let sampler = Self {
            seed: seed.unwrap_or_else(draw_seed),
            lower,
            upper,
            walkers: walkers.to_vec(),
            log_densities: log_densities.to_vec(),
            n_moves: 0,
            n_accepted: 0,
            proposals: Vec::new(),
        };
        match sampler.is_sound() {
            true => Ok(sampler),
            false => Err(Error::State {
                message: "the walkers differ in length, or one has no finite log density".to_owned(),
            }),
        }
    }

    /// True if the state is consistent. A state read from a file may be inconsistent.
    pub fn is_sound(&self) -> bool {
        let (n, len) = (self.lower.len(), self.walkers.len());
        len >= 2 * (n + 1)
            && self.upper.len() == n
            && self.log_densities.len() == len
            && self.log_densities.iter().all(|value| value.is_finite())
            && self.walkers.iter().all(|x| x.len() == n && x.iter().all(|value| value.is_finite()))
            && self.proposals.iter().all(|(walker, x)| *walker < len && x.len() == n)
    }

    /// Returns the points whose log densities [`tell`](Self::tell) expects next. The list is empty if all
    /// proposed points are outside the bounds.
    pub fn ask(&mut self) -> Vec<&[f64]> {
        let (len, n) = (self.walkers.len(), self.lower.len());
        let step = self.n_moves / 2;
        let mut order: Vec<usize> = (0..len).collect();
        let mut stream = Stream::new(self.seed, Purpose::Generation, step, 0);
        stream.shuffle(&mut order);
        let (first, second) = order.split_at(len / 2);
        let (moving, others) = if self.n_moves.is_multiple_of(2) { (first, second) } else { (second, first) };
        let usual = 2.38 / (2.0 * n as f64).sqrt();
        self.proposals.clear();
        for &walker in moving {
            let mut stream = Stream::new(self.seed, Purpose::Individual, self.n_moves, walker);
            let a = stream.below(others.len());
            let b = (a + 1 + stream.below(others.len() - 1)) % others.len();
            let factor = usual * stream.between(FACTORS.0, FACTORS.1);
            let factor = if stream.chance(JUMPS) { 1.0 } else { factor };
            let (a, b) = (&self.walkers[others[a]], &self.walkers[others[b]]);
            let x = &self.walkers[walker];
            let point: Vec<f64> = (0..n).map(|i| x[i] + factor * (a[i] - b[i])).collect();
            if (0..n).all(|i| self.lower[i] <= point[i] && point[i] <= self.upper[i]) {
                self.proposals.push((walker, point));
            }
        }
        self.proposals.iter().map(|(_, point)| point.as_slice()).collect()
    }

    /// Accepts or rejects the points of the last [`ask`](Self::ask). A point whose log density is NaN or
    /// negative infinity is rejected.
    ///
    /// # Errors
    /// Returns an error if the number of answers is not the number of points.
    pub fn tell(&mut self, log_densities: &[f64]) -> Result<(), Error> {
        let requested = self.proposals.len();
        if log_densities.len() != requested {
            return Err(Error::TooManyOutcomes { requested, received: log_densities.len() });
        }
        for ((walker, point), log_density) in
            std::mem::take(&mut self.proposals).into_iter().zip(log_densities)
        {
            let mut stream = Stream::new(self.seed, Purpose::Restart, self.n_moves, walker);
            let rise = log_density - self.log_densities[walker];
            if log_density.is_finite() && stream.uniform().ln() < rise {
                self.walkers[walker] = point;
                self.log_densities[walker] = *log_density;
                self.n_accepted += 1;
            }
        }
        self.n_moves += 1;
        Ok(())
    }

    /// Returns the current points of the walkers.
    pub fn walkers(&self) -> &[Vec<f64>] {
        &self.walkers
    }

    /// Returns the log densities of the current points.
    pub fn log_densities(&self) -> &[f64] {
        &self.log_densities
    }

    /// Returns the number of completed steps. In a step, each walker moves once.
    pub fn n_steps(&self) -> usize {
        (self.n_moves / 2) as usize
    }

    /// True between two steps; false if one half of the walkers has moved and the other has not.
    pub fn is_at_step(&self) -> bool {
        self.n_moves.is_multiple_of(2)
    }

    /// Returns the fraction of accepted moves; NaN before the first move.
    pub fn acceptance(&self) -> f64 {
        self.n_accepted as f64 / (0.5 * self.n_moves as f64 * self.walkers.len() as f64)
    }

    /// Returns the seed of the random numbers.
    pub fn seed(&self) -> u64 {
        self.seed
    }
}

/// Returns `n` independent standard normal numbers, a function of the seed and the index.
pub fn standard_normals(seed: u64, index: usize, n: usize) -> Vec<f64> {
    let mut stream = Stream::new(seed, Purpose::Sampling, 0, index);
    (0..n).map(|_| stream.normal(0.0, 1.0)).collect()
}

/// Returns `n` independent uniform numbers in [0, 1), a function of the seed and the index.
pub fn uniforms(seed: u64, index: usize, n: usize) -> Vec<f64> {
    let mut stream = Stream::new(seed, Purpose::Sampling, 0, index);
    (0..n).map(|_| stream.uniform()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{autocorrelation_time, split_r_hat};

    const OPEN: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

    /// Returns the draws of a sampler (step, walker, coordinate) after a fifth of the steps.
    fn draws(
        density: impl Fn(&[f64]) -> f64,
        n: usize,
        bounds: (f64, f64),
        n_steps: usize,
    ) -> Vec<Vec<Vec<f64>>> {
        let n_walkers = (4 * n).max(16);
        let mut stream = Stream::new(7, Purpose::Sampling, 0, 0);
        let walkers: Vec<Vec<f64>> = (0..n_walkers)
            .map(|_| (0..n).map(|_| stream.between(bounds.0.max(-3.0), bounds.1.min(3.0))).collect())
            .collect();
        let densities: Vec<f64> = walkers.iter().map(|x| density(x)).collect();
        let bounds = (vec![bounds.0; n], vec![bounds.1; n]);
        let mut sampler = EnsembleSampler::new(&walkers, &densities, bounds, Some(11)).unwrap();
        let mut all = Vec::new();
        while sampler.n_steps() < n_steps {
            let answers: Vec<f64> = sampler.ask().iter().map(|x| density(x)).collect();
            sampler.tell(&answers).unwrap();
            if sampler.is_at_step() && sampler.n_steps() > n_steps / 5 {
                all.push(sampler.walkers().to_vec());
            }
        }
        all
    }

    fn chains(draws: &[Vec<Vec<f64>>], of: impl Fn(&[f64]) -> f64) -> Vec<Vec<f64>> {
        (0..draws[0].len()).map(|walker| draws.iter().map(|step| of(&step[walker])).collect()).collect()
    }

    /// Checks the mean of a function of the draws against its expectation, within four Monte Carlo errors.
    fn assert_mean(draws: &[Vec<Vec<f64>>], expected: f64, of: impl Fn(&[f64]) -> f64) {
        let chains = chains(draws, of);
        let all: Vec<f64> = chains.iter().flatten().copied().collect();
        let mean = all.iter().sum::<f64>() / all.len() as f64;
        let variance = all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len() as f64;
        let effective = all.len() as f64 / autocorrelation_time(&chains);
        let error = (variance / effective).sqrt();
        assert!((mean - expected).abs() < 4.0 * error, "mean {mean}, expected {expected} +- {error}");
        assert!(split_r_hat(&chains) < 1.05, "{}", split_r_hat(&chains));
    }

    #[test]
    fn correlated_normal_has_its_moments() {
        // Correlation 0.9, standard deviations 1 and 100.
        let density = |x: &[f64]| {
            let (a, b) = (x[0], x[1] / 100.0);
            -0.5 * (a * a - 1.8 * a * b + b * b) / (1.0 - 0.81)
        };
        let draws = draws(density, 2, OPEN, 4000);
        assert_mean(&draws, 0.0, |x| x[0]);
        assert_mean(&draws, 1.0, |x| x[0] * x[0]);
        assert_mean(&draws, 1e4, |x| x[1] * x[1]);
        assert_mean(&draws, 90.0, |x| x[0] * x[1]);
    }

    #[test]
    fn curved_density_has_its_moments() {
        // x ~ N(0, 2), y = x^2 / 2 + N(0, 0.5): E y = 2, E x y = 0.
        let density = |x: &[f64]| -0.5 * (x[0] * x[0] / 4.0 + (x[1] - 0.5 * x[0] * x[0]).powi(2) / 0.25);
        let draws = draws(density, 2, OPEN, 15_000);
        assert_mean(&draws, 0.0, |x| x[0]);
        assert_mean(&draws, 4.0, |x| x[0] * x[0]);
        assert_mean(&draws, 2.0, |x| x[1]);
    }

    #[test]
    fn two_modes_are_visited_in_proportion() {
        // 0.75 N(3, 1) + 0.25 N(-3, 1) in each of two coordinates together.
        let density = |x: &[f64]| {
            let at = |center: f64, part: f64| {
                part.ln() - 0.5 * x.iter().map(|v| (v - center).powi(2)).sum::<f64>()
            };
            let (a, b) = (at(3.0, 0.75), at(-3.0, 0.25));
            a.max(b) + (-(a - b).abs()).exp().ln_1p()
        };
        let draws = draws(density, 2, OPEN, 6000);
        assert_mean(&draws, 0.75, |x| f64::from(u8::from(x[0] + x[1] > 0.0)));
        assert_mean(&draws, 1.5, |x| x[0]);
    }

    #[test]
    fn bound_cuts_the_density() {
        // Half normal: mean sqrt(2 / pi), second moment 1.
        let density = |x: &[f64]| -0.5 * x[0] * x[0];
        let draws = draws(density, 1, (0.0, f64::INFINITY), 4000);
        assert!(draws.iter().flatten().all(|x| x[0] >= 0.0));
        assert_mean(&draws, (2.0 / std::f64::consts::PI).sqrt(), |x| x[0]);
        assert_mean(&draws, 1.0, |x| x[0] * x[0]);
    }

    #[test]
    fn restored_state_continues_with_the_same_bits() {
        let density = |x: &[f64]| -0.5 * x[0] * x[0];
        let walkers: Vec<Vec<f64>> = (0..6).map(|k| vec![f64::from(k)]).collect();
        let densities: Vec<f64> = walkers.iter().map(|x| density(x)).collect();
        let bounds = (vec![-10.0], vec![10.0]);
        let mut sampler = EnsembleSampler::new(&walkers, &densities, bounds, Some(3)).unwrap();
        let advance = |sampler: &mut EnsembleSampler| {
            let answers: Vec<f64> = sampler.ask().iter().map(|x| density(x)).collect();
            sampler.tell(&answers).unwrap();
        };
        (0..7).for_each(|_| advance(&mut sampler));
        let text = serde_json::to_string(&sampler).unwrap();
        let mut restored: EnsembleSampler = serde_json::from_str(&text).unwrap();
        (0..20).for_each(|_| [&mut sampler, &mut restored].into_iter().for_each(advance));
        assert_eq!(sampler, restored);
    }

    #[test]
    fn bad_walkers_and_answers_are_rejected() {
        let bounds = || (vec![0.0], vec![1.0]);
        let new = |walkers: &[Vec<f64>], densities: &[f64]| {
            EnsembleSampler::new(walkers, densities, bounds(), Some(1))
        };
        let message = new(&[vec![0.5]], &[0.0]).unwrap_err().to_string();
        assert!(message.contains("walkers"), "{message}");
        let four = vec![vec![0.5]; 4];
        assert!(new(&four, &[0.0, 0.0, 0.0, f64::NEG_INFINITY]).is_err());
        let mut sampler = new(&four, &[0.0; 4]).unwrap();
        let n = sampler.ask().len();
        assert!(sampler.tell(&vec![0.0; n + 1]).is_err());
    }
}
