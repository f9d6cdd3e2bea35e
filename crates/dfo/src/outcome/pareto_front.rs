//! Pareto front of several criteria, and its hypervolume.

use serde::{Deserialize, Serialize};

/// A point of a Pareto front.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParetoPoint {
    /// The point, in the user's units and order.
    pub x: Vec<f64>,
    /// Its criteria, all minimised.
    pub criteria: Vec<f64>,
    /// Largest violation of a nonlinear constraint, at most the tolerance; 0 without nonlinear constraints.
    pub constr_violation: f64,
}

/// Feasible points that do not dominate each other, in ascending order of the first criterion. Empty if no
/// evaluated point is feasible.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ParetoFront {
    /// The points.
    pub points: Vec<ParetoPoint>,
}

impl ParetoFront {
    pub(crate) fn new(mut points: Vec<ParetoPoint>) -> Self {
        let compare = |a: &ParetoPoint, b: &ParetoPoint| {
            let pairs = a.criteria.iter().zip(&b.criteria).chain(a.x.iter().zip(&b.x));
            pairs
                .map(|(a, b)| a.total_cmp(b))
                .find(|order| order.is_ne())
                .unwrap_or(std::cmp::Ordering::Equal)
        };
        points.sort_by(compare);
        Self { points }
    }

    /// Returns the smallest and the largest value of a criterion.
    fn range(&self, m: usize) -> (f64, f64) {
        let values = self.points.iter().map(|point| point.criteria[m]);
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    }

    /// Returns the point nearest to the ideal point, and its distance (compromise programming, Zeleny 1973).
    /// The ideal point has the smallest value of each criterion on the front. Each criterion is scaled by its
    /// range on the front. The first of equally near points is returned; `None` if the front is empty.
    pub fn compromise(&self) -> Option<(&ParetoPoint, f64)> {
        let n_criteria = self.points.first()?.criteria.len();
        let ranges: Vec<(f64, f64)> = (0..n_criteria).map(|m| self.range(m)).collect();
        let distance = |point: &ParetoPoint| {
            let scaled = point.criteria.iter().zip(&ranges).map(|(value, (low, high))| match high - low {
                range if range > 0.0 => (value - low) / range,
                _ => 0.0,
            });
            scaled.map(|v| v * v).sum::<f64>().sqrt()
        };
        let with_distances = self.points.iter().map(|point| (point, distance(point)));
        with_distances.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the hypervolume of the front, see [`hypervolume`]. `None` if the reference point does not have
    /// one value per criterion.
    pub fn hypervolume(&self, reference: &[f64]) -> Option<f64> {
        let points: Vec<&[f64]> = self.points.iter().map(|point| &point.criteria[..]).collect();
        hypervolume(&points, reference)
    }

    /// True if all points have the same lengths. A front read from a file may be inconsistent.
    pub(crate) fn is_sound(&self, n: usize) -> bool {
        let Some(first) = self.points.first() else { return true };
        self.points.iter().all(|p| p.x.len() == n && p.criteria.len() == first.criteria.len())
    }
}

/// Returns the volume of the region that the points dominate, up to the reference point (Zitzler and Thiele,
/// IEEE Trans. Evol. Comput. 3, 1999). Points that are not better than the reference point in every criterion
/// do not contribute. `None` if the lengths of a point and of the reference point differ.
///
/// Slices along the last criterion reduce the dimension by one (While, Hingston, Barone and Huband, IEEE
/// Trans. Evol. Comput. 10, 2006). For two criteria, the time grows as `n log n`; each further criterion adds
/// a factor of `n`.
///
/// ```
/// let points = [[1.0, 3.0], [2.0, 2.0], [3.0, 1.0]];
/// assert_eq!(dfo::hypervolume(&points, &[4.0, 4.0]), Some(6.0));
/// ```
pub fn hypervolume(points: &[impl AsRef<[f64]>], reference: &[f64]) -> Option<f64> {
    let points = points.iter().map(AsRef::as_ref);
    if points.clone().any(|point| point.len() != reference.len()) {
        return None;
    }
    let inside = points.filter(|point| point.iter().zip(reference).all(|(value, limit)| value < limit));
    Some(volume(inside.collect(), reference))
}

/// Returns the volume dominated by points that are all inside the reference point. Only the criteria of the
/// reference point count.
fn volume(mut points: Vec<&[f64]>, reference: &[f64]) -> f64 {
    let Some((limit, others)) = reference.split_last() else { return 0.0 };
    let last = others.len();
    points.sort_by(|a, b| a[last].total_cmp(&b[last]));
    // Points that the slices so far contain, without points that others dominate in the other criteria.
    let mut slice: Vec<&[f64]> = Vec::new();
    let mut sum = 0.0;
    for (k, point) in points.iter().enumerate() {
        let covers = |a: &[f64], b: &[f64]| a[..last].iter().zip(&b[..last]).all(|(a, b)| a <= b);
        if !slice.iter().any(|other| covers(other, point)) {
            slice.retain(|other| !covers(point, other));
            slice.push(point);
        }
        let depth = points.get(k + 1).map_or(*limit, |next| next[last]) - point[last];
        if depth > 0.0 {
            sum += depth * if last == 0 { 1.0 } else { volume(slice.clone(), others) };
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hypervolume_of_boxes_and_their_unions() {
        let none: [[f64; 2]; 0] = [];
        assert_eq!(hypervolume(&none, &[1.0, 1.0]), Some(0.0));
        // A point outside, a dominated point, a repeated point.
        let points = [[0.0, 1.0], [1.0, 0.0], [1.0, 0.0], [1.5, 1.5], [3.0, -5.0]];
        assert_eq!(hypervolume(&points, &[2.0, 2.0]), Some(3.0));
        // Three boxes: 3 * 4 - 3 * 2 + 1 by inclusion and exclusion.
        let points = [[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]];
        assert_eq!(hypervolume(&points, &[2.0; 3]), Some(4.0));
        assert_eq!(hypervolume(&[[0.0; 4], [1.0; 4]], &[2.0; 4]), Some(16.0));
        assert_eq!(hypervolume(&points, &[2.0; 2]), None);
    }

    #[test]
    fn compromise_is_the_nearest_point_to_the_ideal() {
        let point = |a: f64, b: f64| ParetoPoint { x: vec![a], criteria: vec![a, b], constr_violation: 0.0 };
        let front = ParetoFront::new(vec![point(2.0, 0.0), point(0.0, 1000.0), point(0.5, 300.0)]);
        let (nearest, distance) = front.compromise().unwrap();
        assert_eq!(nearest.criteria, [0.5, 300.0]);
        assert!((distance - (0.25f64.powi(2) + 0.3f64.powi(2)).sqrt()).abs() < 1e-15);
        assert_eq!(front.points[0].criteria[0], 0.0);
        assert_eq!(ParetoFront::default().compromise(), None);
    }
}
