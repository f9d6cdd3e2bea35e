//! Sampling of probability densities by an ensemble of walkers, and diagnostics of the sample.

mod diagnostics;
mod ensemble;

pub use diagnostics::{autocorrelation_time, split_r_hat};
pub use ensemble::{EnsembleSampler, standard_normals, uniforms};
