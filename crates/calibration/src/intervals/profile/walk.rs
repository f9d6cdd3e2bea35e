//! One side of a profile, which proceeds outwards from the optimum and fits the other parameters again at
//! each step.

use super::refit::{NoFit, Refits, Refitted};
use super::result::{ProfileEnd, ProfilePoint};
use super::saved::Side;
use crate::problem::parameter::{Parameter, inner, outer};
use crate::uncertainty::inactive_parameters::{AT, BoundSide};
use base::RunContext;

/// Smallest and largest ratio of a step to the previous step.
const GROWTH: (f64, f64) = (0.1, 3.0);

/// Target growth of the statistic per step, as a part of the threshold.
const PER_STEP: f64 = 0.25;

/// Target statistic of the first point, as a part of the threshold. This point shows the initial rise of the
/// cost.
const FIRST: f64 = 0.05;

/// A statistic below zero by more than this part of the threshold indicates another minimum, not noise.
const BELOW: f64 = 0.05;

/// Relative accuracy of the statistic at the crossing.
const CROSSING: f64 = 1e-3;

/// Maximum distance of the two points that enclose the crossing, relative to their distance from the optimum.
const WIDTH: f64 = 1e-3;

/// Maximum number of refits that locate the crossing between two points. Two suffice unless the statistic is
/// not a parabola there because another parameter reached its bound.
const REFINEMENTS: usize = 16;

/// Maximum number of shorter steps after failures.
const RETRIES: usize = 3;

/// Starting point and options of a walk.
pub(super) struct Origin<'a> {
    /// Index of the parameter.
    pub(super) index: usize,
    pub(super) x: &'a [f64],
    pub(super) cost: f64,
    pub(super) threshold: f64,
    /// Statistic per unit rise of the cost.
    pub(super) per_rise: f64,
    pub(super) max_points: usize,
    /// Step that raises the statistic to one, in the coordinates of the search. `direction` contains the
    /// changes of all parameters relative to the change of this parameter.
    pub(super) standard_error: f64,
    pub(super) direction: Vec<f64>,
}

/// Point in the coordinates of the search.
struct Place {
    u: Vec<f64>,
    /// Square root of the statistic.
    root: f64,
}

/// Walk along one side of a parameter.
struct Walk<'a> {
    refits: &'a Refits<'a>,
    origin: &'a Origin<'a>,
    context: &'a RunContext<'a>,
    /// 1 towards the upper bound, -1 towards the lower bound.
    sign: f64,
    bound: f64,
    done: Side,
}

/// Walks until the statistic crosses the threshold or the side is open.
pub(super) fn walk(
    refits: &Refits<'_>,
    side: BoundSide,
    origin: &Origin<'_>,
    context: &RunContext<'_>,
) -> Side {
    let parameter = &refits.calibration.parameters()[origin.index];
    let (sign, bound) = match side {
        BoundSide::Lower => (-1.0, parameter.search_lower()),
        BoundSide::Upper => (1.0, parameter.search_upper()),
    };
    let mut walk = Walk { refits, origin, context, sign, bound, done: Side::new(origin.index, side) };
    walk.done.end = walk.walk_on();
    let mut done = walk.done;
    done.points.sort_by(|a, b| (a.value * sign).total_cmp(&(b.value * sign)));
    done
}

