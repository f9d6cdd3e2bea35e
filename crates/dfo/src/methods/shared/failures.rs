//! Planes that separate failed points from points with a cost.

/// Maximum number of steps of the search for a plane, and the relative gap to the optimum at which it ends.
const MOST_STEPS: usize = 300;
const GAP: f64 = 1e-2;
/// Position of the plane within the gap. The plane is nearer to the points with a cost, so that steps along
/// it avoid the failed points.
const SHARE: f64 = 0.25;

/// Half-space `normal's <= limit` of displacements `s` that contains the points with a cost. The normal has
/// length 1.
pub(crate) struct Plane {
    pub(crate) normal: Vec<f64>,
    pub(crate) limit: f64,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the farthest point along a direction, and its distance.
fn farthest<'a>(points: &'a [Vec<f64>], direction: &[f64]) -> (&'a [f64], f64) {
    let along = points.iter().map(|p| (&p[..], dot(p, direction)));
    along.fold((&[][..], f64::NEG_INFINITY), |far, other| if other.1 > far.1 { other } else { far })
}

/// Returns the plane in the widest gap between two sets of points. If not all failed points can be separated
/// from the others, the first ones are kept. The origin must be among the `good` points.
///
/// The gap is the distance between the nearest points of the two convex hulls, approached by the steps of
/// Gilbert (SIAM J. Control 4, 1966).
pub(crate) fn plane(good: &[Vec<f64>], failed: &[Vec<f64>]) -> Option<Plane> {
    let mut failed = failed;
    while let Some(first) = failed.first() {
        // Start with the vector from the origin to the first failed point.
        let mut w = first.clone();
        for _ in 0..MOST_STEPS {
            let (near, _) = farthest(failed, &w.iter().map(|w| -w).collect::<Vec<_>>());
            let (far, _) = farthest(good, &w);
            let turn: Vec<f64> = near.iter().zip(far).zip(&w).map(|((a, b), w)| a - b - w).collect();
            let (gain, length) = (-dot(&w, &turn), dot(&turn, &turn));
            if !(gain > GAP * dot(&w, &w) && length > 0.0) {
                break;
            }
            let share = (gain / length).min(1.0);
            w.iter_mut().zip(&turn).for_each(|(w, turn)| *w += share * turn);
        }
        let length = dot(&w, &w).sqrt();
        let normal: Vec<f64> = w.iter().map(|w| w / length).collect();
        let opposite: Vec<f64> = normal.iter().map(|v| -v).collect();
        let (low, high) = (farthest(good, &normal).1, -farthest(failed, &opposite).1);
        if high > low {
            return Some(Plane { normal, limit: low + SHARE * (high - low) });
        }
        failed = &failed[..failed.len() / 2];
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plane_separates_good_and_failed_points() {
        let good = [vec![0.0, 0.0], vec![-1.0, 1.0], vec![0.5, -0.5], vec![-2.0, 0.3]];
        let failed = [vec![0.4, 0.4], vec![2.0, -1.2], vec![-0.5, 1.3]];
        let Plane { normal, limit } = plane(&good, &failed).unwrap();
        assert!((dot(&normal, &normal) - 1.0).abs() < 1e-12);
        assert!(
            good.iter().all(|p| dot(p, &normal) < limit) && failed.iter().all(|p| dot(p, &normal) > limit)
        );
        // A failed point inside the hull of the others is ignored. If all are inside, there is no plane.
        let inside = [vec![0.4, 0.4], vec![-0.5, 0.5]];
        assert!(dot(&plane(&good, &inside).unwrap().normal, &[1.0, 1.0]) > 0.0);
        assert!(plane(&good, &inside[1..]).is_none());
    }
}
