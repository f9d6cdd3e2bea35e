//! Map of the real line into the bounds of a coordinate, which makes an unbounded distribution usable.
//!
//! The map is the identity except near the bounds. Within a margin, it is a parabola whose vertex is at the
//! bound. Farther outside, points are mirrored (the boundary transformation of Hansen's C implementation,
//! c-cmaes). A cost that decreases towards the bound has a smooth minimum there. A valley inside is not bent,
//! unlike with a sine over the whole box.

use super::options::CmaBounds;
use crate::problem::space::{Space, fold};
use crate::values::choices::ParameterKind;

/// Margin as a fraction of the parameter size or of the width of the box, whichever is smaller. Tuned on
/// rotated ellipsoids and Rosenbrock's function with 5 and 10 parameters (`benches/dfo/cma_es.py` contains
/// these problems with 2, 3 and 8). At the minimum, half of the parameters are at a bound. The value 1/20 of
/// c-cmaes bends valleys inside, and is no better if the cost decreases towards the bound. Smaller margins
/// approach a mirror. A mirror is two to three times slower there, and faster if the cost is level.
const MARGIN: f64 = 0.005;

/// Bounds of a coordinate, and the margin in which the map is a parabola. With margin 0, the bound is a
/// mirror.
#[derive(Debug, Clone, Copy)]
pub(super) struct Boundary {
    lower: f64,
    upper: f64,
    margin: f64,
    /// True for an integer, whose outermost values also collect all points outside the bounds.
    clamps: bool,
}

impl Boundary {
    pub(super) fn new(space: &Space, k: usize, handling: CmaBounds) -> Self {
        let (lower, upper) = space.working_bounds(k);
        let margin = match handling {
            CmaBounds::Smooth => MARGIN * space.size(k).min(upper - lower),
            CmaBounds::Mirror => 0.0,
        };
        Self { lower, upper, margin, clamps: space.kind(k) != ParameterKind::Continuous }
    }

    /// Returns the coordinate for a number. If the number is not finite, `fallback`, another number on the
    /// same line, replaces it.
    pub(super) fn bend(self, v: f64, fallback: f64) -> f64 {
        let Self { lower, upper, margin, clamps } = self;
        let fallback = if fallback.is_finite() { fallback } else { 0.0 };
        if clamps {
            return if v.is_nan() { fallback } else { v }.clamp(lower, upper);
        }
        let v = fold(v, lower - margin, upper + margin, fallback.clamp(lower, upper));
        let parabola = |distance: f64| 0.25 * distance * (distance / margin);
        let u = if margin > 0.0 && v < lower + margin {
            lower + parabola(v - (lower - margin))
        } else if margin > 0.0 && v > upper - margin {
            upper - parabola(upper + margin - v)
        } else {
            v
        };
        u.clamp(lower, upper)
    }

    /// Returns the nearest number that maps to the coordinate.
    pub(super) fn unbend(self, u: f64) -> f64 {
        let Self { lower, upper, margin, clamps } = self;
        if clamps {
            return u;
        }
        let root = |distance: f64| 2.0 * margin.sqrt() * distance.max(0.0).sqrt() - margin;
        if u < lower + margin {
            lower + root(u - lower)
        } else if u > upper - margin {
            upper - root(upper - u)
        } else {
            u
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;

    #[test]
    fn boundary_map_is_smooth_and_stays_inside_the_bounds() {
        const INF: f64 = f64::INFINITY;
        let bounds = Bounds::new(&[-1.0, 2.0, -INF, -INF], &[3.0, INF, 0.0, INF]).unwrap();
        let space = Space::new(&[0.0, 5.0, -2.0, 7.0], bounds, &[], &[]).unwrap();
        for k in 0..4 {
            let boundary = Boundary::new(&space, k, CmaBounds::Smooth);
            let (lower, upper) = space.working_bounds(k);
            let mut last = boundary.bend(-20.0, 0.0);
            for step in -19_999..20_000 {
                let u = boundary.bend(f64::from(step) * 1e-3, 0.0);
                assert!(lower <= u && u <= upper && (u - last).abs() < 1.001e-3, "{k} {step}: {last} {u}");
                last = u;
            }
            for u in [-1.0, -0.99, 0.0, 2.0, 2.001, 2.9, 3.0, 50.0, 1e9] {
                if lower <= u && u <= upper {
                    let there = boundary.bend(boundary.unbend(u), 0.0);
                    assert!((there - u).abs() <= 1e-14 * u.abs().max(1.0), "{k} {u} {there}");
                }
            }
            for v in [f64::NAN, INF, -INF, 1e308, -1e308] {
                assert!((lower..=upper).contains(&boundary.bend(v, f64::NAN)), "{k} {v}");
            }
        }
    }
}
