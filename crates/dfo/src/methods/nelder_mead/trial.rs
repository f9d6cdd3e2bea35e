//! The four trial points of an iteration: positions and results.

use super::options::CoefficientValues;
use crate::method_interface::interface::Operation;
use crate::problem::space::Space;
use crate::values::choices::BoundsHandling;
use serde::{Deserialize, Serialize};

/// The four trial points of an iteration. The value is the index in tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Trial {
    Reflection = 0,
    Expansion = 1,
    Outside = 2,
    Inside = 3,
}

impl Trial {
    /// Returns the distance from the centroid, in units of the distance between the worst vertex and the
    /// centroid.
    pub(super) fn factor(self, numbers: &CoefficientValues) -> f64 {
        match self {
            Self::Reflection => numbers.reflection,
            Self::Expansion => numbers.reflection * numbers.expansion,
            Self::Outside => numbers.reflection * numbers.contraction,
            Self::Inside => -numbers.contraction,
        }
    }

    /// Returns the operation of an iteration that accepted this trial point.
    pub(super) fn operation(self) -> Operation {
        match self {
            Self::Reflection => Operation::Reflection,
            Self::Expansion => Operation::Expansion,
            Self::Outside => Operation::OutsideContraction,
            Self::Inside => Operation::InsideContraction,
        }
    }
}

/// Result at a trial point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) enum Seen {
    Unknown,
    Cost(f64),
    /// Failed, or above a cutoff that no acceptable point exceeds.
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

/// Reference points and factor of a trial point.
pub(super) struct Frame<'a> {
    pub(super) space: &'a Space,
    pub(super) handling: BoundsHandling,
    pub(super) factor: f64,
    pub(super) centroid: &'a [f64],
    pub(super) worst: &'a [f64],
    /// Interior point, for coordinates that overflow.
    pub(super) fallback: &'a [f64],
}

impl Frame<'_> {
    /// Places a trial point. `is_vertex` returns true if a remaining vertex is exactly at a point.
    pub(super) fn place(&self, point: &mut TrialPoint, is_vertex: impl Fn(&[f64]) -> bool) {
        let Self { space, centroid, .. } = self;
        let raw = |k: usize| centroid[k] + self.factor * (centroid[k] - self.worst[k]);
        for (k, u) in point.u.iter_mut().enumerate() {
            *u = space.bring_inside(k, raw(k), self.fallback[k], self.handling);
            if self.handling == BoundsHandling::Mirror && brought_onto(*u, raw(k), centroid[k]) {
                *u = beside(space, k, raw(k), centroid[k]);
            } else if self.handling == BoundsHandling::Clamp && brought_onto(*u, raw(k), centroid[k]) {
                // The other vertices are on the bound. Approach the bound without becoming flat on it.
                *u = 0.5 * centroid[k] + 0.5 * self.worst[k];
            }
        }
        if self.handling == BoundsHandling::Mirror && is_vertex(&point.u) {
            for (k, u) in point.u.iter_mut().enumerate().filter(|(k, u)| **u != raw(*k)) {
                *u = beside(space, k, raw(k), centroid[k]);
            }
        }
        if !space.satisfies_rows(&point.u) && !self.mirror_at_rows(&mut point.u, is_vertex) {
            self.shorten(&mut point.u);
        }
        space.to_user(&point.u, &mut point.x);
    }

    /// Mirrors a point at the linear constraints that it violates, in units of the parameter sizes. Returns
    /// false, with the point unchanged, if it is then not inside, or (nearly) at the centroid or at a
    /// remaining vertex, where the simplex would become flat.
    fn mirror_at_rows(&self, u: &mut [f64], is_vertex: impl Fn(&[f64]) -> bool) -> bool {
        let Self { space, handling, .. } = self;
        if *handling == BoundsHandling::Clamp {
            return false;
        }
        let mut mirrored = u.to_vec();
        for row in space.rows() {
            let excess = row.value(&mirrored) - row.limit;
            if excess > 0.0 {
                let square: f64 =
                    row.normal.iter().enumerate().map(|(k, a)| (a * space.size(k)).powi(2)).sum();
                for (k, (v, a)) in mirrored.iter_mut().zip(&row.normal).enumerate() {
                    *v -= 2.0 * excess / square * a * space.size(k).powi(2);
                }
            }
        }
        let is_apart = self.distance(&mirrored) > NEARLY * self.distance(u) && !is_vertex(&mirrored);
        let is_usable = is_apart && space.holds(&mirrored);
        if is_usable {
            u.copy_from_slice(&mirrored);
        }
        is_usable
    }

    /// Returns the distance from the centroid, in units of the parameter sizes.
    fn distance(&self, u: &[f64]) -> f64 {
        let terms = u.iter().zip(self.centroid).enumerate();
        terms.map(|(k, (u, c))| ((u - c) / self.space.size(k)).powi(2)).sum::<f64>().sqrt()
    }

    /// Shortens the way from the centroid to a point that violates linear constraints.
    fn shorten(&self, u: &mut [f64]) {
        let Self { space, centroid, worst, .. } = self;
        let before = self.distance(u);
        space.shorten(centroid, u);
        if self.distance(u) <= NEARLY * before {
            // The other vertices are on the constraint.
            u.iter_mut().enumerate().for_each(|(k, u)| *u = 0.5 * centroid[k] + 0.5 * worst[k]);
            space.restore(u);
        }
    }
}

/// Share of a step below which a point counts as (nearly) at the centroid.
const NEARLY: f64 = 1e-3;

/// True if the bounds moved a coordinate (nearly) back to the centroid. A simplex that accepts such a point
/// stays flat. With mirroring, this happens if starts and steps are on a grid of tenths of the box. With
/// clamping, it happens if a side of the simplex is on a bound.
fn brought_onto(u: f64, raw: f64, centroid: f64) -> bool {
    u != raw && (u - centroid).abs() <= NEARLY * (raw - centroid).abs()
}

/// Returns the replacement for such a coordinate. This is the crossed bound, which is half as far from the
/// centroid as the unbounded point. If the centroid is on this bound, returns the middle of the box.
fn beside(space: &Space, k: usize, raw: f64, centroid: f64) -> f64 {
    let (lower, upper) = space.working_bounds(k);
    let bound = if raw.is_finite() { raw.clamp(lower, upper) } else { centroid.clamp(lower, upper) };
    if bound == centroid && lower.is_finite() && upper.is_finite() {
        0.5 * lower + 0.5 * upper
    } else {
        bound
    }
}
