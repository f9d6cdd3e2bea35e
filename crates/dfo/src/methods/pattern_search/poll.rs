//! Directions of a poll and their order.

use serde::{Deserialize, Serialize};

/// Directions of a poll: the columns of a Householder matrix and their opposites, most promising first.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Poll {
    /// Normal of the reflection, of length 1; zero if the axes are not rotated.
    normal: Vec<f64>,
    /// Axis and sign of each direction.
    order: Vec<(usize, bool)>,
    /// Directions that conform to nearly active linear constraints, of length 1. They follow the others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    conforming: Vec<Vec<f64>>,
}

impl Poll {
    /// Returns a poll along the coordinate axes.
    pub(super) fn along_axes(n: usize) -> Self {
        let order = (0..n).flat_map(|k| [(k, true), (k, false)]).collect();
        Self { normal: vec![0.0; n], order, conforming: Vec::new() }
    }

    /// Returns a poll with the reflection by a point of Halton's sequence (OrthoMADS, section 3.1). `index`
    /// starts at 1.
    pub(super) fn of_halton(n: usize, index: u64) -> Self {
        let mut poll = Self::along_axes(n);
        let bases = (2u64..).filter(|p| (2..).take_while(|d| d * d <= *p).all(|d| !p.is_multiple_of(d)));
        // The first n points are near a line.
        poll.normal = bases.take(n).map(|base| 2.0 * radical_inverse(index + n as u64, base) - 1.0).collect();
        poll.normalise();
        poll
    }

    /// Returns a poll with one direction along `way`, and the directions nearest to `way` first. If `way` has
    /// no length, the poll is along the axes.
    pub(super) fn along(way: &[f64]) -> Self {
        let mut poll = Self::along_axes(way.len());
        poll.normal.copy_from_slice(way);
        poll.normalise();
        let largest =
            |far: usize, k: usize| if poll.normal[k].abs() > poll.normal[far].abs() { k } else { far };
        let axis = (0..way.len()).fold(0, largest);
        let along: f64 = (0..way.len()).map(|k| poll.normal[k].powi(2)).sum();
        if along == 0.0 {
            return poll;
        }
        // The reflection maps this axis to the direction of `way`, up to the sign.
        poll.normal[axis] += poll.normal[axis].signum();
        poll.normalise();
        let mut step = vec![0.0; way.len()];
        let mut nearness: Vec<f64> = Vec::with_capacity(poll.order.len());
        for k in 0..poll.order.len() {
            poll.direction(k, &mut step);
            nearness.push(step.iter().zip(way).map(|(a, b)| a * b).sum());
        }
        let mut ranked: Vec<usize> = (0..nearness.len()).collect();
        ranked.sort_by(|&a, &b| nearness[b].total_cmp(&nearness[a]));
        poll.order = ranked.iter().map(|&k| poll.order[k]).collect();
        poll
    }

    /// Returns the number of directions.
    pub(super) fn len(&self) -> usize {
        self.order.len() + self.conforming.len()
    }

