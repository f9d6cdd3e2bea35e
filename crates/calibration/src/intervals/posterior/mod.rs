//! Posterior distribution of the parameters, sampled with an ensemble of walkers.

mod chain;
mod density;
mod options;
mod result;
mod saved;

use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use crate::loaded::simulations_around::Simulations;
use crate::problem::fingerprint::hash_of_bytes;
use base::RunContext;
use chain::Chain;
use density::LogDensity;
use dfo::{ParameterKind, RobustLoss};
pub use options::{PosteriorOptions, WalkerStart};
pub use result::{Posterior, PosteriorParameter};
use saved::SavedChain;

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
    /// The sampler is [`dfo::EnsembleSampler`]. A failed simulation has the density zero and is counted.
    /// Fixed parameters, and parameters that are not continuous, keep the values of the fit. The result does
    /// not depend on the number of workers. `progress` receives the number of completed steps on the calling
    /// thread.
    ///
    /// An interrupt returns the steps so far ([`Posterior::is_interrupted`]).
    ///
    /// # Errors
    /// Returns an error in these cases:
    ///
    /// - There is an equality among the constraints.
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
        self.as_fitted(fit, |fitted| fitted.sample_fitted(fit, options, progress, context))
    }

    fn sample_fitted(
        &self,
        fit: &Fit,
        options: &PosteriorOptions,
        progress: &mut dyn FnMut(usize),
        context: &RunContext<'_>,
    ) -> Result<Posterior, CalibrationError> {
        let setup = |message: String| Err(CalibrationError::Setup(message));
        let density = LogDensity::of_fit(self, fit)?;
        if let Some(equality) = self.constraints().first_equality() {
            return setup(format!(
                "points that satisfy the equality '{equality}' cannot be sampled. Replace it with a derived parameter (expr)"
            ));
        }
        if let Some(constraint) = self.constraints().first_of_simulation() {
            return setup(format!(
                "points that satisfy '{constraint}' cannot be sampled, because it depends on the simulation. Use a profile"
            ));
        }
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
        let mut chain = Chain {
            calibration: self,
            density,
            x: fit.x.clone(),
            free,
            simulations: Simulations::new(self, RobustLoss::default(), workers, context)?,
            saved: SavedChain::open(options.checkpoint.as_deref(), hash)?,
        };
        let mut sampler = match chain.saved.sampler.clone() {
            Some(sampler) => sampler,
            None => chain.begin(fit, n_walkers, options)?,
        };
        let is_interrupted = chain.advance(&mut sampler, options.n_steps, progress)?;
        if sampler.n_steps() == 0 {
            return Err(CalibrationError::Cancelled);
        }
        let mut found = Posterior::new(fit, &chain.free, &sampler, &chain.saved, n_warmup);
        (found.is_interrupted, found.stats) = (is_interrupted, chain.simulations.stats);
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
