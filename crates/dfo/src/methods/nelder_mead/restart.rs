//! Detection of degenerate simplices, and construction of the new simplex for a restart.

use super::initial::{bring_into_rows, stepped};
use crate::method_interface::tolerances::ToleranceTests;
use crate::methods::shared::ranked_points::RankedPoints;
use crate::problem::space::Space;
use serde::{Deserialize, Serialize};

/// Minimum thickness of a simplex that is not flat, in units of its largest edge.
const FLAT: f64 = 1e-7;
/// Maximum distance of all vertices from a bound at which the simplex is on this bound. In units of the
/// parameter size.
const TOUCHING: f64 = 1e-6;
/// Minimum edge of the new simplex, in units of the parameter sizes.
const SIDE: f64 = 1e-3;

/// Edge of the new simplex if the cost has kinks, in units of the parameter sizes.
pub(super) const SIDE_AT_KINKS: f64 = 0.05;
/// Size ratios of the larger simplices whose spread of costs is compared.
const LARGER: [f64; 2] = [1e2, 1e4];
/// Maximum exponent with which the spread decreases with the size at a kink. The exponent is 1 at a kink and
/// 2 for a smooth cost.
const FALL: f64 = 1.5;
/// Minimum significant spread, as a fraction of the cost.
const VISIBLE: f64 = 1e3 * f64::EPSILON;

/// The size of a simplex, and the spread of its costs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Spread {
    size: f64,
    spread: f64,
}

/// Spread of the costs while the simplex shrinks. If the spread decreases with the size instead of its
/// square, the simplex is on a kink. It may have collapsed along the kink away from any minimum.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Spreads {
    since_start: Vec<Spread>,
    /// True if a point has failed since the last start.
    #[serde(default)]
    has_failures: bool,
    /// True after kinks of the cost have been detected.
    pub(super) has_kinks: bool,
}

impl Spreads {
    /// Records a simplex that is at most a tenth of the size of the previous one, if its spread exceeds
    /// rounding errors.
    pub(super) fn enter(&mut self, tests: &ToleranceTests) {
        let (size, Some(spread)) = (tests.x_size, tests.f_spread) else { return };
        let is_smaller = self.since_start.last().is_none_or(|last| size <= 0.1 * last.size);
        if is_smaller && spread > VISIBLE * tests.f_best.abs() {
            self.since_start.push(Spread { size, spread });
        }
    }

    /// Clears the records after a point has failed, because failed points deform the simplex.
    pub(super) fn forget(&mut self) {
        self.since_start.clear();
        self.has_failures = true;
    }

    /// Detects kinks in the records since the last start, and clears the records. Failed points count as
    /// kinks.
    pub(super) fn judge(&mut self) -> bool {
        let has_failures = std::mem::take(&mut self.has_failures);
        let list = std::mem::take(&mut self.since_start);
        self.has_kinks |= list.last().is_some_and(|last| {
            let falls_slowly =
                |before: &Spread| last.spread > before.spread * (last.size / before.size).powf(FALL);
            LARGER.iter().any(|factor| {
                list.iter().rev().find(|before| before.size >= factor * last.size).is_some_and(falls_slowly)
            })
        });
        self.has_kinks || has_failures
    }
}

/// Returns the coordinates along which the simplex is not on a bound.
pub(super) fn free_coordinates(simplex: &RankedPoints, space: &Space) -> impl Iterator<Item = usize> {
    (0..space.n_free()).filter(move |&k| {
        let (lower, upper) = space.working_bounds(k);
        let near = |bound: f64| {
            simplex.order().iter().all(|&s| (simplex.u(s)[k] - bound).abs() <= TOUCHING * space.size(k))
        };
        !(near(lower) || near(upper))
    })
}

/// True if the simplex is flat in the coordinates along which it is not on a bound.
pub(super) fn is_flat(simplex: &RankedPoints, space: &Space) -> bool {
    let best = simplex.best();
    let free: Vec<usize> = free_coordinates(simplex, space).collect();
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
        // This form of the comparison counts NaN as flat.
        let thick = pivot > FLAT * first;
        if !thick {
            return true;
        }
    }
    false
}

/// Performs one step of Gaussian elimination with complete pivoting. Returns the size of the pivot, or `None`
/// if there is none.
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

/// Builds a simplex around the best vertex, with one edge along each coordinate. Each edge points in the
/// direction in which the costs of the old simplex decrease. `extent` is the size of the old simplex in units
/// of the parameter sizes.
pub(super) fn orient(simplex: &mut RankedPoints, space: &Space, extent: f64) {
    let n = space.n_free();
    let best = simplex.best();
    let (centre, f_best) = (simplex.u(best).to_vec(), simplex.cost(best).value().unwrap_or(0.0));
    // Each edge of the old simplex determines a slope along itself. The sum of the slopes determines the
    // uphill direction.
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
        bring_into_rows(simplex, best, slot, space);
    }
}

/// True if the best vertex is on a linear constraint.
pub(super) fn is_on_row(simplex: &RankedPoints, space: &Space) -> bool {
    space.rows().iter().any(|row| {
        let terms = row.normal.iter().enumerate();
        let length = terms.map(|(k, a)| (a * space.size(k)).powi(2)).sum::<f64>().sqrt();
        row.limit - row.value(simplex.u(simplex.best())) <= TOUCHING * length
    })
}