impl Walk<'_> {
    fn parameters(&self) -> &[Parameter] {
        self.refits.calibration.parameters()
    }

    fn parameter(&self) -> &Parameter {
        &self.parameters()[self.origin.index]
    }

    /// Returns the bound in the coordinates of the search.
    fn limit(&self) -> f64 {
        inner(self.parameter(), self.bound)
    }

    fn is_at_limit(&self, u: f64) -> bool {
        let size = self.refits.calibration.size_of(self.parameter(), self.origin.x[self.origin.index]);
        (self.limit() - u) * self.sign <= AT * size
    }

    /// Refits with the parameter at `u`. The other parameters start from a linear prediction by their slopes.
    fn at(&mut self, u: f64, from: &Place, slopes: &[f64]) -> Result<Place, ProfileEnd> {
        let Origin { index, cost, per_rise, threshold, .. } = *self.origin;
        let along = |(p, (value, slope)): (&Parameter, (&f64, &f64))| {
            let moved = value + slope * (u - from.u[index]);
            outer(p, if moved.is_finite() { moved } else { *value }).clamp(p.search_lower(), p.search_upper())
        };
        let mut x: Vec<f64> = self.parameters().iter().zip(from.u.iter().zip(slopes)).map(along).collect();
        x[index] = if self.is_at_limit(u) { self.bound } else { outer(self.parameter(), u) };
        let value = x[index];
        let refitted = self.refits.refit(&x, Some(index), &mut self.done.n_simulations, self.context);
        let Refitted { x, cost: found } = refitted.map_err(|e| match e {
            NoFit::Cancelled => ProfileEnd::Interrupted,
            NoFit::Failed(message) => ProfileEnd::Failed { at: value, message },
        })?;
        let statistic = (found - cost) * per_rise;
        let u = self.parameters().iter().zip(&x).map(|(p, x)| inner(p, *x)).collect();
        self.done.points.push(ProfilePoint { value, statistic, x });
        match statistic < -BELOW * threshold {
            true => Err(ProfileEnd::LowerCost(value)),
            false => Ok(Place { u, root: statistic.max(0.0).sqrt() }),
        }
    }

    fn walk_on(&mut self) -> ProfileEnd {
        let Origin { index, threshold, max_points, standard_error, .. } = *self.origin;
        let (sign, limit, goal) = (self.sign, self.limit(), threshold.sqrt());
        let start = self.parameters().iter().zip(self.origin.x).map(|(p, x)| inner(p, *x)).collect();
        let (mut last, mut slopes) = (Place { u: start, root: 0.0 }, self.origin.direction.clone());
        let mut step = (FIRST * threshold).sqrt() * standard_error;
        let mut retries = RETRIES;
        loop {
            if self.is_at_limit(last.u[index]) {
                return ProfileEnd::AtBound(self.bound);
            }
            if self.done.points.len() >= max_points {
                return ProfileEnd::PointLimit(outer(self.parameter(), last.u[index]));
            }
            let wanted = last.u[index] + sign * step;
            let u = if (limit - wanted) * sign <= 0.0 { limit } else { wanted };
            let next = match self.at(u, &last, &slopes) {
                Ok(next) => next,
                Err(ProfileEnd::Failed { .. }) if retries > 0 => {
                    (retries, step) = (retries - 1, 0.25 * step);
                    continue;
                }
                Err(end) => return end,
            };
            if next.root >= goal {
                return self.crossing(last, next, &slopes);
            }
            let (rise, length) = (next.root - last.root, ((next.u[index] - last.u[index]) * sign).max(0.0));
            let target = (next.root * next.root + PER_STEP * threshold).sqrt();
            // Aim slightly beyond the threshold rather than just below it.
            let target = if target > 0.95 * goal { 1.02 * goal } else { target };
            let requested = if rise > 0.0 { (target - next.root) * length / rise } else { f64::INFINITY };
            let by = next.u[index] - last.u[index];
            let changes = last.u.iter().zip(&next.u);
            slopes = changes.map(|(a, b)| if by == 0.0 { 0.0 } else { (b - a) / by }).collect();
            step = requested.clamp(GROWTH.0 * length, GROWTH.1 * length);
            last = next;
        }
    }

    /// Finds the point between two others at which the statistic crosses the threshold.
    fn crossing(&mut self, mut low: Place, mut high: Place, slopes: &[f64]) -> ProfileEnd {
        let (index, goal) = (self.origin.index, self.origin.threshold.sqrt());
        let center = inner(self.parameter(), self.origin.x[index]);
        // The statistic is nearly quadratic, so its root is nearly linear.
        let linear = |low: &Place, high: &Place| {
            let part = (goal - low.root) / (high.root - low.root);
            low.u[index] + part * (high.u[index] - low.u[index])
        };
        for n in 0..REFINEMENTS {
            let nearest = (high.root - goal).min(goal - low.root);
            let width = (high.u[index] - low.u[index]).abs();
            if 2.0 * nearest <= CROSSING * goal || width <= WIDTH * (high.u[index] - center).abs() {
                break;
            }
            // Linear interpolation fails at a kink.
            let is_bent = high.root > 2.0 * goal || n % 3 == 2;
            let u = if is_bent { 0.5 * (low.u[index] + high.u[index]) } else { linear(&low, &high) };
            match self.at(u, &low, slopes) {
                Ok(found) if found.root >= goal => high = found,
                Ok(found) => low = found,
                // A failed refinement only makes the crossing less accurate.
                Err(ProfileEnd::Failed { .. }) => break,
                Err(other) => return other,
            }
        }
        ProfileEnd::Crossed(outer(self.parameter(), linear(&low, &high)))
    }
}
