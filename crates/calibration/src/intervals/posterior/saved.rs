//! File of a chain, with the identity of its problem.

use crate::error::CalibrationError;
use dfo::EnsembleSampler;
use fmi::FmiError;
use fmi::platform::fill_atomically;
use serde::{Deserialize, Serialize};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Format name in the file.
const FORMAT: &str = "fmufit posterior 1";

/// Minimum interval between two writes.
const SHORTEST: Duration = Duration::from_millis(200);

/// The whole file is written each time. The interval is at least this multiple of the duration of a write, so
/// that writing takes at most a tenth of the time.
const SHARE: u32 = 10;

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
    /// End of the last write and its duration.
    #[serde(skip)]
    written: Option<(Instant, Duration)>,
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
            written: None,
        };
        let Some(path) = path else { return Ok(chain) };
        let refused = |why: &str| {
            let path = path.display();
            Err(CalibrationError::Setup(format!("{path} {why}. Specify another file, or remove this one")))
        };
        match base::files::read_regular(path) {
            Ok(bytes) => match serde_json::from_slice::<Self>(&bytes) {
                Ok(found) if found.format == FORMAT && found.problem == chain.problem => {
                    if !found.is_sound() {
                        return refused("is damaged");
                    }
                    chain = Self { file: chain.file, ..found };
                }
                Ok(found) if found.format == FORMAT => {
                    return refused(
                        "contains a sample of another fit or problem, or with other walkers or another seed",
                    );
                }
                _ => return refused("is not a file of a sample of this version"),
            },
            Err(source) if source.kind() == ErrorKind::NotFound => {}
            Err(source) => return Err(CalibrationError::DataFile { path: path.to_owned(), source }),
        }
        chain.write()?;
        Ok(chain)
    }

    fn is_sound(&self) -> bool {
        let Some(sampler) = &self.sampler else {
            return self.draws.is_empty() && self.log_densities.is_empty();
        };
        let n_walkers = sampler.walkers().len();
        sampler.is_sound()
            && sampler.is_at_step()
            && self.log_densities.len() == sampler.n_steps() * n_walkers
            && self.draws.len() == self.log_densities.len() * sampler.walkers()[0].len()
    }

    /// Returns the number of steps in the chain.
    pub(super) fn n_steps(&self) -> usize {
        self.sampler.as_ref().map_or(0, |sampler| self.log_densities.len() / sampler.walkers().len())
    }

    /// Writes the file if the last write was long enough ago. A failure only causes a warning, so that the
    /// chain is not lost.
    pub(super) fn write_at_times(&mut self, sampler: &EnsembleSampler) -> Result<(), CalibrationError> {
        let is_due = self.written.is_none_or(|(at, took)| at.elapsed() >= SHORTEST.max(SHARE * took));
        if self.file.is_none() || !is_due {
            return Ok(());
        }
        self.sampler = Some(sampler.clone());
        if let Err(error) = self.write() {
            log::warn!("the sample was not saved: {error}");
        }
        Ok(())
    }

    /// Writes the file, if there is one.
    pub(super) fn write(&mut self) -> Result<(), CalibrationError> {
        let Some(path) = &self.file else { return Ok(()) };
        let began = Instant::now();
        let bytes = serde_json::to_vec(self).map_err(|e| CalibrationError::Setup(e.to_string()))?;
        fill_atomically(path, |mut file, _| -> Result<(), CalibrationError> {
            Ok(file.write_all(&bytes).map_err(FmiError::io("write", path))?)
        })?;
        self.written = Some((Instant::now(), began.elapsed()));
        Ok(())
    }
}
