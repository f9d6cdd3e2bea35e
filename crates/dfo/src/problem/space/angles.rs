//! Spaces whose coordinates are angles. A sine maps an angle to a position between two bounds. A hyperbola
//! maps a coordinate to a position above or below a single bound
//! ([`BoundsHandling::Sine`](crate::BoundsHandling::Sine)).

use super::coordinates::Space;
use std::f64::consts::PI;

impl Space {
    /// Returns this problem in terms of angles. The working coordinates of the new space have no bounds.
    /// Their sizes are such that a distance in them is at least the distance of the points, in units of the
    /// parameter's size.
    pub(crate) fn with_sine(&self) -> Self {
        let mut space = self.clone();
        for k in 0..self.n_free() {
            let (lower, upper) = self.limits_of(k);
            space.sizes[k] = match self.boxed[k].then_some(upper - lower) {
                Some(width) if width > 0.0 => 2.0 * self.sizes[k] / width,
                // Either a range without width on a logarithmic scale, or only one bound.
                Some(_) => 1.0,
                None if lower.is_finite() || upper.is_finite() => 1.0,
                None => self.sizes[k],
            };
            space.size_given[k] = true;
        }
        space.units = self.sizes.clone();
        space.sine = true;
        space
    }

    /// Returns this problem in terms of the parameters themselves.
    pub(crate) fn without_sine(&self) -> Self {
        let sizes = if self.sine { self.units.clone() } else { self.sizes.clone() };
        Self { sizes, sine: false, ..self.clone() }
    }

    /// Returns the coordinate that belongs to an angle.
    pub(super) fn fold_sine(&self, k: usize, v: f64) -> f64 {
        let (lower, upper) = self.limits_of(k);
        let u = match (lower.is_finite(), upper.is_finite()) {
            (true, true) if self.boxed[k] => lower + 0.5 * (upper - lower) * (1.0 + v.sin()),
            // The width overflows.
            (true, true) => (0.5 * lower + 0.5 * upper) + (0.5 * upper - 0.5 * lower) * v.sin(),
            (true, false) => lower + self.units[k] * (v.hypot(1.0) - 1.0),
            (false, true) => upper - self.units[k] * (v.hypot(1.0) - 1.0),
            (false, false) => v,
        };
        // Far out on a hyperbola, the result may overflow.
        u.clamp(self.lower[k].max(f64::MIN), self.upper[k].min(f64::MAX))
    }

    /// Returns the angle of a coordinate.
    pub(super) fn unfold(&self, k: usize, u: f64) -> f64 {
        let (lower, upper) = self.limits_of(k);
        // Root of (d + 1)^2 - 1, without a square that could overflow.
        let arc = |distance: f64| {
            let d = (distance / self.units[k]).clamp(0.0, f64::MAX);
            (d.sqrt() * (d + 2.0).sqrt()).min(f64::MAX)
        };
        match (lower.is_finite(), upper.is_finite()) {
            (true, true) if upper == lower => 0.0,
            (true, true) if self.boxed[k] => {
                (2.0 * (u - lower) / (upper - lower) - 1.0).clamp(-1.0, 1.0).asin()
            }
            (true, true) => {
                ((u - (0.5 * lower + 0.5 * upper)) / (0.5 * upper - 0.5 * lower)).clamp(-1.0, 1.0).asin()
            }
            (true, false) => arc(u - lower),
            (false, true) => arc(upper - u),
            (false, false) => u,
        }
    }

    /// Returns the user's bounds that are passed between two values of an angle coordinate.
    pub(super) fn bounds_passed(&self, k: usize, from: f64, to: f64) -> [Option<f64>; 2] {
        let (low, high) = self.limits_of(k);
        let (lower, upper) = (self.bounds.lower()[self.free[k]], self.bounds.upper()[self.free[k]]);
        match (low.is_finite(), high.is_finite()) {
            (true, true) => {
                // Arcs from bound to bound are numbered. Even arcs begin at the lower bound.
                let arc = |v: f64| (v / PI + 0.5).floor();
                let (first, last) = (arc(from.min(to)), arc(from.max(to)));
                match last - first {
                    0.0 => [None; 2],
                    1.0 if last.rem_euclid(2.0) == 0.0 => [Some(lower), None],
                    1.0 => [None, Some(upper)],
                    _ => [Some(lower), Some(upper)],
                }
            }
            (true, false) if from * to < 0.0 => [Some(lower), None],
            (false, true) if from * to < 0.0 => [None, Some(upper)],
            _ => [None; 2],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::problem::space::Bounds;
    use crate::values::choices::ToleranceMeasure;
    use crate::values::choices::Transform;

    const INF: f64 = f64::INFINITY;

    #[test]
    fn angles_stay_in_the_box_and_are_invertible() -> Result<(), Error> {
        let bounds = Bounds::new(&[-1.0, 0.0, -INF, -INF, 1e-3], &[3.0, INF, 2.0, INF, 1e3])?;
        let log =
            [Transform::Linear, Transform::Linear, Transform::Linear, Transform::Linear, Transform::Log];
        let space = Space::new(&[3.0, 0.0, 2.0, 5.0, 1e-3], bounds, &log, &[])?.with_sine();
        let (mut u, mut x) = ([0.0; 5], [0.0; 5]);
        space.to_working(space.x0(), &mut u);
        space.to_user(&u, &mut x);
        assert_eq!(x[..4], space.x0()[..4]);
        assert!((x[4] - 1e-3).abs() < 1e-18, "{x:?}");
        for v in [-1e9, -7.0, -1.0, 0.0, 0.5, 1.6, 100.0, 1e9] {
            space.to_user(&[v; 5], &mut x);
            assert!(space.bounds().contains(&x), "{v}: {x:?}");
        }
        Ok(())
    }

    #[test]
    fn path_between_angles_of_one_point_passes_the_bound() -> Result<(), Error> {
        let bounds = Bounds::new(&[0.0, 1.0, -INF], &[4.0, INF, INF])?;
        let space = Space::new(&[2.0, 2.0, 0.0], bounds, &[], &[])?.with_sine();
        let distance = |k: usize, from: f64, to: f64| {
            let at = |v: f64| {
                let mut x = [0.0; 3];
                space.to_user(&[v; 3], &mut x);
                (v, x[k])
            };
            let others = [at(from), at(to)].into_iter();
            [ToleranceMeasure::Absolute, ToleranceMeasure::Relative]
                .map(|m| space.extent(k, at(from), others.clone(), m))
        };
        // Sizes are 4, 2 and 1. The paths run from 2 over the upper bound back to 2, over both bounds, and
        // over the lower bound.
        for (k, from, to, expected) in [
            (0, 0.0, PI, 2.0),
            (0, 0.0, 0.5 * PI, 2.0),
            (0, 0.25 * PI, 0.75 * PI, 2.0 - 2f64.sqrt()),
            (0, -0.6 * PI, 0.6 * PI, 4.0 - 2.0 * (1.0 - (0.6 * PI).sin())),
            (0, 0.0, -PI, 2.0),
            (1, -0.75, 0.75, 0.5),
            (1, 0.0, 0.75, 0.5),
            (2, -3.0, 3.0, 6.0),
        ] {
            let [absolute, relative] = distance(k, from, to);
            assert!((absolute - expected).abs() < 1e-12, "{k}: {from} to {to}: {absolute}");
            assert!((relative * [4.0, 2.0, 1.0][k] - absolute).abs() < 1e-12);
        }
        Ok(())
    }
}
