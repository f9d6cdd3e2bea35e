//! File of a bootstrap, with its completed fits and the identity of the problem.

use crate::error::CalibrationError;
use crate::loaded::saved_file::{self, LastWrite};
use dfo::draw_seed;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Format name in the file.
const FORMAT: &str = "fmufit bootstrap 1";

/// Completed fits.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SavedFits {
    format: String,
    /// Hash of everything that the fits depend on, except the seed.
    problem: String,
    /// Seed of the random numbers.
    pub(super) seed: u64,
    /// Fitted values by the number of the fit; `None` if it failed.
    pub(super) fits: BTreeMap<usize, Option<Vec<f64>>>,
    /// Reasons of the failed fits.
    #[serde(default)]
    pub(super) failures: BTreeMap<usize, String>,
    #[serde(skip)]
    path: Option<PathBuf>,
    #[serde(skip)]
    written: LastWrite,
}

impl SavedFits {
    /// Reads the fits from the file, if it exists. Writes the file immediately so that an invalid path is
    /// detected before the computation. A fit has `n` values. The seed is the given one, otherwise the one of
    /// the file, otherwise a new one.
    pub(super) fn open(
        path: Option<&Path>,
        problem: String,
        n: usize,
        seed: Option<u64>,
    ) -> Result<Self, CalibrationError> {
        let mut own = Self {
            format: FORMAT.to_owned(),
            problem,
            seed: seed.unwrap_or_else(draw_seed),
            fits: BTreeMap::new(),
            failures: BTreeMap::new(),
            path: path.map(Path::to_owned),
            written: LastWrite::default(),
        };
        let Some(path) = path else { return Ok(own) };
        let is_sound =
            |x: &Option<Vec<f64>>| x.as_ref().is_none_or(|x| x.len() == n && x.iter().all(|v| v.is_finite()));
        let unreadable = "is not a file of a bootstrap of this version";
        let found = saved_file::read(path, unreadable, |found: &Self| match found {
            _ if found.format != FORMAT => Some(unreadable),
            _ if found.problem != own.problem => {
                Some("contains a bootstrap of another fit or problem, or of another kind")
            }
            _ if seed.is_some_and(|seed| seed != found.seed) => {
                Some("contains a bootstrap with another seed")
            }
            _ => (!found.fits.values().all(is_sound)).then_some("is damaged"),
        })?;
        if let Some(found) = found {
            (own.seed, own.fits, own.failures) = (found.seed, found.fits, found.failures);
        }
        saved_file::write(path, &own)?;
        Ok(own)
    }

    /// Adds a completed fit, and writes the file if the last write was long enough ago.
    pub(super) fn add(&mut self, number: usize, x: Result<Vec<f64>, String>) {
        let x = x.map_err(|reason| self.failures.insert(number, reason)).ok();
        self.fits.insert(number, x);
        if self.written.is_due() {
            self.write();
        }
    }

    /// Writes the file, if there is one.
    pub(super) fn write(&mut self) {
        if let Some(path) = self.path.clone() {
            let mut written = self.written;
            written.write(&path, self, "the bootstrap");
            self.written = written;
        }
    }
}
