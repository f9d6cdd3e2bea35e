//! Posterior distribution of the parameters, sampled with an ensemble of walkers.

mod density;
mod result;
mod saved;

use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::{Point, Simulations};
use crate::problem::fingerprint::hash_of_bytes;
use crate::problem::parameter::{Scale, inner, outer};
use base::RunContext;
use density::LogDensity;
use dfo::{EnsembleSampler, ParameterKind, RobustLoss, draw_seed, standard_normals, uniforms};
use nalgebra::{DMatrix, DVector, SymmetricEigen};
pub use result::{Posterior, PosteriorParameter};
use saved::SavedChain;
use std::path::PathBuf;

/// Maximum number of times that the walkers without a density are drawn again.
const MOST_DRAWS: usize = 20;

/// Spread of the walkers of a parameter without a standard error, as a fraction of its typical size.
const SPREAD: f64 = 0.01;

/// Initial distribution of the walkers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[non_exhaustive]
pub enum WalkerStart {
    /// The normal distribution of the fit: its optimum and covariance, within the bounds.
    #[default]
    Fit,
    /// The box of the bounds, which must be finite. Use it if there may be several modes.
    Box,
}

/// Options of [`Calibration::sample`].
#[derive(Debug, Clone, PartialEq)]
pub struct PosteriorOptions {
    /// Number of steps; default 1000. In each step, each walker moves once, and a move costs one simulation
    /// of all experiments.
    pub n_steps: usize,
    /// Number of first steps that are not a part of the result; default: a quarter of the steps.
    pub n_warmup: Option<usize>,
    /// Number of walkers; default: the larger of 16 and four per parameter. It must be at least `2 (n + 1)`
    /// for n parameters.
    pub n_walkers: Option<usize>,
    /// Initial distribution of the walkers.
    pub start: WalkerStart,
    /// Seed of the random numbers; default: drawn, and stored in the result.
    pub seed: Option<u64>,
    /// Number of parallel simulations; default: all cores. The result does not depend on it.
    pub workers: Option<usize>,
    /// File that stores the chain. If it exists, the sample continues from it.
    pub checkpoint: Option<PathBuf>,
}

impl Default for PosteriorOptions {
    fn default() -> Self {
        Self {
            n_steps: 1000,
            n_warmup: None,
            n_walkers: None,
            start: WalkerStart::default(),
            seed: None,
            workers: None,
            checkpoint: None,
        }
    }
}

impl Calibration {
    /// Samples the posterior distribution of the parameters of a fit.
    ///
    /// The density is the product of the likelihood and the priors, within the bounds. The prior of a
    /// parameter without one is uniform in the parameter or, with a logarithmic scale, in its logarithm. The
    /// noise is normal and independent:
    ///
    /// - If the noise is known ([`Weight::Sigma`](crate::Weight::Sigma),
    ///   [`NoiseRule::Stated`](crate::NoiseRule::Stated)), the likelihood is `exp(-sum r^2 / 2)`.
    /// - Otherwise the standard deviation of an output is unknown. It is integrated out with the prior `1 /
    ///   sigma`, which gives `(sum r^2)^(-N / 2)` for the N measurements of a variable (Gelman et al.,
    ///   Bayesian Data Analysis, third edition, 2013, section 3.2).
    ///
    /// The sampler is [`EnsembleSampler`]. A failed simulation has the density zero and is counted. Fixed
    /// parameters, and parameters that are not continuous, keep the values of the fit. The result does not
    /// depend on the number of workers. `progress` receives the number of completed steps on the calling
    /// thread.
    ///
    /// An interrupt returns the steps so far ([`Posterior::is_interrupted`]).
    ///
    /// # Errors
    /// Returns an error in these cases:
    ///
    /// - The fit minimised a robust loss, or a cost that is neither a sum of squares nor the likelihood.
    /// - No parameter is free, there are too few walkers, or no steps remain after the warm-up.
    /// - The walkers start in a box with an infinite bound.
    /// - Too few points have a finite density at the start.
    /// - The file belongs to another problem, or cannot be read or written.
    /// - The run is cancelled before the first step ([`CalibrationError::Cancelled`]).
    pub fn sample(
        &self,
        fit: &Fit,
        options: &PosteriorOptions,
        progress: &mut dyn FnMut(usize),
        context: &RunContext<'_>,
    ) -> Result<Posterior, CalibrationError> {
        let _held = self.hold();
        self.check_length(&fit.x)?;
        self.of_fit(fit)?.as_ref().unwrap_or(self).own_sample(fit, options, progress, context)
    }

