//! Options of a sample of the posterior distribution.

use std::path::PathBuf;

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

/// Options of [`Calibration::sample`](crate::Calibration::sample).
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
    /// File that stores the chain. If it exists, the sample continues from it. A file with more steps is
    /// used as it is.
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
