//! File of a chain, with the identity of its problem.

use crate::error::CalibrationError;
use crate::loaded::saved_file::{self, LastWrite};
use dfo::EnsembleSampler;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Format name in the file.
const FORMAT: &str = "fmufit posterior 1";

/// Draws of all steps, in the user's units: step by step, walker by walker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SavedChain {
    format: String,
    /// Hash of everything that the chain depends on.
    problem: String,
    pub(super) sampler: Option<EnsembleSampler>,
    pub(super) draws: Vec<f64>,
    pub(super) log_densities: Vec<f64>,
    pub(super) n_simulations: usize,
    pub(super) n_failed: usize,
    #[serde(skip)]
    file: Option<PathBuf>,
    #[serde(skip)]
    written: LastWrite,
}

impl SavedChain {
    /// Reads the chain from the file, if it exists. Writes the file immediately so that an invalid path is
    /// detected before the computation.
    pub(super) fn open(path: Option<&Path>, problem: String) -> Result<Self, CalibrationError> {
        let mut chain = Self {
            format: FORMAT.to_owned(),
            problem,
            sampler: None,
            draws: Vec::new(),
            log_densities: Vec::new(),
            n_simulations: 0,
            n_failed: 0,
            file: path.map(Path::to_owned),
            written: LastWrite::default(),
        };
        let Some(path) = path else { return Ok(chain) };
        let unreadable = "is not a file of a sample of this version";
        let found = saved_file::read(path, unreadable, |found: &Self| match found {
            _ if found.format != FORMAT => Some(unreadable),
            _ if found.problem != chain.problem => {
                Some("contains a sample of another fit or problem, or with other walkers or another seed")
            }
            _ => (!found.is_sound()).then_some("is damaged"),
        })?;
        if let Some(found) = found {
            chain = Self { file: chain.file, ..found };
        }
        saved_file::write(path, &chain)?;
        Ok(chain)
    }

    fn is_sound(&self) -> bool {
        let Some(sampler) = &self.sampler else {
            return self.draws.is_empty() && self.log_densities.is_empty();
        };
        let n_walkers = sampler.walkers().len();
        sampler.is_sound()
            && self.log_densities.len() == sampler.n_steps() * n_walkers
            && self.draws.len() == self.log_densities.len() * sampler.walkers()[0].len()
    }

    /// Returns the number of steps in the chain.
    pub(super) fn n_steps(&self, n_walkers: usize) -> usize {
        self.log_densities.len() / n_walkers
    }

    /// Writes the file if the last write was long enough ago.
    pub(super) fn write_at_times(&mut self, sampler: &EnsembleSampler) {
        if self.written.is_due() {
            self.write(sampler);
        }
    }

    /// Writes the file, if there is one. A failure only causes a warning, so that the chain is not lost.
    pub(super) fn write(&mut self, sampler: &EnsembleSampler) {
        let Some(path) = self.file.clone() else { return };
        self.sampler = Some(sampler.clone());
        let mut written = self.written;
        written.write(&path, self, "the sample");
        self.written = written;
    }
}
