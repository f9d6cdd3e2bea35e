//! One side of a profile: from the optimum outwards in steps, the other parameters fitted again at each.

use super::refit::{NoFit, Refits};
use super::result::{ProfileEnd, ProfilePoint};
use super::saved::Side;
use crate::uncertainty::active_bounds::{AT, BoundSide, inner, outer};
use base::RunContext;

/// By how much a step may grow, and shrink.
const GROWTH: (f64, f64) = (0.1, 3.0);

/// The statistic grows by this part of the threshold per step.
const PER_STEP: f64 = 0.25;

/// The first point, which shows how the cost begins to rise, is at this part of it.
const FIRST: f64 = 0.05;

/// A statistic below zero by this part of the threshold is that of another minimum, not noise.
const BELOW: f64 = 0.05;

/// The crossing is known where the statistic is this near to the threshold, as a part of it.
const CROSSING: f64 = 1e-3;

/// ... or lies between two points that are this near to each other, as a part of their distance from the
/// optimum.
const WIDTH: f64 = 1e-3;

/// Refits that look for the crossing between two points: two, unless the statistic is no parabola there, for
/// another parameter has come to its bound.
const REFINEMENTS: usize = 16;

/// After a failure a shorter step is made, so often.
const RETRIES: usize = 3;

/// From where the walk goes.
pub(super) struct Origin<'a> {
    pub(super) x: &'a [f64],
    pub(super) cost: f64,
    pub(super) threshold: f64,
    /// The statistic that a rise of the cost by one is.
    pub(super) per_rise: f64,
    pub(super) max_points: usize,
    /// The first step that makes the statistic one, in the coordinates of the search, and the changes of all
    /// parameters with the parameter, there.
    pub(super) standard_error: f64,
    pub(super) direction: Vec<f64>,
}

/// A point in the coordinates of the search.
struct Place {
    u: Vec<f64>,
    /// Root of the statistic.
    root: f64,
}

/// Walks, until the statistic crosses the threshold or the side is found to be open.
pub(super) fn walk(
    refits: &Refits<'_>,
    (index, side): (usize, BoundSide),
    origin: &Origin<'_>,
    context: &RunContext<'_>,
) -> Side {
    let parameter = &refits.calibration.parameters()[index];
    let (sign, bound) = match side {
        BoundSide::Lower => (-1.0, parameter.lower()),
        BoundSide::Upper => (1.0, parameter.upper()),
    };
    let mut done =
        Side { parameter: index, side, points: Vec::new(), end: ProfileEnd::Interrupted, n_simulations: 0 };
    let parameters = refits.calibration.parameters();
    let limit = inner(parameter, bound);
    let start: Vec<f64> = parameters.iter().zip(origin.x).map(|(p, x)| inner(p, *x)).collect();
    let size = refits.calibration.size_of(parameter, origin.x[index]);
    let is_at_limit = |u: f64| (limit - u) * sign <= AT * size;
    let (goal, center) = (origin.threshold.sqrt(), start[index]);
    // At `u`, the others from where those of `from` and `to` lead.
    let at = |u: f64, from: &[f64], slope: &[f64], done: &mut Side| -> Result<Place, ProfileEnd> {
        let along = |(i, value): (usize, &f64)| {
            let (p, moved) = (&parameters[i], value + slope[i] * (u - from[index]));
            let value = if moved.is_finite() { outer(p, moved) } else { outer(p, *value) };
            value.clamp(p.lower(), p.upper())
        };
        let mut x: Vec<f64> = from.iter().enumerate().map(along).collect();
        x[index] = if is_at_limit(u) { bound } else { outer(parameter, u) };
        let value = x[index];
        let (x, cost) = refits.refit(&x, index, &mut done.n_simulations, context).map_err(|e| match e {
            NoFit::Cancelled => ProfileEnd::Interrupted,
            NoFit::Failed(message) => ProfileEnd::Failed { at: value, message },
        })?;
        let statistic = (cost - origin.cost) * origin.per_rise;
        let place = Place {
            u: parameters.iter().zip(&x).map(|(p, x)| inner(p, *x)).collect(),
            root: statistic.max(0.0).sqrt(),
        };
        done.points.push(ProfilePoint { value, statistic, x });
        match statistic < -BELOW * origin.threshold {
            true => Err(ProfileEnd::LowerCost(value)),
            false => Ok(place),
        }
    };
    let slope = |a: &Place, b: &Place| -> Vec<f64> {
        let by = b.u[index] - a.u[index];
        a.u.iter().zip(&b.u).map(|(a, b)| if by == 0.0 { 0.0 } else { (b - a) / by }).collect()
    };
    let (mut last, mut toward) = (Place { u: start, root: 0.0 }, origin.direction.clone());
    let mut step = (FIRST * origin.threshold).sqrt() * origin.standard_error;
    let mut retries = RETRIES;
    done.end = loop {
        if is_at_limit(last.u[index]) {
            break ProfileEnd::AtBound(bound);
        }
        if done.points.len() >= origin.max_points {
            break ProfileEnd::PointLimit(outer(parameter, last.u[index]));
        }
        let wanted = last.u[index] + sign * step;
        let u = if (limit - wanted) * sign <= 0.0 { limit } else { wanted };
        let next = match at(u, &last.u, &toward, &mut done) {
            Ok(next) => next,
            Err(ProfileEnd::Failed { .. }) if retries > 0 => {
                (retries, step) = (retries - 1, 0.25 * step);
                continue;
            }
            Err(end) => break end,
        };
        let (rise, length) = (next.root - last.root, ((next.u[index] - last.u[index]) * sign).max(0.0));
        if next.root >= goal {
            // The statistic is about quadratic, so its root is about linear.
            let (mut low, mut high) = (last, next);
            let crossing = |low: &Place, high: &Place| {
                let part = (goal - low.root) / (high.root - low.root);
                low.u[index] + part * (high.u[index] - low.u[index])
            };
            let mut end = None;
            for n in 0..REFINEMENTS {
                let nearest = (high.root - goal).min(goal - low.root);
                let width = (high.u[index] - low.u[index]).abs();
                if 2.0 * nearest <= CROSSING * goal || width <= WIDTH * (high.u[index] - center).abs() {
                    break;
                }
                // Of a kink the line knows nothing.
                let is_bent = high.root > 2.0 * goal || n % 3 == 2;
                let middle = 0.5 * (low.u[index] + high.u[index]);
                let u = if is_bent { middle } else { crossing(&low, &high) };
                match at(u, &low.u, &toward, &mut done) {
                    Ok(found) if found.root >= goal => high = found,
                    Ok(found) => low = found,
                    // Without a refinement the crossing is less accurate.
                    Err(ProfileEnd::Failed { .. }) => break,
                    Err(other) => {
                        end = Some(other);
                        break;
                    }
                }
            }
            break end.unwrap_or_else(|| ProfileEnd::Crossed(outer(parameter, crossing(&low, &high))));
        }
        let target = (next.root * next.root + PER_STEP * origin.threshold).sqrt();
        // A little beyond the threshold rather than just below it.
        let target = if target > 0.95 * goal { 1.02 * goal } else { target };
        let asked = if rise > 0.0 { (target - next.root) * length / rise } else { f64::INFINITY };
        toward = slope(&last, &next);
        step = asked.clamp(GROWTH.0 * length, GROWTH.1 * length);
        last = next;
    };
    done.points.sort_by(|a, b| (a.value * sign).total_cmp(&(b.value * sign)));
    done
}
