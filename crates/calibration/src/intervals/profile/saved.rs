//! File of a profile likelihood, with the completed sides and the identity of the problem.

use super::result::{ProfileEnd, ProfilePoint};
use crate::error::CalibrationError;
use crate::loaded::saved_file;
use crate::uncertainty::inactive_parameters::BoundSide;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Format name in the file.
const FORMAT: &str = "fmufit profile 1";

/// One side of a profile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Side {
    pub(super) parameter: usize,
    pub(super) side: BoundSide,
    /// Points from the optimum outwards, without the optimum.
    pub(super) points: Vec<ProfilePoint>,
    pub(super) end: ProfileEnd,
    pub(super) n_simulations: usize,
}

impl Side {
    /// Creates a side without points.
    pub(super) fn new(parameter: usize, side: BoundSide) -> Self {
        Self { parameter, side, points: Vec::new(), end: ProfileEnd::Interrupted, n_simulations: 0 }
    }
}

/// Completed sides.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct SavedSides {
    format: String,
    /// Hash of everything that the sides depend on.
    problem: String,
    pub(super) sides: Vec<Side>,
    #[serde(skip)]
    path: Option<PathBuf>,
}

impl SavedSides {
    /// Reads the sides from the file, if it exists. Writes the file immediately so that an invalid path is
    /// detected before the computation.
    pub(super) fn open(path: Option<&Path>, problem: String, n: usize) -> Result<Self, CalibrationError> {
        let mut saved =
            Self { format: FORMAT.to_owned(), problem, sides: Vec::new(), path: path.map(Path::to_owned) };
        let Some(path) = path else { return Ok(saved) };
        let is_sound = |side: &Side| side.parameter < n && side.points.iter().all(|point| point.x.len() == n);
        let unreadable = "is not a file of profiles of this version";
        let found = saved_file::read(path, unreadable, |found: &Self| match found {
            _ if found.format != FORMAT => Some(unreadable),
            _ if found.problem != saved.problem => {
                Some("contains profiles of another fit, problem, level or number of points per side")
            }
            _ => (!found.sides.iter().all(is_sound)).then_some("is damaged"),
        })?;
        saved.sides = found.map(|found| found.sides).unwrap_or_default();
        saved.write()?;
        Ok(saved)
    }

    pub(super) fn of(&self, parameter: usize, side: BoundSide) -> Option<&Side> {
        self.sides.iter().find(|saved_side| (saved_side.parameter, saved_side.side) == (parameter, side))
    }

    /// Adds a completed side. A failure to write the file only causes a warning, so that the other results
    /// are not lost.
    pub(super) fn add(&mut self, side: Side) {
        self.sides.push(side);
        if let Err(error) = self.write() {
            log::warn!("the profile was not saved: {error}");
        }
    }

    fn write(&self) -> Result<(), CalibrationError> {
        self.path.as_deref().map_or(Ok(()), |path| saved_file::write(path, self))
    }
}
