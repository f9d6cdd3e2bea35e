//! When a simplex has become flat, and the one that takes its place.

use super::initial::stepped;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;

/// Smallest thickness of a simplex, in units of its largest edge, that still is a body.
const FLAT: f64 = 1e-7;
/// A simplex is on a bound along a coordinate if all vertices are this near, in units of the size.
const TOUCHING: f64 = 1e-6;
/// Side of the new simplex in units of the sizes, if it is not already larger.
const SIDE: f64 = 1e-3;

/// True if the simplex is flat in the coordinates along which it does not lie on a bound.
pub(super) fn is_flat(simplex: &RankedPoints, space: &Space) -> bool {
    let n = space.n_free();
    let best = simplex.best();
    let free: Vec<usize> = (0..n)
        .filter(|&k| {
            let (lower, upper) = space.working_bounds(k);
            let near = |bound: f64| {
                simplex.order().iter().all(|&s| (simplex.u(s)[k] - bound).abs() <= TOUCHING * space.size(k))
            };
            !(near(lower) || near(upper))
        })
        .collect();
    let mut edges: Vec<Vec<f64>> = simplex.order()[1..]
        .iter()
        .map(|&s| free.iter().map(|&k| (simplex.u(s)[k] - simplex.u(best)[k]) / space.size(k)).collect())
        .collect();
    let mut first = 0.0;
    for step in 0..free.len() {
        let Some(pivot) = eliminate(&mut edges, step, free.len()) else { return true };
        if step == 0 {
            first = pivot;
        }
        // Written this way round so that NaN counts as flat.
        let thick = pivot > FLAT * first;
        if !thick {
            return true;
        }
    }
    false
}

/// One step of Gaussian elimination with complete pivoting; the size of the pivot, `None` if there is none.
fn eliminate(rows: &mut [Vec<f64>], step: usize, columns: usize) -> Option<f64> {
    let mut at = (step, step);
    for row in step..rows.len() {
        for column in step..columns {
            if rows[row][column].abs() > rows[at.0][at.1].abs() {
                at = (row, column);
            }
        }
    }
    let pivot = rows.get(at.0)?.get(at.1)?.abs();
    if !(pivot > 0.0 && pivot.is_finite()) {
        return None;
    }
    rows.swap(step, at.0);
    rows.iter_mut().for_each(|r| r.swap(step, at.1));
    let (done, rest) = rows.split_at_mut(step + 1);
    for row in rest {
        let factor = row[step] / done[step][step];
        for column in step..columns {
            row[column] -= factor * done[step][column];
        }
    }
    Some(pivot)
}

/// Builds a simplex around the best vertex, with one edge along each coordinate, pointing down the costs of
/// the old one. `extent` is the size of the old simplex in units of the sizes.
pub(super) fn orient(simplex: &mut RankedPoints, space: &Space, extent: f64) {
    let n = space.n_free();
    let best = simplex.best();
    let (centre, f_best) = (simplex.u(best).to_vec(), simplex.cost(best).value().unwrap_or(0.0));
    // Each edge of the old simplex tells a slope along itself; their sum tells the side that goes up.
    let mut slopes = vec![0.0; n];
    for &slot in &simplex.order()[1..] {
        let Some(rise) = simplex.cost(slot).value().map(|f| f - f_best) else { continue };
        let edge = |k: usize| (simplex.u(slot)[k] - centre[k]) / space.size(k);
        let square: f64 = (0..n).map(|k| edge(k).powi(2)).sum();
        if square > 0.0 {
            slopes.iter_mut().enumerate().for_each(|(k, s)| *s += rise * edge(k) / square);
        }
    }
    let slots: Vec<usize> = simplex.order()[1..].to_vec();
    let mut x = vec![0.0; space.n()];
    for (k, slot) in slots.into_iter().enumerate() {
        let step = extent.max(SIDE) * space.size(k) * if slopes[k] > 0.0 { -1.0 } else { 1.0 };
        let mut u = centre.clone();
        u[k] = stepped(centre[k], step, space.working_bounds(k));
        space.to_user(&u, &mut x);
        simplex.set(slot, &u, &x);
    }
}
