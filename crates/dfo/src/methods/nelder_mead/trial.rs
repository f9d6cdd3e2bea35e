//! The four trial points of an iteration: where they lie, and what is known about them.

use super::options::CoefficientValues;
use crate::method_interface::interface::Operation;
use crate::problem::space::Space;
use crate::values::choices::BoundsHandling;
use serde::{Deserialize, Serialize};

/// The four trial points of an iteration; the number is the position in tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Trial {
    Reflection = 0,
    Expansion = 1,
    Outside = 2,
    Inside = 3,
}

impl Trial {
    /// Distance from the centroid, in units of that from the worst vertex to it.
    pub(super) fn factor(self, numbers: &CoefficientValues) -> f64 {
        match self {
            Self::Reflection => numbers.reflection,
            Self::Expansion => numbers.reflection * numbers.expansion,
            Self::Outside => numbers.reflection * numbers.contraction,
            Self::Inside => -numbers.contraction,
        }
    }

    /// Operation of an iteration that accepted it.
    pub(super) fn operation(self) -> Operation {
        match self {
            Self::Reflection => Operation::Reflection,
            Self::Expansion => Operation::Expansion,
            Self::Outside => Operation::OutsideContraction,
            Self::Inside => Operation::InsideContraction,
        }
    }
}

/// Result at a trial point, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) enum Seen {
    Unknown,
    Cost(f64),
    /// Failed, or above a cutoff that no acceptable point is above.
    Rejected,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct TrialPoint {
    pub(super) u: Vec<f64>,
    pub(super) x: Vec<f64>,
    pub(super) seen: Seen,
}

impl TrialPoint {
    pub(super) fn new(n: usize, n_user: usize) -> Self {
        Self { u: vec![0.0; n], x: vec![0.0; n_user], seen: Seen::Unknown }
    }

    pub(super) fn is_sound(&self, space: &Space) -> bool {
        (self.u.len(), self.x.len()) == (space.n_free(), space.n()) && self.u.iter().all(|u| u.is_finite())
    }
}

/// Where a trial point is measured from.
pub(super) struct Frame<'a> {
    pub(super) space: &'a Space,
    pub(super) handling: BoundsHandling,
    pub(super) factor: f64,
    pub(super) centroid: &'a [f64],
    pub(super) worst: &'a [f64],
    /// A point inside, for coordinates that overflow.
    pub(super) fallback: &'a [f64],
}

impl Frame<'_> {
    /// Places a trial point; `is_vertex` says whether a vertex that stays lies exactly at a point.
    pub(super) fn place(&self, point: &mut TrialPoint, is_vertex: impl Fn(&[f64]) -> bool) {
        let Self { space, centroid, .. } = self;
        let raw = |k: usize| centroid[k] + self.factor * (centroid[k] - self.worst[k]);
        for (k, u) in point.u.iter_mut().enumerate() {
            *u = space.bring_inside(k, raw(k), self.fallback[k], self.handling);
            if self.handling == BoundsHandling::Mirror && brought_onto(*u, raw(k), centroid[k]) {
                *u = beside(space, k, raw(k), centroid[k]);
            } else if self.handling == BoundsHandling::Clamp && brought_onto(*u, raw(k), centroid[k]) {
                // The other vertices lie on the bound: the simplex draws near to it, but does not become flat on it.
                *u = 0.5 * centroid[k] + 0.5 * self.worst[k];
            }
        }
        if self.handling == BoundsHandling::Mirror && is_vertex(&point.u) {
            for (k, u) in point.u.iter_mut().enumerate().filter(|(k, u)| **u != raw(*k)) {
                *u = beside(space, k, raw(k), centroid[k]);
            }
        }
        space.to_user(&point.u, &mut point.x);
    }
}

/// True if the bounds took a coordinate (nearly) back to the centroid: a simplex that accepts the point is
/// flat ever after. Mirroring does that with starts and steps on a grid of tenths of the box, clamping where
/// a side of the simplex lies on a bound.
fn brought_onto(u: f64, raw: f64, centroid: f64) -> bool {
    u != raw && (u - centroid).abs() <= 1e-3 * (raw - centroid).abs()
}

/// Where such a coordinate goes instead: onto the bound that was crossed, half as far from the centroid as
/// the point would have been without bounds; if the centroid lies there itself, into the middle of the box.
fn beside(space: &Space, k: usize, raw: f64, centroid: f64) -> f64 {
    let (lower, upper) = space.working_bounds(k);
    let bound = if raw.is_finite() { raw.clamp(lower, upper) } else { centroid.clamp(lower, upper) };
    if bound == centroid && lower.is_finite() && upper.is_finite() {
        0.5 * lower + 0.5 * upper
    } else {
        bound
    }
}
