//! Integer parameters: a lower limit on their standard deviations, and centring of the better individuals
//! (Marty, Hansen, Auger, Semet and Heron, "LB+IC-CMA-ES: Two simple modifications of CMA-ES to handle
//! mixed-integer problems", PPSN 2024).
//!
//! An integer is the rounded coordinate. Without a limit, the deviation along it becomes so small that all
//! individuals round to one value, and no other value is tried again. The limit keeps other values in the
//! sample. The coordinate of a better individual with another value than the mean is moved to this value, so
//! that one update can move the mean there. The coordinates of the others are moved to the value of the mean
//! as far as necessary to leave the average unchanged. No move changes the rounded value.

use super::distribution::Distribution;
use super::weights::{Weights, effective};
use crate::problem::space::{IntegerCell, Space};
use crate::values::choices::ParameterKind;
use serde::{Deserialize, Serialize};

/// Lower limit of the standard deviation of an integer, from the paper: the smaller of this value and the
/// variance effective selection mass per parameter.
const LEAST_DEVIATION: f64 = 0.2;

/// Deviations of integers, and the age of the best values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Integers {
    /// Factor on the deviation of each coordinate. The factor is 1 for continuous parameters.
    stretch: Vec<f64>,
    /// Number of generations since the integers of the best point since the last restart changed.
    n_same: usize,
}

fn is_integer(space: &Space, k: usize) -> bool {
    space.kind(k) != ParameterKind::Continuous
}

/// True if any free parameter is an integer.
pub(super) fn has_integers(space: &Space) -> bool {
    (0..space.n_free()).any(|k| is_integer(space, k))
}

impl Integers {
    /// Returns `None` if all parameters are continuous.
    pub(super) fn of(space: &Space) -> Option<Self> {
        has_integers(space).then(|| Self { stretch: vec![1.0; space.n_free()], n_same: 0 })
    }

    pub(super) fn stretch(&self, k: usize) -> f64 {
        self.stretch[k]
    }

    /// Records that a generation improved the best point from `before` to `after`, or that it did not.
    pub(super) fn record_best(&mut self, improved: Option<(&[f64], &[f64])>, space: &Space) {
        let centre = |k: usize, u: f64| space.integer_cell(k, u).centre;
        let moved = improved.is_some_and(|(before, after)| {
            (0..space.n_free()).any(|k| is_integer(space, k) && centre(k, before[k]) != centre(k, after[k]))
        });
        self.n_same = if moved { 0 } else { self.n_same + 1 };
    }

    /// True if other integers than the best have been tried in fewer than `most` generations.
    pub(super) fn is_young(&self, most: usize) -> bool {
        self.n_same < most
    }

    /// Centres the integers of the better individuals. `ranked` contains the slots of individuals with a
    /// cost, best first. `steps` contains their steps, concatenated by slot.
    pub(super) fn centre(
        &self,
        distribution: &Distribution,
        space: &Space,
        weights: &Weights,
        ranked: &[usize],
        steps: &mut [f64],
    ) {
        let n = space.n_free();
        let parents = &ranked[..weights.n_parents.min(ranked.len())];
        for k in (0..n).filter(|k| is_integer(space, *k)) {
            let mean = distribution.mean[k];
            let unit = distribution.sigma * space.size(k) * self.stretch[k];
            let home = space.integer_cell(k, mean).centre;
            let (lower, upper) = space.working_bounds(k);
            let coordinate = |step: f64| (mean + unit * step).clamp(lower, upper);
            let (mut bias, mut up, mut down) = (0.0, 0.0, 0.0);
            for &slot in parents {
                let step = &mut steps[slot * n + k];
                let v = coordinate(*step);
                let centre = space.integer_cell(k, v).centre;
                if centre == home {
                    up += (home - v).max(0.0);
                    down += (home - v).min(0.0);
                    *step = (v - mean) / unit;
                } else {
                    bias += centre - v;
                    *step = (centre - mean) / unit;
                }
            }
            let possible = if bias > 0.0 { down } else { up };
            if bias * possible >= 0.0 {
                continue;
            }
            let share = (-bias / possible).min(1.0);
            for &slot in parents {
                let step = &mut steps[slot * n + k];
                let v = coordinate(*step);
                if space.integer_cell(k, v).centre == home && (home - v) * bias < 0.0 {
                    *step = (v + share * (home - v) - mean) / unit;
                }
            }
        }
    }

    /// Raises the deviations of integers to their lower limit.
    pub(super) fn widen(&mut self, distribution: &Distribution, space: &Space, weights: &Weights) {
        let n = space.n_free();
        let selected = effective(&weights.of_rank[..weights.n_parents]);
        let least = LEAST_DEVIATION.min(selected / n as f64);
        for k in (0..n).filter(|k| is_integer(space, *k)) {
            // Along a logarithmic scale, the unit is the range that rounds to the value of the mean.
            let IntegerCell { low, centre, high } = space.integer_cell(k, distribution.mean[k]);
            let unit = match (low.is_finite(), high.is_finite()) {
                (true, true) => high - low,
                (true, false) => 2.0 * (centre - low),
                (false, true) => 2.0 * (high - centre),
                (false, false) => continue,
            };
            let deviation = distribution.deviation(k) * space.size(k);
            if deviation * self.stretch[k] < least * unit && deviation > 0.0 {
                self.stretch[k] = least * unit / deviation;
            }
        }
    }

    pub(super) fn is_sound(&self, n: usize) -> bool {
        self.stretch.len() == n && self.stretch.iter().all(|s| s.is_finite() && *s > 0.0)
    }
}