    fn own_sample(
        &self,
        fit: &Fit,
        options: &PosteriorOptions,
        progress: &mut dyn FnMut(usize),
        context: &RunContext<'_>,
    ) -> Result<Posterior, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        let density = LogDensity::of_fit(self, fit)?;
        let is_free = |i: &usize| {
            let p = &self.parameters()[*i];
            !p.is_fixed() && p.lower() != p.upper() && p.value_kind() == ParameterKind::Continuous
        };
        let free: Vec<usize> = (0..fit.x.len()).filter(is_free).collect();
        let n = free.len();
        if n == 0 {
            return setup("there is no free continuous parameter to sample".to_owned());
        }
        let n_warmup = options.n_warmup.unwrap_or(options.n_steps / 4);
        if n_warmup >= options.n_steps {
            return setup(format!(
                "the warm-up has {n_warmup} of {} steps, so no step remains. Set a larger number of steps",
                options.n_steps
            ));
        }
        let n_walkers = options.n_walkers.unwrap_or_else(|| (4 * n).max(16));
        let least = 2 * (n + 1);
        if n_walkers < least {
            return setup(format!(
                "{n_walkers} walkers are too few for {n} parameters; the minimum is {least}"
            ));
        }
        let workers = options.workers.unwrap_or_else(base::available_cores);
        let hash = self.posterior_hash(fit, &free, n_walkers, options);
        let mut saved = SavedChain::open(options.checkpoint.as_deref(), hash)?;
        let mut run = Chain {
            calibration: self,
            density,
            x: fit.x.clone(),
            free,
            simulations: Simulations::new(self, RobustLoss::default(), workers, context)?,
            n_failed: 0,
        };
        if saved.sampler.is_none() {
            saved.sampler = Some(run.begin(fit, n_walkers, options)?);
        }
        let is_interrupted = run.advance(&mut saved, options.n_steps, progress)?;
        saved.write()?;
        let Some(sampler) = &saved.sampler else { return Err(CalibrationError::Cancelled) };
        if saved.n_steps() == 0 {
            return Err(CalibrationError::Cancelled);
        }
        let mut found = Posterior::new(fit, &run.free, sampler, &saved, n_warmup);
        (found.is_interrupted, found.stats) = (is_interrupted, run.simulations.stats);
        Ok(found)
    }

    /// Returns a hash of everything that the chain depends on, except the number of steps.
    fn posterior_hash(
        &self,
        fit: &Fit,
        free: &[usize],
        n_walkers: usize,
        options: &PosteriorOptions,
    ) -> String {
        let bounds: Vec<_> =
            self.parameters().iter().map(|p| (p.lower(), p.upper(), p.scale_kind())).collect();
        let words = format!(
            "{} {:?} {bounds:?} {free:?} {n_walkers} {:?} {:?} {}",
            self.problem_hash(),
            fit.x,
            options.start,
            options.seed,
            fit.objective
        );
        hash_of_bytes(words.as_bytes())
    }
}

/// A chain under way. Points are in the coordinates of the search, and contain only the free parameters.
struct Chain<'a> {
    calibration: &'a Calibration,
    density: LogDensity,
    /// Values of all parameters; those of the free ones are replaced.
    x: Vec<f64>,
    free: Vec<usize>,
    simulations: Simulations<'a>,
    n_failed: usize,
}