    /// Adds directions that generate the cone of feasible directions at nearly active constraints with these
    /// normals (Lewis and Torczon, SIAM J. Optim. 10, 2000, 917): the directions that leave one constraint
    /// and follow the others, and a basis of those that follow all of them, with both signs. Normals that
    /// depend on earlier ones are ignored.
    pub(super) fn conform(&mut self, normals: &[Vec<f64>]) {
        self.conforming.clear();
        let n = self.normal.len();
        // An orthonormal basis of the independent normals.
        let (mut active, mut basis): (Vec<&[f64]>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        for normal in normals {
            if let Some(unit) = beside(normal, &basis, DEPENDENT) {
                basis.push(unit);
                active.push(normal);
            }
        }
        for (i, normal) in active.iter().enumerate() {
            // The part of a normal across all other normals.
            let mut others: Vec<Vec<f64>> = Vec::new();
            for (_, other) in active.iter().enumerate().filter(|(j, _)| *j != i) {
                others.extend(beside(other, &others, 0.0));
            }
            let inward: Vec<f64> = normal.iter().map(|a| -a).collect();
            self.conforming.extend(beside(&inward, &others, 0.0));
        }
        let mut axis = vec![0.0; n];
        for k in (0..self.order.len()).filter(|k| self.order[*k].1) {
            if active.is_empty() || basis.len() == n {
                break;
            }
            self.direction(k, &mut axis);
            if let Some(unit) = beside(&axis, &basis, DEPENDENT) {
                self.conforming.push(unit.iter().map(|a| -a).collect());
                self.conforming.push(unit.clone());
                basis.push(unit);
            }
        }
    }

    /// True if direction `k` conforms to linear constraints. Such directions are not rounded to the mesh.
    pub(super) fn is_conforming(&self, k: usize) -> bool {
        k >= self.order.len()
    }

    /// Sets `out` to direction `k`, of length 1.
    pub(super) fn direction(&self, k: usize, out: &mut [f64]) {
        if let Some(direction) = k.checked_sub(self.order.len()).map(|k| &self.conforming[k]) {
            out.copy_from_slice(direction);
            return;
        }
        let (axis, is_positive) = self.order[k];
        let sign = if is_positive { 1.0 } else { -1.0 };
        for (i, (d, v)) in out.iter_mut().zip(&self.normal).enumerate() {
            *d = sign * (f64::from(i == axis) - 2.0 * v * self.normal[axis]);
        }
    }

    fn normalise(&mut self) {
        let largest = self.normal.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        let length = self.normal.iter().map(|v| (v / largest).powi(2)).sum::<f64>().sqrt();
        if largest > 0.0 && length.is_finite() {
            self.normal.iter_mut().for_each(|v| *v = *v / largest / length);
        } else {
            self.normal.fill(0.0);
        }
    }

    pub(super) fn is_sound(&self, n: usize) -> bool {
        self.normal.len() == n
            && self.order.len() == 2 * n
            && self.order.iter().all(|(axis, _)| *axis < n)
            && self.conforming.iter().all(|d| d.len() == n && d.iter().all(|d| d.is_finite()))
    }
}

/// Length of the independent part of a normal of length 1 below which it depends on the others.
const DEPENDENT: f64 = 1e-6;

/// Returns the part of a vector across an orthonormal basis, with length 1. `None` if it is at most `least`
/// times as long as the vector.
fn beside(vector: &[f64], basis: &[Vec<f64>], least: f64) -> Option<Vec<f64>> {
    let length = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let whole = length(vector);
    let mut rest: Vec<f64> = vector.iter().map(|v| v / whole).collect();
    // Twice, because the first pass leaves rounding errors.
    for unit in basis.iter().chain(basis) {
        let along: f64 = rest.iter().zip(unit).map(|(a, b)| a * b).sum();
        rest.iter_mut().zip(unit).for_each(|(r, u)| *r -= along * u);
    }
    let length = length(&rest);
    (length > least && length.is_finite()).then(|| rest.iter().map(|r| r / length).collect())
}

/// Returns the radical inverse: the digits of a number in a base, mirrored at the radix point (Halton, Numer.
/// Math. 2, 1960).
fn radical_inverse(mut index: u64, base: u64) -> f64 {
    let (mut value, mut unit) = (0.0, 1.0);
    while index > 0 {
        unit /= base as f64;
        value += unit * (index % base) as f64;
        index /= base;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directions(poll: &Poll, n: usize) -> Vec<Vec<f64>> {
        let direction = |k: usize| {
            let mut d = vec![0.0; n];
            poll.direction(k, &mut d);
            d
        };
        (0..poll.len()).map(direction).collect()
    }

    #[test]
    fn directions_are_orthogonal_and_include_their_opposites() {
        let ways: [&[f64]; 4] = [&[3.0, -4.0, 0.5], &[0.0, 0.0, -1e-200], &[1e300, 1e300, 1e300], &[0.0; 3]];
        let mut polls: Vec<Poll> = ways.iter().map(|way| Poll::along(way)).collect();
        polls.extend((1..20).map(|index| Poll::of_halton(3, index)));
        for poll in polls {
            let all = directions(&poll, 3);
            let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
            for a in &all {
                assert!((dot(a, a) - 1.0).abs() < 1e-14);
                let parallel: Vec<f64> = all.iter().map(|b| dot(a, b)).filter(|d| d.abs() > 1e-14).collect();
                assert!(parallel.len() == 2 && (parallel[0] + parallel[1]).abs() < 1e-14, "{poll:?}");
            }
        }
    }

    #[test]
    fn first_direction_is_along_the_way() {
        let all = directions(&Poll::along(&[3.0, -4.0]), 2);
        assert!((all[0][0] - 0.6).abs() < 1e-15 && (all[0][1] + 0.8).abs() < 1e-15, "{all:?}");
        assert!((all[3][0] + 0.6).abs() < 1e-15, "{all:?}");
    }

    #[test]
    fn radical_inverse_matches_reference_values() {
        let values: Vec<f64> = (1..6).map(|i| radical_inverse(i, 2)).collect();
        assert_eq!(values, [0.5, 0.25, 0.75, 0.125, 0.625]);
        assert!((radical_inverse(5, 3) - (2.0 / 3.0 + 1.0 / 9.0)).abs() < 1e-15);
    }
}
