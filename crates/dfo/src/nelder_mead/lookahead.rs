//! The points that the next iteration may need: four for each point that this one may accept.

use super::options::Numbers;
use super::simplex::SimplexData;
use super::trial::{Frame, Seen, Trial, TrialPoint};
use crate::scaling::{BoundsHandling, Space};
use serde::{Deserialize, Serialize};

/// Sixteen points, by what this iteration accepts and what the next tries; none for plans that do not look so far.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct LookAhead {
    points: Vec<TrialPoint>,
    /// Whether a point could be foreseen.
    placed: Vec<bool>,
    /// Where it stands in the batch last told.
    positions: Vec<Option<usize>>,
    centroid: Vec<f64>,
    accepted: Option<Trial>,
}

fn number(accepted: Trial, tried: Trial) -> usize {
    4 * accepted as usize + tried as usize
}

impl LookAhead {
    pub(super) fn new(n: usize, n_user: usize, wanted: bool) -> Self {
        let len = if wanted { 16 } else { 0 };
        Self {
            points: vec![TrialPoint::new(n, n_user); len],
            placed: vec![false; len],
            positions: vec![None; len],
            centroid: vec![0.0; n],
            accepted: None,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Point `k`, if it could be foreseen.
    pub(super) fn x(&self, k: usize) -> Option<&[f64]> {
        self.placed[k].then(|| &self.points[k].x[..])
    }

    /// Foresees the next iteration after each of this one's trial points.
    pub(super) fn place(
        &mut self,
        space: &Space,
        handling: BoundsHandling,
        numbers: &Numbers,
        simplex: &SimplexData,
        trials: &[TrialPoint; 4],
    ) {
        // An accepted reflection or expansion beats the second worst vertex, which becomes the worst; a contraction
        // is guessed to.
        let (replaced, next_worst) = (simplex.worst(), simplex.second_worst());
        for accepted in Trial::ALL {
            let new = &trials[accepted as usize].u;
            simplex.centroid_without(next_worst, Some(new), &mut self.centroid);
            for tried in Trial::ALL {
                let k = number(accepted, tried);
                let frame = Frame {
                    space,
                    handling,
                    factor: tried.factor(numbers),
                    centroid: &self.centroid,
                    worst: simplex.u(next_worst),
                    fallback: simplex.u(simplex.best()),
                };
                let is_vertex = |u: &[f64]| {
                    let stays = |slot: &usize| *slot != replaced && *slot != next_worst;
                    u == &new[..] || simplex.order().iter().filter(|s| stays(s)).any(|s| simplex.u(*s) == u)
                };
                frame.place(&mut self.points[k], is_vertex);
                self.points[k].seen = Seen::Unknown;
                self.positions[k] = None;
                self.placed[k] = self.centroid.iter().all(|c| c.is_finite());
            }
        }
        self.accepted = None;
    }

    /// An outcome came for point `k`, which stood at this position of the batch.
    pub(super) fn see(&mut self, k: usize, seen: Seen, position: usize) {
        self.points[k].seen = seen;
        self.positions[k] = Some(position);
    }

    /// A new batch is told: positions in the old one mean nothing any more.
    pub(super) fn unsee(&mut self) {
        self.points.iter_mut().for_each(|p| p.seen = Seen::Unknown);
        self.positions.fill(None);
        self.accepted = None;
    }

    /// The iteration has accepted this point.
    pub(super) fn accepted(&mut self, trial: Trial) {
        // After an iteration that was itself foreseen, nothing further is.
        self.accepted = if self.accepted.is_some() { None } else { Some(trial) };
        if self.accepted.is_none() {
            self.forget();
        }
    }

    pub(super) fn forget(&mut self) {
        self.points.iter_mut().for_each(|p| p.seen = Seen::Unknown);
        self.accepted = None;
    }

    /// What was seen of a trial point of the present iteration, if it lies where it was foreseen.
    pub(super) fn seen(&self, tried: Trial, u: &[f64]) -> Seen {
        match self.accepted.and_then(|accepted| self.points.get(number(accepted, tried))) {
            Some(point) if point.u == u => point.seen,
            _ => Seen::Unknown,
        }
    }

    /// Where it stands in the batch last told.
    pub(super) fn position(&self, tried: Trial) -> Option<usize> {
        let accepted = self.accepted?;
        self.positions.get(number(accepted, tried)).copied().flatten()
    }

    pub(super) fn is_sound(&self, space: &Space, wanted: bool) -> bool {
        let len = if wanted { 16 } else { 0 };
        (self.points.len(), self.placed.len(), self.positions.len()) == (len, len, len)
            && self.centroid.len() == space.n_free()
            && self.points.iter().all(|p| p.is_sound(space))
    }
}