impl Chain<'_> {
    /// Returns the log densities of points. A failed simulation has the density zero.
    fn log_densities(&mut self, points: &[&[f64]]) -> Result<Vec<f64>, CalibrationError> {
        let parameters = self.calibration.parameters();
        let whole: Vec<Point> = (points.iter())
            .map(|point| {
                let mut x = self.x.clone();
                self.free.iter().zip(*point).for_each(|(i, u)| x[*i] = outer(&parameters[*i], *u));
                Point::new(x)
            })
            .collect();
        let answers = self.simulations.residuals(&whole)?;
        let mut found = Vec::with_capacity(points.len());
        for (answer, point) in answers.iter().zip(&whole) {
            found.push(match answer {
                Ok(residuals) => self.density.at(parameters, &point.x, residuals),
                Err(_) => {
                    self.n_failed += 1;
                    f64::NEG_INFINITY
                }
            });
        }
        Ok(found)
    }

    /// Draws the walkers and evaluates them. Walkers without a finite density are drawn again.
    fn begin(
        &mut self,
        fit: &Fit,
        n_walkers: usize,
        options: &PosteriorOptions,
    ) -> Result<EnsembleSampler, CalibrationError> {
        let seed = options.seed.unwrap_or_else(draw_seed);
        let parameters = self.calibration.parameters();
        let bounds: (Vec<f64>, Vec<f64>) = self
            .free
            .iter()
            .map(|i| &parameters[*i])
            .map(|p| (inner(p, p.lower()), inner(p, p.upper())))
            .unzip();
        let (lower, upper) = &bounds;
        if options.start == WalkerStart::Box
            && let Some(k) = (0..lower.len()).find(|&k| !(upper[k] - lower[k]).is_finite())
        {
            let name = parameters[self.free[k]].name().to_owned();
            let message =
                "it has no finite bounds, so walkers cannot start in the whole box. Set both bounds"
                    .to_owned();
            return Err(CalibrationError::Parameter { name, message });
        }
        let center = DVector::from_iterator(
            self.free.len(),
            self.free.iter().map(|i| inner(&parameters[*i], fit.x[*i])),
        );
        let root = self.root_of_covariance(fit);
        let draw = |index: usize| -> Vec<f64> {
            let n = lower.len();
            match options.start {
                WalkerStart::Box => {
                    let of_unit = uniforms(seed, index, n);
                    (0..n)
                        .map(|k| (lower[k] + (upper[k] - lower[k]) * of_unit[k]).clamp(lower[k], upper[k]))
                        .collect()
                }
                WalkerStart::Fit => {
                    let deviates = DVector::from_vec(standard_normals(seed, index, n));
                    let point = &center + &root * deviates;
                    // Points beyond a bound are mirrored at it, so that walkers do not start at equal values.
                    (0..n).map(|k| mirrored(point[k], lower[k], upper[k])).collect()
                }
            }
        };
        let (mut walkers, mut known): (Vec<Vec<f64>>, Vec<f64>) = (Vec::new(), Vec::new());
        for round in 0..MOST_DRAWS {
            let missing = n_walkers - walkers.len();
            if missing == 0 {
                break;
            }
            let points: Vec<Vec<f64>> = (0..missing).map(|k| draw(round * n_walkers + k)).collect();
            let answers = self.log_densities(&points.iter().map(Vec::as_slice).collect::<Vec<_>>())?;
            for (point, log_density) in points.into_iter().zip(answers).filter(|(_, value)| value.is_finite())
            {
                walkers.push(point);
                known.push(log_density);
            }
        }
        if walkers.len() < n_walkers {
            return Err(CalibrationError::Setup(format!(
                "only {} of {} points at the start could be simulated. Narrow the bounds, or start the walkers at the fit",
                walkers.len(),
                MOST_DRAWS * n_walkers
            )));
        }
        Ok(EnsembleSampler::new(&walkers, &known, bounds, Some(seed))?)
    }

    /// Returns a square root of the covariance of the fit, in the coordinates of the search. Parameters
    /// without a finite standard error are independent and have a small fraction of their size.
    fn root_of_covariance(&self, fit: &Fit) -> DMatrix<f64> {
        let (n_all, parameters) = (fit.x.len(), self.calibration.parameters());
        let uncertainty = fit.uncertainty.as_ref();
        let sd = |i: usize| -> f64 {
            let p = &parameters[i];
            let (x, size) = (fit.x[i], self.calibration.size_of(p, fit.x[i]));
            let found = uncertainty.map_or(f64::NAN, |u| u.standard_errors[i]);
            let found = if found.is_finite() && found > 0.0 { found } else { SPREAD * size };
            // The derivative of the logarithm.
            if p.scale_kind() == Scale::Log { found / x } else { found }
        };
        let correlation = |i: usize, k: usize| match uncertainty.map(|u| u.correlation[i * n_all + k]) {
            _ if i == k => 1.0,
            Some(found) if found.is_finite() => found,
            _ => 0.0,
        };
        let of = |a: usize, b: usize| {
            let (i, k) = (self.free[a], self.free[b]);
            correlation(i, k)
        };
        let SymmetricEigen { eigenvectors, eigenvalues } =
            SymmetricEigen::new(DMatrix::from_fn(self.free.len(), self.free.len(), of));
        let roots = eigenvalues.map(|value: f64| value.max(0.0).sqrt());
        let mut root = eigenvectors * DMatrix::from_diagonal(&roots);
        for (a, mut row) in root.row_iter_mut().enumerate() {
            row *= sd(self.free[a]);
        }
        root
    }

    /// Moves the walkers until the chain has this number of steps. Returns true if it was interrupted.
    fn advance(
        &mut self,
        saved: &mut SavedChain,
        n_steps: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<bool, CalibrationError> {
        let Some(mut sampler) = saved.sampler.take() else { return Ok(false) };
        let mut is_interrupted = false;
        while sampler.n_steps() < n_steps {
            let points: Vec<Vec<f64>> = sampler.ask().into_iter().map(<[f64]>::to_vec).collect();
            let answers = match self.log_densities(&points.iter().map(Vec::as_slice).collect::<Vec<_>>()) {
                Ok(answers) => answers,
                Err(CalibrationError::Cancelled) => {
                    is_interrupted = true;
                    break;
                }
                Err(e) => return Err(e),
            };
            sampler.tell(&answers)?;
            saved.n_simulations += answers.len();
            if sampler.is_at_step() {
                self.record(&sampler, saved);
                progress(sampler.n_steps());
                saved.write_at_times(&sampler)?;
            }
        }
        saved.n_failed += self.n_failed;
        saved.sampler = Some(sampler);
        Ok(is_interrupted)
    }

    /// Appends the walkers to the chain, in the user's units.
    fn record(&self, sampler: &EnsembleSampler, saved: &mut SavedChain) {
        let parameters = self.calibration.parameters();
        for walker in sampler.walkers() {
            saved.draws.extend(self.free.iter().zip(walker).map(|(i, u)| outer(&parameters[*i], *u)));
        }
        saved.log_densities.extend_from_slice(sampler.log_densities());
    }
}

/// Mirrors a value at the bounds. A value that is still outside moves to the nearest bound.
fn mirrored(value: f64, lower: f64, upper: f64) -> f64 {
    let inside = if value < lower { 2.0 * lower - value } else { value };
    let inside = if inside > upper { 2.0 * upper - inside } else { inside };
    inside.clamp(lower, upper)
}
